#!/usr/bin/env bash
# Makes a folder with everything that gpu.py needs, for machines that have a GPU and no compiler: gpu.sh FOLDER. Programs are built for
# any x86-64 processor and glibc no older than this machine's. Then, there: python3 FOLDER/gpu.py FOLDER OUT
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
cd "$here/../.."
folder=${1:?usage: gpu.sh FOLDER}
target=${CARGO_TARGET_DIR:-target}
export CARGO_INCREMENTAL=0 CARGO_PROFILE_RELEASE_DEBUG=0 CARGO_PROFILE_RELEASE_STRIP=symbols
packages=(-p covers-equivariant -p covers-rl -p covers-rs -p covers-envs -p covers-benches --features covers-rs/wgpu,covers-benches/wgpu)

mkdir -p "$folder/bin" "$folder/lib" "$folder/tests"
cargo build --release --locked "${packages[@]}" --bin covers --example gpu_times --example env_times
cp "$target/release/covers" "$target/release/examples/gpu_times" "$target/release/examples/env_times" "$folder/bin"
# the program of a test target is named in cargo's messages
tests() {
  cargo test --release --locked "${packages[@]}" --no-run --message-format json "${@:2}" |
    python3 -c 'import json, sys; print(*[m["executable"] for m in map(json.loads, sys.stdin) if m.get("executable") and m["profile"]["test"] and "#" + sys.argv[1] + "@" in m["package_id"]], sep="\n")' "$1"
}
cp "$(tests covers-equivariant --test gpu)" "$folder/tests/equivariant"
cp "$(tests covers-rl --test gpu)" "$folder/tests/rl"
cp "$(tests covers-rs --test suite)" "$folder/tests/covers-rs"
# MuJoCo with what it needs, and the Vulkan loader; drivers come with the GPU
ldd "$folder/bin/covers" | awk '/mujoco|ccd|lodepng|qhull|tinyxml2/ { print $3 }' | xargs -I{} cp -L {} "$folder/lib"
ldconfig -p | awk '/libvulkan.so.1 / { print $NF; exit }' | xargs -I{} cp -L {} "$folder/lib"
cp "$here/gpu.py" "$folder"
du -sh "$folder"

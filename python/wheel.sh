#!/usr/bin/env bash
# Builds a wheel that contains MuJoCo and the libraries it needs, and tests it in an environment that
# has neither Rust nor these libraries: `wheel.sh OUT` for this machine, `wheel.sh OUT aarch64` for
# another processor, which QEMU emulates in the test. Makefile's `wheel` prepares what it takes.
set -euo pipefail
out=$(realpath "$1")
arch=${2:-$(uname -m)}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$(dirname "$0")"
project=$(realpath ..)

build=()
repair=(--plat "manylinux_2_35_$arch")
if [ "$arch" != "$(uname -m)" ]; then
  # Debian's packages for the other processor, unpacked
  root=$work/root
  libraries=$root/usr/lib/$arch-linux-gnu
  sources=()
  for file in /etc/apt/sources.list /etc/apt/sources.list.d/debian.sources; do
    if [ -s "$file" ]; then sources+=("$file"); fi
  done
  mkdir "$root"
  mmdebstrap --quiet --variant=extract --architectures=arm64 \
    --include=libmujoco-dev,python3,libegl1,libegl-mesa0,libgl1-mesa-dri,libosmesa6 \
    bookworm - "${sources[@]}" | tar -x --no-same-owner --exclude="./dev/*" -C "$root"
  mkdir "$root/mujoco"
  ln -s ../usr/include "$libraries" "$root/mujoco"
  mv "$root/mujoco/$arch-linux-gnu" "$root/mujoco/lib"
  export MUJOCO_DIR=$root/mujoco
  export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc
  build=(--target "$arch-unknown-linux-gnu")
  # the oldest Linux that has what the libraries need
  repair=(--plat auto --ldpaths "$libraries")
  rustup target add "$arch-unknown-linux-gnu"
fi
maturin build --quiet --release --locked --strip --auditwheel skip "${build[@]}" \
  --out "$work/linked"
auditwheel repair "${repair[@]}" --wheel-dir "$work/whole" \
  "$work"/linked/*.whl

# the licences of the libraries inside, as Debian states them
wheel unpack --dest "$work" "$work"/whole/*.whl
cd "$work"/covers_envs-*/
inside=$(cd covers_envs.libs && printf '%s\n' *.so.*)
[ -n "$inside" ] || { echo "the wheel contains no libraries" >&2; exit 1; }
licences=$(echo ./*.dist-info)/licenses
mkdir -p "$licences"
cp "$project"/LICENSE-* "$licences"
owners() { for file in $inside; do dpkg-query --search "*/${file%%-*}.so.*" || return 1; done; }
packages=$(owners | cut -d: -f1 | sort -u)
for package in $packages; do
  cp "/usr/share/doc/$package/copyright" "$licences/$package"
done
mkdir -p "$out"
rm -f "$out"/covers_envs-*"_$arch.whl"
wheel pack --dest-dir "$out" .

cat > "$work/test.py" <<'PYTHON'
import platform

import covers_envs

env = covers_envs.make_vec("button-press", 2, seed=0)
env.reset()
for _ in range(env.decisions):
    observation, _, _, _, infos = env.step(env.expert_actions())
assert observation["image"].std() > 1, "the images are empty"
assert infos["success"].all(), "the expert did not press the button"
print("the wheel simulates and renders without installed libraries on", platform.machine())
PYTHON
if [ "$arch" != "$(uname -m)" ]; then
  for file in $inside; do rm -f "$libraries/${file%%-*}".so*; done
  wheel=$(echo "$out"/covers_envs-*"_$arch.whl")
  tag=$(basename "${wheel##*-}" .whl)
  python3 -m pip install --quiet --target "$work/site" --platform "$tag" \
    --platform "manylinux_2_28_$arch" --platform "manylinux2014_$arch" --only-binary=:all: \
    --python-version 3.11 "$wheel"
  cd "$work"
  env -i QEMU_LD_PREFIX="$root" "$(command -v "qemu-$arch-static")" \
    -E PYTHONHOME="$root/usr" -E PYTHONPATH="$work/site" "$root/usr/bin/python3.11" test.py
else
  python3 -m venv "$work/clean"
  "$work/clean/bin/pip" install --quiet "$out"/covers_envs-*"_$arch.whl"
  hidden=$(dpkg-query --listfiles $packages | grep '\.so\.' | xargs -n 1 realpath | sort -u)
  export hidden clean="$work/clean" test="$work/test.py"
  # root of its own mounts, where the libraries and Rust cannot be read
  unshare --mount --map-root-user bash -euo pipefail -c '
    for file in $hidden; do mount --bind /dev/null "$file"; done
    cd /
    exec env -i PATH=/usr/bin:/bin "$clean/bin/python" "$test"'
fi
ls -l "$out"

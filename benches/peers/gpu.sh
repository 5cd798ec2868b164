#!/usr/bin/env bash
# Times training steps on a GPU here and in PyTorch, in turn: gpu.sh [VENV] [ROUNDS] [ADAPTER]. VENV, with a PyTorch for CUDA where there is such a device, is made if it is missing; ADAPTER is a part of the name of ours.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$here/../..
target=${CARGO_TARGET_DIR:-$root/target}
venv=${1:-$target/peers/gpu}
if [ ! -x "$venv/bin/python" ]; then
  "${PYTHON:-python3.11}" -m venv "$venv"
  "$venv/bin/pip" install --quiet torch==2.15.0 numpy==2.4.6
fi
cargo build --quiet --release --locked --manifest-path "$root/Cargo.toml" --package covers-equivariant --features wgpu --example gpu_times
exec "$venv/bin/python" "$here/gpu.py" "$target/release/examples/gpu_times" "${2:-3}" ${3:+"$3"}

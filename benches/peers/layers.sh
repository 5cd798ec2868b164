#!/usr/bin/env bash
# Times networks here, in PyTorch and in escnn, in turn: layers.sh [VENV] [ROUNDS]. VENV is made if it is missing.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$here/../..
target=${CARGO_TARGET_DIR:-$root/target}
venv=${1:-$target/peers}
[ -x "$venv/bin/python" ] || "$here/venv.sh" "$venv"
cargo build --quiet --release --locked --manifest-path "$root/Cargo.toml" --package covers-benches --example layer_times
"$venv/bin/python" "$here/layers.py" "$target/release/examples/layer_times" "${2:-20}"

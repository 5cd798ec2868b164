#!/usr/bin/env bash
# Saves networks of every group here and runs them in PyTorch: interchange.sh VENV, which is made if it is missing.
# With --golden it also makes the golden files of equivariant/tests and rl/tests afresh.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
venv=${1:?usage: interchange.sh VENV [--golden]}
[ -x "$venv/bin/python" ] || "$here/venv.sh" "$venv"
files=$(mktemp -d)
trap 'rm -r "$files"' EXIT
cargo run --quiet --release --locked --manifest-path "$here/../../Cargo.toml" --package covers-equivariant --example export -- "$files"
"$venv/bin/python" "$here/interchange.py" "$files"
if [ "${2:-}" = --golden ]; then
  golden=$here/../../equivariant/tests/golden
  "$venv/bin/python" "$here/golden_layers.py" "$golden/layers.safetensors"
  "$venv/bin/python" "$here/escnn_filters.py" "$golden/escnn.safetensors"
  "$venv/bin/python" "$here/golden_gru.py" "$golden/gru.safetensors"
  "$venv/bin/python" "$here/golden_sac.py" "$here/../../rl/tests/golden/sac.safetensors"
fi

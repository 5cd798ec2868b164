#!/usr/bin/env bash
# Makes the golden files of equivariant/tests and rl/tests afresh: golden.sh VENV, which is made if it is missing.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
venv=${1:?usage: golden.sh VENV}
[ -x "$venv/bin/python" ] || "$here/venv.sh" "$venv"
golden=$here/../../equivariant/tests/golden
"$venv/bin/python" "$here/golden_layers.py" "$golden/layers.safetensors"
"$venv/bin/python" "$here/escnn_filters.py" "$golden/escnn.safetensors"
"$venv/bin/python" "$here/golden_gru.py" "$golden/gru.safetensors"
"$venv/bin/python" "$here/golden_sac.py" "$here/../../rl/tests/golden/sac.safetensors"

#!/usr/bin/env bash
# Makes the environment of the comparisons, PyTorch and escnn from PyPI: venv.sh DIR, with Python 3.11.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
dir=${1:?usage: venv.sh DIR}
"${PYTHON:-python3.11}" -m venv "$dir"
"$dir/bin/pip" install --quiet --requirement "$here/requirements.txt"
# escnn names packages that D2 does not need; one of them, py3nj, wants a Fortran compiler but is only imported
"$dir/bin/pip" install --quiet --no-deps escnn==1.0.11 lie_learn==0.0.2
touch "$("$dir/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/py3nj.py"

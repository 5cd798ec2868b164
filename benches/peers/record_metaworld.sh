#!/usr/bin/env bash
# Records Meta-World on MuJoCo 2.2.2 anew: benches/peers/record_metaworld.sh FOLDER [TASK ...]   (the repository's: tests/recordings)
# The wheel of mujoco 2.2.2 exists for Python 3.10; name that interpreter in PYTHON where it is not called python3.10.
set -euo pipefail
folder=${1:?usage: record_metaworld.sh FOLDER [TASK ...]}
here=$(cd "$(dirname "$0")" && pwd)
venv=${CARGO_TARGET_DIR:-target}/peers/metaworld
if [ ! -e "$venv/ready" ]; then
  "${PYTHON:-python3.10}" -m venv "$venv"
  "$venv/bin/pip" install --quiet mujoco==2.2.2 numpy==1.26.4 scipy==1.15.3 gymnasium==1.2.2 imageio==2.37.2 packaging==25.0
  # metaworld asks for mujoco 3.3.0, whose physics differs
  "$venv/bin/pip" install --quiet --no-deps metaworld==3.1.1
  touch "$venv/ready"
fi
shift
exec "$venv/bin/python" "$here/record_metaworld.py" "$folder" "$@"

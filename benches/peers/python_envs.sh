#!/usr/bin/env bash
# Times covers_envs in Python beside the same environments in Rust, Meta-World and EnvPool, in turn: python_envs.sh [ROUNDS].
# `make python` comes first: it builds the wheel.
set -euo pipefail
cd "$(dirname "$0")/../.."
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MUJOCO_GL=egl

target=$(realpath "${CARGO_TARGET_DIR:-target}")
venv=$target/peers/envs
if [ ! -e "$venv/ready" ]; then
  "${PYTHON:-python3.11}" -m venv "$venv"
  "$venv/bin/pip" install --quiet envpool==1.2.5 metaworld==3.1.1 mujoco==3.3.0 gymnasium==1.4.0 numpy==2.4.6
  touch "$venv/ready"
fi
"$venv/bin/pip" install --quiet --no-deps --force-reinstall "$target"/python/wheels/covers_envs-*.whl
cargo build --quiet --release --locked --package covers-benches --example env_times
exec "$venv/bin/python" benches/peers/python_envs.py "$target/release/examples/env_times" "${1:-7}"

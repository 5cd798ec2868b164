#!/usr/bin/env bash
# Times environments here beside EnvPool and Meta-World, in turn: envs.sh [EMBODIMENT] [ROUNDS]. The embodiment is ours; theirs is a Sawyer.
set -euo pipefail
cd "$(dirname "$0")/../.."
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MUJOCO_GL=egl

target=${CARGO_TARGET_DIR:-target}
venv=$target/peers/envs
if [ ! -e "$venv/ready" ]; then
  "${PYTHON:-python3.11}" -m venv "$venv"
  "$venv/bin/pip" install --quiet envpool==1.2.5 metaworld==3.1.1 mujoco==3.3.0 gymnasium==1.4.0 numpy==2.4.6
  touch "$venv/ready"
fi
cargo build --quiet --release --locked --package covers-benches --example env_times
exec "$venv/bin/python" benches/peers/envs.py "$target/release/examples/env_times" "${1:-sawyer}" "${2:-7}"

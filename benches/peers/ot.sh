#!/usr/bin/env bash
# Exact 1-Wasserstein distances, ours against POT on the same points: one thread, interleaved, medians.
# Usage: benches/peers/ot.sh [--growth]   (--growth also measures n = m up to 4000 and draws docs/w1_growth.png)
set -euo pipefail
cd "$(dirname "$0")/../.."
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 RAYON_NUM_THREADS=1

venv=${CARGO_TARGET_DIR:-target}/peers/ot
if [ ! -e "$venv/ready" ]; then
  python3 -m venv "$venv"
  "$venv/bin/pip" install --quiet POT==0.9.7 numpy==2.3.5 scipy==1.16.3 matplotlib==3.10.7
  touch "$venv/ready"
fi
cargo build --release --locked -p covers-benches --example w1_times
exec "$venv/bin/python" benches/peers/w1_against_pot.py "${CARGO_TARGET_DIR:-target}/release/examples/w1_times" "$@"

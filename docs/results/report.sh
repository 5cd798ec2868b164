#!/usr/bin/env bash
# Draws the curves of runs and prints their tables: report.sh RUN... (folders of `covers train`, one a seed).
# Each folder receives curves.png; the tables are Markdown on standard output.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
venv=${CARGO_TARGET_DIR:-$here/../../target}/results
if [ ! -e "$venv/ready" ]; then
  python3 -m venv "$venv"
  "$venv/bin/pip" install --quiet numpy==2.3.5 matplotlib==3.10.7
  touch "$venv/ready"
fi
exec "$venv/bin/python" "$here/report.py" "$@"

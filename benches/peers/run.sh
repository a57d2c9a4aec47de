#!/usr/bin/env bash
# Compares with PyTorch, JAX, Keras and Gymnasium on this machine. Needs Rust, Python 3.11 or newer and 3 GB of disk.
#   benches/peers/run.sh [update|single|training|startup]…
set -euo pipefail
cd "$(dirname "$0")"
venv=${VENV:-.venv}
if [ ! -x "$venv/bin/python" ]; then
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check -r requirements.txt
fi
"$venv/bin/python" compare.py "$@"

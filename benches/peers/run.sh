#!/usr/bin/env bash
# Compares with PyTorch, JAX, PureJaxRL, Keras and Gymnasium on this machine. Needs Linux, Rust, Python 3.11 or newer
# and 8 GB of disk, most of it the CUDA libraries of PyTorch's package, which are not used.
#   benches/peers/run.sh [update|single|training|startup]…
set -euo pipefail
cd "$(dirname "$0")"
venv=${VENV:-.venv}
[ -x "$venv/bin/pip" ] || python3 -m venv "$venv"
"$venv/bin/pip" install --quiet --disable-pip-version-check -r requirements.txt
"$venv/bin/python" compare.py "$@"

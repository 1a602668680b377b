#!/usr/bin/env bash
# Install what is missing, then run the tests: tests/run.sh [pytest arguments]
set -euo pipefail
cd "$(dirname "$0")/.."
. launch/install.sh "[test]"
pytest=("$VENV/bin/python" -m pytest -n 2 --dist loadfile --no-loadscope-reorder)
if (($#)); then exec "${pytest[@]}" "$@"; fi
"${pytest[@]}" --ignore-glob='*/test_render_*.py'
# The projection is tested as users compile it: a gradient may be right without XLA's
# optimisations and wrong with them (`fullest` in dpc_jax/render/termination.py).
XLA_FLAGS= exec "${pytest[@]}" tests/test_render_*.py

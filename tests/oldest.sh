#!/usr/bin/env bash
# The oldest versions that pyproject.toml allows, in an environment of their own: tests that
# touch every package, then a short run: tests/oldest.sh [pytest arguments]
# OLDEST keeps the environment in a folder; PYTHON is what it is made with.
set -euo pipefail
cd "$(dirname "$0")/.."
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
venv="${OLDEST:-$folder/oldest}"
"${PYTHON:-python3}" -m venv "$folder/uv"
"$folder/uv/bin/python" -m pip install --quiet uv
uv="$folder/uv/bin/uv"
[ -x "$venv/bin/python" ] || "$uv" venv --quiet --python "${PYTHON:-python3}" "$venv"
"$uv" pip install --quiet --python "$venv/bin/python" --resolution=lowest-direct \
    --requirements pyproject.toml --extra test
"$uv" pip install --quiet --python "$venv/bin/python" --no-deps --editable .
"$uv" pip freeze --python "$venv/bin/python" | grep -v '^-e'
export JAX_PLATFORMS=cpu
"$venv/bin/python" -m pytest -q -p no:cacheprovider tests/test_render_golden.py \
    tests/test_evaluation_*.py tests/test_reporting_*.py tests/test_data_*.py \
    tests/test_networks.py tests/test_learning_step.py tests/test_learning_checkpoints.py \
    tests/test_learning_loop.py tests/test_run_*.py tests/test_commands.py \
    tests/test_compare.py "$@"
"$venv/bin/dpc_jax" train --config=debug:known_pose --workdir="$folder/run"
test -s "$folder/run/report/index.html"
echo "The oldest versions work."

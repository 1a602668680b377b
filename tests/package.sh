#!/usr/bin/env bash
# Build sdist and wheel, install the wheel in an empty environment, train from it outside
# the checkout: tests/package.sh
set -euo pipefail
cd "$(dirname "$0")/.."
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
python="${PYTHON:-python3}"
"$python" -m venv "$folder/build"
"$folder/build/bin/python" -m pip install --quiet build twine
# The wheel is built from the sdist, so that nothing it needs is left out there.
"$folder/build/bin/python" -m build --outdir "$folder/dist" . >"$folder/build.log" 2>&1 || {
    tail -20 "$folder/build.log" >&2
    exit 1
}
"$folder/build/bin/python" -m twine check --strict "$folder"/dist/*
"$python" -m venv "$folder/empty"
wheel=$(echo "$folder"/dist/dpc_jax-*.whl)
"$folder/empty/bin/python" -m pip install --quiet "$wheel"
cd "$folder"
export JAX_PLATFORMS=cpu
# Programs run for a few steps only: compiled with little effort.
export XLA_FLAGS="--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true"
# The projection alone is light, and commands say what they lack.
"$folder/empty/bin/python" -c "
import dpc_jax, importlib.util, jax
print(dpc_jax.project(jax.numpy.zeros((1, 3)), jax.numpy.eye(3), sigma=1.0).silhouette.sum())
heavy = 'orbax flax optax trimesh matplotlib plotly skimage ml_collections PIL'
assert not any(map(importlib.util.find_spec, heavy.split()))"
! "$folder/empty/bin/dpc_jax" train --config=debug 2>"$folder/said"
grep -q "^Error: .*pip install 'dpc_jax\[learn\]'" "$folder/said"
"$folder/empty/bin/python" -m pip install --quiet "$wheel[learn]"
"$folder/empty/bin/dpc_jax" train --config=debug:known_pose
test -s "$folder/runs/debug-known_pose-seed0/report/index.html"
"$folder/empty/bin/dpc_jax" compare runs
test -s "$folder/runs/comparison/index.html"
"$folder/empty/bin/python" -c "import dpc_jax, pathlib; assert '$folder/empty' in dpc_jax.__file__"
echo "The wheel trains in an empty environment."

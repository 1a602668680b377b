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
# Projection, quaternions and losses are light, and other names say what they lack.
"$folder/empty/bin/python" -c "
import dpc_jax, importlib.util, jax.numpy as jnp
heavy = 'orbax flax optax trimesh matplotlib plotly skimage ml_collections PIL'
assert not any(map(importlib.util.find_spec, heavy.split()))
image = dpc_jax.project(jnp.zeros((1, 3)), jnp.eye(3), sigma=1.0).silhouette
assert dpc_jax.reprojection_loss(image, image) == 0
one = jnp.array([1.0, 0, 0, 0])
assert dpc_jax.student_loss(one, dpc_jax.quaternion.normalize(2 * one)) == 0
try:
    dpc_jax.ShapeHead
except ModuleNotFoundError as error:
    assert 'dpc_jax.ShapeHead needs flax' in str(error)
else:
    raise AssertionError('flax is there')
"
for name in $("$folder/empty/bin/python" -c "
from dpc_jax.commands import COMMANDS
print(*COMMANDS)"); do
    case $name in
        train) words="--config=debug" ;;
        predict) words="--workdir=w x" ;;
        data) words="show $folder" ;;
        fit | compare | view) words=x ;;
        *) words= ;;
    esac
    status=0
    "$folder/empty/bin/dpc_jax" "$name" $words 2>"$folder/said" || status=$?
    [ "$status" = 1 ]
    [ "$(wc -l <"$folder/said")" = 1 ]
    grep -q "^Error: .*pip install 'dpc_jax\[learn[],]" "$folder/said"
done
"$folder/empty/bin/python" -m pip install --quiet "$wheel[learn]"
"$folder/empty/bin/dpc_jax" train --config=debug:known_pose
grep -q "pose errors are absent" "$folder/runs/debug-known_pose-seed0/report/index.html"
"$folder/empty/bin/dpc_jax" compare runs
test -s "$folder/runs/comparison/index.html"
"$folder/empty/bin/python" -c "import dpc_jax, pathlib; assert '$folder/empty' in dpc_jax.__file__"
echo "The wheel trains in an empty environment."

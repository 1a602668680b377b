#!/usr/bin/env bash
# Install what is missing, then train, evaluate and report:
#   launch/run.sh --config=configs/car.py [--workdir=DIR] [--config.x.y=z]
# Started again with the same arguments, it goes on where it was stopped.
set -euo pipefail
cd "$(dirname "$0")/.."
. launch/install.sh "[learn]"
exec "$VENV/bin/python" -m dpc_jax.main "$@"

#!/usr/bin/env bash
# Install what is missing, then get data or look at it:
#   launch/data.sh fetch chair|car|airplane [--out=data/open]
#   launch/data.sh show|check FOLDER
set -euo pipefail
cd "$(dirname "$0")/.."
. launch/install.sh "[learn]"
exec "$VENV/bin/python" -m dpc_jax.data "$@"

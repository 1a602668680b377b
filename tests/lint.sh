#!/usr/bin/env bash
# Install what is missing, then check style, types and layers of imports: tests/lint.sh
set -euo pipefail
cd "$(dirname "$0")/.."
. launch/install.sh "[learn,lint,view]"
"$VENV/bin/ruff" check .
"$VENV/bin/ruff" format --check .
"$VENV/bin/pyright" --pythonpath "$VENV/bin/python"
"$VENV/bin/lint-imports" --no-cache

#!/usr/bin/env bash
# Install what is missing, then build the documentation as a site, strictly; a page that is
# in no menu, a link to nowhere or an asset of another host ends it:
#   tests/docs.sh [mkdocs arguments]     into site/; open site/index.html
set -euo pipefail
cd "$(dirname "$0")/.."
. launch/install.sh "[learn,docs]"
# The theme's advertisement of its successor is no warning of ours.
JAX_PLATFORMS=cpu NO_MKDOCS_2_WARNING=1 exec "$VENV/bin/python" -m mkdocs build --strict "$@"

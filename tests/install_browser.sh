#!/usr/bin/env bash
# Install the browser that tests/test_reporting_browser.py looks at reports with, where
# there is none: tests/install_browser.sh
set -euo pipefail
for name in chromium chromium-browser google-chrome google-chrome-stable; do
    command -v "$name" >/dev/null && exit 0
done
if [ "$(id -u)" != 0 ] || ! command -v apt-get >/dev/null; then
    echo "Chromium is needed to test reports, but only root can install it with apt-get; install it, or set CHROMIUM to its path." >&2
    exit 1
fi
apt-get update -qq
DEBIAN_FRONTEND=noninteractive apt-get install -qq --yes --no-install-recommends chromium >/dev/null

#!/usr/bin/env bash
# The same config with seeds 0, 1, 2, one after the other:
#   launch/seeds.sh configs/car.py [--config.x.y=z]
set -euo pipefail
cd "$(dirname "$0")/.."
config="${1:?Give a config, for example: launch/seeds.sh configs/car.py}"
shift
for seed in 0 1 2; do
    launch/run.sh --config="$config" --config.seed="$seed" "$@"
done

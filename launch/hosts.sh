#!/usr/bin/env bash
# One run by several processes:
#   launch/hosts.sh 2 --config=configs/car.py [--workdir=DIR] [--config.x.y=z]
#       two on this machine, each with half of its cores
#   launch/hosts.sh node02,node03 --config=configs/car.py:paper
#       process 0 here and one on each of these hosts, over ssh
# Hosts need this folder under the same path, and ssh without a password. Port 7777 of this
# machine must be open to them; PORT=... takes another. Started again with the same
# arguments, the run goes on where it was stopped. docs/install.md says more.
set -euo pipefail
cd "$(dirname "$0")/.."
where="${1:?Give a number of processes or hosts, for example: launch/hosts.sh 2 --config=configs/car.py}"
shift
. launch/install.sh "[learn]"
port="${PORT:-7777}"
if (exec 3<> "/dev/tcp/127.0.0.1/$port") 2> /dev/null; then
    echo "Port $port must be free for a new run, but something listens there, perhaps the same command; wait for it to end, or set PORT to another." >&2
    exit 1
fi
pids=()

start_here() {  # process, processes, coordinator, cores, arguments of the run
    local pin=()
    [ -z "$4" ] || ! command -v taskset > /dev/null || pin=(taskset -c "$4")
    "${pin[@]}" "$VENV/bin/python" -m dpc_jax.main --coordinator="$3" --processes="$2" \
        --process="$1" "${@:5}" &
    pids+=($!)
}

if [[ "$where" =~ ^[0-9]+$ ]]; then
    [ "$where" -ge 1 ] || { echo "Expected at least one process, but $where was given; write for example launch/hosts.sh 2 --config=configs/car.py." >&2; exit 1; }
    # The cores that this shell may use, one by one.
    cores_here=($("$VENV/bin/python" -c 'import os; print(*sorted(os.sched_getaffinity(0)))' 2> /dev/null || true))
    share=$(( ${#cores_here[@]} / where ))
    for (( process = 0; process < where; process++ )); do
        first=$(( process * share ))
        cores=""
        [ "$share" = 0 ] || cores="$(IFS=,; echo "${cores_here[*]:first:share}")"
        start_here "$process" "$where" "127.0.0.1:$port" "$cores" "$@"
    done
else
    IFS=, read -ra hosts <<< "$where"
    processes=$(( ${#hosts[@]} + 1 ))
    coordinator="$(hostname -f):$port"
    start_here 0 "$processes" "$coordinator" "" "$@"
    for (( process = 1; process < processes; process++ )); do
        command=$(printf '%q ' launch/run.sh --coordinator="$coordinator" \
            --processes="$processes" --process="$process" "$@")
        ssh -o BatchMode=yes "${hosts[process - 1]}" "cd $(printf %q "$PWD") && $command" &
        pids+=($!)
    done
fi

# One that is asked to stop is enough: all processes save at the same step and end.
trap 'kill -TERM "${pids[0]}" 2> /dev/null || true' TERM INT
status=0
for pid in "${pids[@]}"; do
    while true; do  # a signal to this script ends a wait, but not the process
        wait "$pid" && ended=0 || ended=$?
        kill -0 "$pid" 2> /dev/null || break
    done
    [ "$ended" = 0 ] || status=$ended
done
exit "$status"

# Sourced by the other scripts: makes the virtual environment $VENV (.venv where not set)
# with this package in it, unless that has been done since pyproject.toml last changed.
# Arguments: extras to install, for example "[test]". An NVIDIA GPU adds cuda12 or cuda13,
# by its driver; CUDA=12, 13 or none decides instead.
VENV="${VENV:-.venv}"
PYTHON="${PYTHON:-python3}"

# The extra for the oldest driver and GPU that nvidia-smi shows; nothing without a GPU.
# JAX asks for driver 525 and compute capability 5.2 for CUDA 12, 580 and 7.5 for 13.
choose_cuda() {
    case "${CUDA:-}" in
    12 | 13) echo "cuda$CUDA" && return ;;
    none) return ;;
    "") ;;
    *) echo "CUDA must be 12, 13 or none, but it is $CUDA; leave it out to go by the driver." >&2 && return 1 ;;
    esac
    command -v nvidia-smi >/dev/null || return 0
    local found
    found=$(nvidia-smi --query-gpu=driver_version,compute_cap --format=csv,noheader 2>/dev/null) || return 0
    echo "$found" | awk -F '[., ]+' '
        /^[0-9]+\.[0-9.]+, *[0-9]+\.[0-9]+/ {
            n = split($0, part, /, */); split(part[1], driver, "."); split(part[n], cap, ".")
            able = cap[1] * 10 + cap[2]; version = driver[1] + 0
            if (!seen || version < oldest) oldest = version
            if (!seen || able < weakest) weakest = able
            seen = 1
        }
        END {
            if (!seen) exit
            if (oldest >= 580 && weakest >= 75) print "cuda13"
            else if (oldest >= 525 && weakest >= 52) print "cuda12"
            else print "The GPU was left out: JAX needs driver 525 and compute capability 5.2, but nvidia-smi shows driver " oldest " and " weakest / 10 "; update the driver." > "/dev/stderr"
        }'
}

cuda=$(choose_cuda) || exit 1
extras="$1"
if [ -n "$cuda" ]; then
    extras="${extras%]}"
    extras="${extras:-[}"
    [ "$extras" = "[" ] || extras="$extras,"
    extras="$extras$cuda]"
fi
mark="$VENV/.installed$extras"
if [ ! -e "$mark" ] || [ pyproject.toml -nt "$mark" ]; then
    "$PYTHON" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
        echo "Python 3.11 or newer is needed, but $PYTHON is $("$PYTHON" --version 2>&1); set PYTHON=/path/to/one." >&2
        exit 1
    }
    echo "Installing .$extras into $VENV: a minute or two"
    "$PYTHON" -m venv "$VENV"
    "$VENV/bin/python" -m pip install --quiet --editable ".$extras"
    touch "$mark"
fi

# Sourced by the other scripts: makes the virtual environment $VENV (.venv where not set)
# with this package in it, unless that has been done since pyproject.toml last changed.
# Arguments: extras to install, for example "[test]".
VENV="${VENV:-.venv}"
PYTHON="${PYTHON:-python3}"
mark="$VENV/.installed$1"
if [ ! -e "$mark" ] || [ pyproject.toml -nt "$mark" ]; then
    "$PYTHON" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
        echo "Python 3.11 or newer is needed, but $PYTHON is $("$PYTHON" --version 2>&1); set PYTHON=/path/to/one." >&2
        exit 1
    }
    "$PYTHON" -m venv "$VENV"
    "$VENV/bin/python" -m pip install --quiet --editable ".$1"
    touch "$mark"
fi

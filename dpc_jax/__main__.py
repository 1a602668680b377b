"""python -m dpc_jax: the command dpc_jax."""

import sys

from dpc_jax.commands import main

if __name__ == "__main__":
    sys.exit(main())

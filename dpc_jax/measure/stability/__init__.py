"""What happens in stiff and extreme cases: `python -m dpc_jax.stability`.

`functions` and `images` are tables of cases, which `runner` compares with `oracles`.
`random_draws` tries functions over the whole float range, `descents` follows stiff
optimisation. Each gives rows, which `report` writes.
"""

# In the order of the report.
SUBJECTS = (
    *("rotation", "splat", "gaussian", "ray", "loss"),
    *("image", "cells", "sum", "random", "descent"),
)
DTYPES = ("float64", "float32", "bfloat16", "float16")
QUICK_DTYPES = ("float32",)

"""What happens in stiff and extreme cases: `python -m dpc_jax.stability`.

`functions` and `images` are tables of cases, which `runner` compares with `oracles`.
`random_draws` tries functions over the whole float range, `descents` follows stiff
optimisation. Each gives rows, which `report` writes.
"""

# Subjects by the names that the command line takes, and the modules of their cases.
SUBJECTS = {
    **dict.fromkeys(("rotation", "splat", "gaussian", "ray", "loss"), "functions"),
    **dict.fromkeys(("camera", "image", "cells", "sum"), "images"),
    "random": "random_draws",
    "descent": "descents",
}
DTYPES = ("float64", "float32", "bfloat16", "float16")

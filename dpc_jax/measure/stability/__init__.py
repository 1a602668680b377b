"""What happens in stiff and extreme cases: `python -m dpc_jax.stability`.

`case` says what a case is, `runner` runs it against one of the `oracles`; the tables of
cases are in `*_cases`. `random_draws` tries functions over the whole float range,
`descents` follows stiff optimisation. Each gives rows, which `report` writes.
"""

# Subjects by the names that the command line takes, and the modules of their cases.
SUBJECTS = {
    **dict.fromkeys(("rotation", "camera"), "geometry_cases"),
    **dict.fromkeys(("splat", "gaussian", "ray"), "volume_cases"),
    **dict.fromkeys(("image", "cells"), "image_cases"),
    "loss": "loss_cases",
    **dict.fromkeys(("scene", "sum"), "sum_cases"),
    "random": "random_draws",
    "descent": "descents",
}
DTYPES = ("float64", "float32", "bfloat16", "float16")

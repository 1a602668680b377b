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
    **dict.fromkeys(("loss", "choice", "evaluation"), "learning_cases"),
    **dict.fromkeys(("scene", "sum"), "sum_cases"),
    "random": "random_draws",
    "descent": "descents",
}
DTYPES = ("float64", "float32", "bfloat16", "float16")


def check_names(
    flag: str, names: tuple[str, ...] | None, known: tuple[str, ...]
) -> None:
    """Refuse unknown names, and an empty list of names; None stands for all.

    Raises:
      ValueError: a name is not known, or there is none.
    """
    unknown = [name for name in names or () if name not in known]
    if unknown or names == ():
        raise ValueError(
            f"--{flag} must be some of {', '.join(known)}, but "
            f"{', '.join(unknown) or 'nothing'} came; write for example "
            f"--{flag}={known[0]}."
        )

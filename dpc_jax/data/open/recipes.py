"""Which packages have open meshes of a category; loads nothing else."""

RECIPES = {  # category: the modules of `dpc_jax.data.open` that read its packages
    "chair": ("sweethome3d",),
    "car": ("torcs", "trigger_rally", "sweethome3d"),
    "airplane": ("flightgear",),
}

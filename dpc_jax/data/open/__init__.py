"""Open meshes of Debian packages; this names the packages and loads nothing."""

RECIPES = {  # category: the modules of `dpc_jax.data.open` that read its packages
    "chair": ("sweethome3d",),
    "car": ("torcs", "trigger_rally", "sweethome3d"),
    "airplane": ("flightgear",),
}

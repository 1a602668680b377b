"""Training runs of `dpc_jax.main` as processes, side by side, with the time left."""

"""Error against run time: what `python -m dpc_jax.benchmark` measures and writes.

`plan` has the sizes; `report` shows the records.
"""

"""Error against run time: what `python -m dpc_jax.benchmark` measures and writes.

`suite` runs the parts of a `plan.Plan`; `report` shows their records.
"""

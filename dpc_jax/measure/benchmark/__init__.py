"""Error against run time: what `python -m dpc_jax.benchmark` measures and writes.

`suite` lists what a `plan.Plan` measures; `report` shows the records.
"""

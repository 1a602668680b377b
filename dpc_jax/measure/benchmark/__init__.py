"""Error against run time: what `python -m dpc_jax.benchmark` measures and writes.

Each part (speed, error, scaling, memory) is a room that turns a `plan.Plan` into plain
records; `suite` runs the parts, `figures` and `report` show the records.
"""

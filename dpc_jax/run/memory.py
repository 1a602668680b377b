"""Whether the device has the memory that a compiled training step needs."""

import jax

_GB = 1e9


def check_memory(program: jax.stages.Compiled) -> None:
    """Refuse a compiled step that the device's memory cannot hold, before it runs.

    Where the device does not tell its memory, as a CPU, nothing happens.

    Raises:
      ValueError: where the compiler's own layout needs more than there is.
    """
    limit = (jax.local_devices()[0].memory_stats() or {}).get("bytes_limit")
    layout = program.memory_analysis()
    if limit is None or layout is None:
        return
    needed = (
        layout.argument_size_in_bytes
        + layout.output_size_in_bytes
        + layout.temp_size_in_bytes
        - layout.alias_size_in_bytes
    )
    if needed > limit:
        raise ValueError(
            f"A training step must fit into the device's memory of {limit / _GB:.1f} "
            f"GB, but its program needs {needed / _GB:.1f} GB; set "
            "--config.render.renders_at_once=4 to render fewer views side by side, or "
            "--config.train.models_per_batch lower."
        )

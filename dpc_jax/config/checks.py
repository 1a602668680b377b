"""Which values of a config can work, alone and together."""

import dataclasses

from dpc_jax.config.sections import Config

SOURCES = ("meshes", "shapenet", "renders", "images")  # folders that models come from


def check(config: Config):
    """Check every field, and the fields that depend on each other.

    Raises:
      ValueError: for a value that cannot work, naming its field.
    """
    _check_alone(config, "config")
    _check_sources(config)
    _check_sizes(config)


def _check_alone(section, path):
    for field in dataclasses.fields(section):
        value, name = getattr(section, field.name), f"{path}.{field.name}"
        if dataclasses.is_dataclass(value):
            _check_alone(value, name)
        elif "allowed" in field.metadata:
            allowed = field.metadata["allowed"]
            _expect(allowed.holds(value), name, value, allowed.text)


def _expect(holds: bool, name: str, value, expected: str):
    if not holds:
        raise ValueError(
            f"{name} must be {expected}, but it is {value!r}; set another with "
            f"--{name}=VALUE."
        )


def _check_sources(config):
    data, train = config.data, config.train
    given = [name for name in SOURCES if getattr(data, name)]
    if len(given) > 1:
        _expect(
            False,
            f"config.data.{given[-1]}",
            getattr(data, given[-1]),
            f"'' where data.{given[0]} is given: one source at a time",
        )
    _expect(
        bool(data.images) or train.views_per_batch <= data.views,
        "config.train.views_per_batch",
        train.views_per_batch,
        f"at most data.views = {data.views}, the views of a model",
    )
    _expect(
        bool(given) or train.models_per_batch <= data.models,
        "config.train.models_per_batch",
        train.models_per_batch,
        f"at most data.models = {data.models}, the models to train on",
    )
    _expect(
        train.warmup_steps <= train.steps,
        "config.train.warmup_steps",
        train.warmup_steps,
        f"between 0 and train.steps = {train.steps}",
    )


def _check_sizes(config):
    render, size = config.render, config.data.image_size
    _expect(
        size % render.grid == 0,
        "config.render.grid",
        render.grid,
        f"a divisor of data.image_size = {size}, so that masks can be averaged down "
        "to it",
    )
    fine, choice = render.fine_grid, config.pose.choice_grid
    _expect(
        not fine or size % fine == 0 and fine % render.grid == 0,
        "config.render.fine_grid",
        fine,
        f"0, or a multiple of render.grid = {render.grid} that divides "
        f"data.image_size = {size}",
    )
    _expect(
        not choice or render.grid % choice == 0,
        "config.pose.choice_grid",
        choice,
        f"0 or a divisor of render.grid = {render.grid}",
    )

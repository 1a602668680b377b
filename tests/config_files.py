"""The configs of configs/, and the parameters of their networks."""

import importlib.util
from pathlib import Path

import jax
import jax.numpy as jnp

from dpc_jax import main
from dpc_jax.config import check, from_fields, replace_fields
from dpc_jax.outputs import explain
from dpc_jax.run.setup import make_network

FOLDER = Path(__file__).parents[1] / "configs"
NAMES = sorted(path.stem for path in FOLDER.glob("*.py"))
# Of a run of seconds, for the command line.
TINY = {
    "log.every": 1,
    "data.image_size": 16,
    "data.surface_points": 300,
    "network.channels": 2,
    "network.hidden": 16,
    "network.shape_hidden": 16,
    "render.grid": 8,
    "render.fine_grid": 0,
    "render.num_points": 40,
    "pose.choice_top": 0,
}


def load(name, variant=None):
    """The frozen config of a file in configs/."""
    return from_fields(load_editable(name, variant).to_dict())


def change(config, section, **fields):
    """The config with other values in a section."""
    return replace_fields(config, {section: fields})


def load_editable(name, variant=None):
    """What the command line edits."""
    spec = importlib.util.spec_from_file_location(
        f"config_{name}", FOLDER / f"{name}.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.get_config(variant) if variant is not None else module.get_config()


def refuse_flags(arguments):
    """What the command says where it refuses its flags, and None where it does not."""
    try:
        check(main.read_flags(arguments)[1])
    except ValueError as error:
        return explain(error)


def parameter_shapes(config):
    """Shapes of the network's parameters by path; nothing is computed."""
    network = make_network(config)
    size = config.data.image_size
    images = jax.ShapeDtypeStruct((2, size, size, network.inputs), jnp.float32)
    output, variables = jax.eval_shape(
        lambda x: network.init_with_output(jax.random.key(0), x), images
    )
    leaves = jax.tree_util.tree_flatten_with_path(variables["params"])[0]
    return output, {"/".join(k.key for k in path): leaf.shape for path, leaf in leaves}

"""The configs of configs/, and the parameters of their networks."""

import contextlib
import importlib.util
import io
import sys
from pathlib import Path
from unittest import mock

import jax
import jax.numpy as jnp
from absl import flags

from dpc_jax import main
from dpc_jax.config import check, from_config_dict, replace_fields
from dpc_jax.run.setup import make_network

FOLDER = Path(__file__).parents[1] / "configs"
NAMES = sorted(path.stem for path in FOLDER.glob("*.py"))
# Of a run of seconds, for the command line.
TINY = {
    "log.every": 1,
    "data.image_size": 16,
    "data.surface_points": 300,
    "data.processes": 1,
    "network.channels": 2,
    "network.hidden": 16,
    "network.shape_hidden": 16,
    "render.grid": 8,
    "render.fine_grid": 0,
    "render.num_points": 40,
    "pose.choice_points": 0,
}


def load(name, variant=None):
    """The frozen config of a file in configs/."""
    return from_config_dict(load_editable(name, variant))


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
    argv = ["main.py", *arguments]
    before = set(flags.FLAGS)
    with (
        # Values of config fields are found in sys.argv by the flags library.
        mock.patch.object(sys, "argv", argv),
        contextlib.redirect_stderr(io.StringIO()) as error,
    ):
        try:
            main._parse(argv)
            check(from_config_dict(main._CONFIG.value))
        except SystemExit as caught:
            assert caught.code == 2
            return error.getvalue()
        except ValueError as caught:  # is said by the command as a sentence
            return f"Error: {caught}\n"
        finally:
            flags.FLAGS.unparse_flags()
            for name in set(flags.FLAGS) - before:
                delattr(flags.FLAGS, name)


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

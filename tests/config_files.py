"""The configs of configs/, the parameters of their networks, and runs of them."""

import importlib.util
import os
import subprocess
import sys
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


class Command:
    """The main command with the debug config, in processes of their own."""

    def __init__(self, folder, fields, **environment):
        """All runs have `fields` and one data cache, in the folder they start in."""
        self.folder = folder
        self.fields = TINY | fields | {"data.cache_dir": str(folder / "data")}
        self.environment = os.environ | {"JAX_PLATFORMS": "cpu"} | environment
        self.started = []

    def start(self, workdir, *flags, stdout=subprocess.PIPE, **changes):
        process = subprocess.Popen(
            [sys.executable, "-m", "dpc_jax.main", f"--config={FOLDER}/debug.py"]
            + [f"--workdir={workdir}", *flags]
            + [f"--config.{n}={v}" for n, v in (self.fields | changes).items()],
            stdout=stdout,
            stderr=subprocess.PIPE,
            text=True,
            env=self.environment,
            cwd=self.folder,
        )
        self.started.append(process)
        return process


def finish(process, status=0):
    """What a process that ends with a status has printed, and said on stderr."""
    out, error = process.communicate(timeout=1200)
    assert process.returncode == status, out + error
    return out, error

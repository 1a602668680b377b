"""Settings for GPUs that must be made before JAX starts."""

import importlib.metadata
import importlib.util
import os
import re
from collections.abc import MutableMapping

_PLUGINS = ("jax_cuda12_plugin", "jax_cuda13_plugin")
_OPTION = "-nvptx-allow-ftz-atomics"
_FLAG = "--xla_backend_extra_options="
# jaxlib from the first to before the second compiles a float32 scatter-add, by which
# points enter the volume, to a loop of compare-and-swap (jax issue 38806): hundreds of
# times slower where many points meet in a cell. Other versions may not know the option.
_FIRST, _FIXED = (0, 10, 2), (0, 11, 1)


def set_gpu_flags(environment: MutableMapping[str, str] = os.environ) -> bool:
    """Have points added by the GPU's own instruction where jaxlib would not do so.

    Call it before JAX computes anything: XLA reads its flags once. Nothing changes
    without a CUDA plugin, and where jaxlib does not need it.

    Returns:
      Whether the flag is set.
    """
    if not any(importlib.util.find_spec(name) for name in _PLUGINS):
        return False
    if not needs_flag(importlib.metadata.version("jaxlib")):
        return False
    environment["XLA_FLAGS"] = add_option(environment.get("XLA_FLAGS", ""))
    return True


def needs_flag(version: str) -> bool:
    """Whether a version of jaxlib, such as "0.10.2", has the slow scatter-add."""
    numbers = re.match(r"(\d+)\.(\d+)\.(\d+)", version)
    return numbers is not None and _FIRST <= tuple(map(int, numbers.groups())) < _FIXED


def add_option(flags: str) -> str:
    """XLA's flags with the option, beside others that are given already."""
    words = flags.split()
    for i, word in enumerate(words):
        if word.startswith(_FLAG):
            given = [part for part in word.removeprefix(_FLAG).split(",") if part]
            words[i] = _FLAG + ",".join(dict.fromkeys([*given, _OPTION]))
            return " ".join(words)
    return " ".join([*words, _FLAG + _OPTION])

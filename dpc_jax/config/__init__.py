"""The settings of a run, each stated once.

`sections` has every field with its default, unit and allowed values; `variants` the
paper's values and others; `face` turns them into the `ml_collections` config that the
command line edits, and back.
"""

from dpc_jax.config.checks import check as check
from dpc_jax.config.face import from_fields as from_fields
from dpc_jax.config.face import list_fields as list_fields
from dpc_jax.config.face import list_shipped as list_shipped
from dpc_jax.config.face import locate_config as locate_config
from dpc_jax.config.face import name_differences as name_differences
from dpc_jax.config.face import to_config_dict as to_config_dict
from dpc_jax.config.face import to_json as to_json
from dpc_jax.config.sections import CROPS as CROPS
from dpc_jax.config.sections import ELEVATIONS as ELEVATIONS
from dpc_jax.config.sections import FILL as FILL
from dpc_jax.config.sections import Config as Config
from dpc_jax.config.sections import Data as Data
from dpc_jax.config.sections import Log as Log
from dpc_jax.config.sections import Network as Network
from dpc_jax.config.sections import Pose as Pose
from dpc_jax.config.sections import Render as Render
from dpc_jax.config.sections import Train as Train
from dpc_jax.config.variants import VARIANTS as VARIANTS
from dpc_jax.config.variants import build_config as build_config
from dpc_jax.config.variants import replace_fields as replace_fields

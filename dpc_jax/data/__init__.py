"""Data: sources of models, rendered views, the cache on disk, batches.

Only what training needs is exported here. `meshes`, `views` and the modules of `sets`
load trimesh or Pillow; they are imported where models are listed or rendered.
"""

from dpc_jax.data.arrays import DataSet as DataSet
from dpc_jax.data.batches import choose_batch as choose_batch
from dpc_jax.data.batches import read_batch as read_batch
from dpc_jax.data.dataset import load_or_render as load_or_render
from dpc_jax.data.spec import DataSpec as DataSpec
from dpc_jax.data.splits import split_files as split_files

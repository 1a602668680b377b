"""Data: procedural shapes, mesh files, rendered views, the cache, batches.

Only what training needs is exported here; `procedural`, `meshes` and `views` import
trimesh and are imported by name where shapes are made or rendered.
"""

from dpc_jax.data.batches import choose_batch as choose_batch
from dpc_jax.data.batches import read_batch as read_batch
from dpc_jax.data.dataset import DataSet as DataSet
from dpc_jax.data.dataset import load_or_render as load_or_render
from dpc_jax.data.spec import DataSpec as DataSpec
from dpc_jax.data.spec import split_files as split_files

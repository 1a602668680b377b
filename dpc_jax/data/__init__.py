"""Data: procedural shapes, mesh files, rendered views, the cache, batches.

Only what training needs is exported here; `procedural`, `meshes` and `views` import
trimesh and are imported by name where shapes are made or rendered.
"""

from .batches import choose_batch as choose_batch
from .batches import read_batch as read_batch
from .dataset import DataSet as DataSet
from .dataset import load_or_render as load_or_render
from .sources import DataSpec as DataSpec
from .sources import split_files as split_files

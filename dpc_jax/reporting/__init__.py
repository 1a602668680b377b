"""What a run leaves for its reader: figures, an HTML page, tables and point clouds.

Import the rooms themselves (``dpc_jax.reporting.page`` and so on): only ``figures`` and
``page`` need matplotlib, so that writing a point cloud does not load it.
"""

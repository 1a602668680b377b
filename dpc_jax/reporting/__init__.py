"""What a run leaves for its reader: figures, an HTML page, tables and point clouds.

Import the modules themselves (`dpc_jax.reporting.page` and so on): only those that draw
need matplotlib, so that writing a point cloud does not load it.
"""

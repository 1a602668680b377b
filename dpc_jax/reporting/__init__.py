"""What a run leaves for its reader: figures, an HTML page, tables and point clouds.

Import the modules themselves: only those that draw load matplotlib.
"""

"""What a run leaves for its reader: figures, an HTML page, tables and point clouds.

Import the modules themselves: only those that draw load matplotlib.
"""

import logging

# Of its cache of fonts, which it makes when first imported: no news of a run.
logging.getLogger("matplotlib.font_manager").setLevel(logging.ERROR)

"""The paper's experiments: their runs, the figures, and the page beside the paper's."""

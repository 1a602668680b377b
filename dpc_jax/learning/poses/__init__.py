"""Where the poses of a batch come from, and how they are learned."""

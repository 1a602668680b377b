"""A run of several processes, on one host or many."""

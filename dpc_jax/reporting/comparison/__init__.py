"""Runs side by side: what was asked of each, what it reached, and its curves."""

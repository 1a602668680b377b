"""Kinds of shapes: what losses, predictions and evaluation ask of each."""

from dpc_jax.learning.shapes.kind import Shape as Shape
from dpc_jax.learning.shapes.kind import find_shape_class as find_shape_class

"""What the catalogue can be asked for by name; loads nothing else."""

# Names of subjects on the command line, and the modules of their cases.
SUBJECTS = {
    "rotation": "rotations",
    "camera": "cameras",
    "splat": "volumes",
    "gaussian": "gaussians",
    "ray": "rays",
    "image": "images",
    "cells": "object_volumes",
    "loss": "losses",
    "learning": "learning",
    "evaluation": "evaluation",
}
DTYPES = ("float64", "float32", "bfloat16", "float16")

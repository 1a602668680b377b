"""The projection in PyTorch, by the same steps as the engine.

Each point adds to its eight neighbours, products with the kernel's Toeplitz matrix
smooth the volume, a product along each ray ends it. Every derivative is PyTorch's own,
and a batch is rendered at once.
"""

import importlib.util
import itertools
from collections.abc import Callable

import numpy as np

from dpc_jax.render import Camera
from dpc_jax.render.devices import find_platform


def has_torch() -> bool:
    """Whether PyTorch is installed; asking does not load it."""
    return importlib.util.find_spec("torch") is not None


def make_torch_call(
    arrays: tuple[np.ndarray, ...], targets: np.ndarray, *, sigma: float
) -> Callable[[], list[np.ndarray]]:
    """A call that gives the gradients of points, quaternions and masses in PyTorch.

    On the GPU where JAX computes there; the gradients then travel back, a few MB.
    """
    import torch  # pyright: ignore[reportMissingImports]  # optional

    torch.set_flush_denormal(True)  # as XLA: the kernel's tails take five times as long
    device = torch.device("cuda" if find_platform() == "gpu" else "cpu")
    given = [torch.tensor(value, device=device) for value in (*arrays, targets)]

    def call():
        inputs = [value.clone().requires_grad_() for value in given[:-1]]
        with device:  # of what is made on the way
            images = _render_in_torch(torch, inputs, sigma, targets.shape[-1])
        ((images - given[-1]) ** 2).sum().backward()
        return [value.grad.cpu().numpy() for value in inputs]

    return call


def _render_in_torch(torch, inputs, sigma, side):
    points, quaternions, masses = inputs
    camera = Camera()
    batch, padded = points.shape[0], side + 2
    w, v = (quaternions / quaternions.norm(dim=-1, keepdim=True)).split([1, 3], -1)
    w, v = w[:, None], v[:, None].expand_as(points)
    turned = torch.linalg.cross(v, points)  # p + 2w(v×p) + 2v×(v×p)
    moved = points + 2 * (w * turned + torch.linalg.cross(v, turned))
    x, y, depth = moved.unbind(-1)
    zoom = camera.focal_length / (depth + camera.distance)
    place = (torch.stack([y * zoom, x * zoom, depth], -1) + 0.5) * side - 0.5
    is_inside = ((place >= -0.5) & (place <= side - 0.5)).all(-1)
    first = torch.floor(place)
    fraction = place - first
    first = (first.long() + 1).clamp(0, side)
    mass = torch.where(is_inside, masses[:, None], torch.zeros(()))
    start = torch.arange(batch)[:, None] * padded**3
    indices, weights = [], []
    for corner in itertools.product((0, 1), repeat=3):
        weight = mass
        for axis, is_upper in enumerate(corner):
            part = fraction[..., axis]
            weight = weight * (part if is_upper else 1 - part)
        row, col, depth = (first + torch.tensor(corner)).unbind(-1)
        indices.append(start + (row * padded + col) * padded + depth)
        weights.append(weight)
    volume = torch.zeros(batch * padded**3).index_add(
        0, torch.stack(indices).reshape(-1), torch.stack(weights).reshape(-1)
    )
    volume = volume.reshape(batch, padded, padded, padded)[:, 1:-1, 1:-1, 1:-1]
    cells = torch.arange(side, dtype=torch.float32)
    far = torch.arange(-4 * side, 4 * side + 1)
    kernel = torch.exp(-0.5 * ((cells[:, None] - cells) / sigma) ** 2)
    kernel = kernel / torch.exp(-0.5 * (far / sigma) ** 2).sum()
    volume = kernel @ (volume @ kernel)
    volume = (kernel @ volume.reshape(batch, side, -1)).reshape(volume.shape)
    return 1 - torch.prod(1 - volume.clamp(0, 1), -1)

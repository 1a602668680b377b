"""The projection as one would first write it in PyTorch, a batch at once.

The steps are those of `plain_peer`; every derivative is PyTorch's own. This is a module
of its own because PyTorch (`pip install '.[bench]'`) may not be installed.
"""

from collections.abc import Callable

import numpy as np
import torch  # pyright: ignore[reportMissingImports]  # optional

from dpc_jax.measure.benchmark.plain_peer import CORNERS
from dpc_jax.measure.benchmark.speed import Work
from dpc_jax.render.camera import Camera


def make_call(work: Work, *, sigma: float) -> Callable[[], list[np.ndarray]]:
    """A call that gives the gradients of points, quaternions and masses in PyTorch."""
    side = work.targets.shape[-1]
    target = torch.tensor(work.targets)

    def call():
        inputs = [torch.tensor(value, requires_grad=True) for value in work[:3]]
        images = _render_in_torch(inputs, sigma, side)
        ((images - target) ** 2).sum().backward()
        return [value.grad.numpy() for value in inputs]

    return call


def _render_in_torch(inputs, sigma, side):
    points, quaternions, masses = inputs
    camera = Camera()
    batch = points.shape[0]
    moved = torch.bmm(points, _turn_to_matrix(quaternions).transpose(1, 2))
    x, y, depth = moved.unbind(-1)
    zoom = camera.focal_length / (depth + camera.distance)
    place = (torch.stack([y * zoom, x * zoom, depth], -1) + 0.5) * side - 0.5
    is_inside = ((place >= -0.5) & (place <= side - 0.5)).all(-1)
    first = torch.floor(place)
    fraction = place - first
    padded = side + 2
    first = (first.long() + 1).clamp(0, side)
    mass = torch.where(is_inside, masses[:, None], torch.zeros(()))
    start = torch.arange(batch)[:, None] * padded**3
    indices, weights = [], []
    for corner in CORNERS:
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


def _turn_to_matrix(quaternions):
    """Rotation matrices [B, 3, 3] of quaternions wxyz [B, 4] of any length."""
    w, x, y, z = (quaternions / quaternions.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, -1) for row in rows], -2)

"""A second renderer in float64: triangles are drawn into a z-buffer, no rays cast."""

import numpy as np

FOCAL, DISTANCE = 1.875, 2.0


def draw_triangles(mesh, rotation, *, count):
    """(z [count, count], inf where empty, face [count, count], -1 there) at samples.

    An edge function tells which samples a triangle covers, rims included; 1/z is
    linear on the image plane. All of the mesh has to lie before the camera.
    """
    centres = (np.arange(count) + 0.5) / count - 0.5
    nearest = np.full((count, count), np.inf)
    owner = np.full((count, count), -1)
    points = np.asarray(mesh.vertices) @ rotation.T + [0.0, 0.0, DISTANCE]
    flat = FOCAL * points[:, :2] / points[:, 2:]
    for number, face in enumerate(mesh.faces):
        (a, b, c), z = flat[face], points[face, 2]
        low, high = flat[face].min(axis=0), flat[face].max(axis=0)
        cols = np.flatnonzero((centres >= low[0]) & (centres <= high[0]))
        rows = np.flatnonzero((centres >= low[1]) & (centres <= high[1]))
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if not len(cols) or not len(rows) or area == 0:
            continue
        u, v = np.meshgrid(centres[cols], centres[rows])
        second = ((u - a[0]) * (c[1] - a[1]) - (v - a[1]) * (c[0] - a[0])) / area
        third = ((b[0] - a[0]) * (v - a[1]) - (b[1] - a[1]) * (u - a[0])) / area
        first = 1.0 - second - third
        depth = 1.0 / (first / z[0] + second / z[1] + third / z[2])
        here = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
        wins = (first >= 0) & (second >= 0) & (third >= 0) & (depth < nearest[here])
        nearest[here][wins], owner[here][wins] = depth[wins], number
    return nearest, owner


def shade(mesh, rotation, lights):
    """Colours [F, 3] by Lambert of the side of each face that looks at the camera."""
    eye = -DISTANCE * rotation[2]
    colors = []
    for corners, color in zip(mesh.triangles, mesh.visual.face_colors, strict=True):
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        normal = normal / np.linalg.norm(normal)
        if normal @ (eye - corners[0]) < 0:
            normal = -normal
        light = lights.ambient + sum(
            strength * max(0.0, normal @ towards)
            for towards, strength in zip(lights.towards, lights.strength, strict=True)
        )
        colors.append(np.minimum(np.asarray(color[:3], float) * light, 255.0))
    return np.array(colors)


def render(mesh, rotation, *, image_size, supersample, lights=None):
    """(coverage [S, S], mean depth [S, S], mean colour [S, S, 3] or None)."""
    z, face = draw_triangles(mesh, rotation, count=image_size * supersample)
    shape = (image_size, supersample, image_size, supersample)
    hits = np.isfinite(z).reshape(shape).sum(axis=(1, 3))
    total = np.where(np.isfinite(z), z, 0.0).reshape(shape).sum(axis=(1, 3))
    image = None
    if lights is not None:
        colors = np.concatenate([shade(mesh, rotation, lights), [[255.0] * 3]])
        image = colors[face].reshape(*shape, 3).mean(axis=(1, 3))
    return hits / supersample**2, total / np.maximum(hits, 1), image

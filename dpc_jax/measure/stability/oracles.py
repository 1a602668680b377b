"""The equations written out in long double numpy; no code shared with the package.

Every function takes real or complex arrays and makes its decisions on real parts alone,
because an imaginary part of 1e-60 carries a derivative through it. The tests of the
renderer compare with these functions too.
"""

import math

import numpy as np

# On x86 it has 64 bits of fraction and 15 of exponent, so the squares of 1e30 and 1e-30
# are well within its range. On every machine it is at least float64.
REAL, COMPLEX = np.longdouble, np.clongdouble
Array = np.ndarray
Number = Array | np.number | float
Shape = tuple[int, int, int]
PI = REAL("3.14159265358979323846264338327950288")


def root_sum(x: Array) -> Array:
    """√Σx², without the complex conjugate of a norm."""
    return np.sqrt(np.sum(x * x))


def flip_sign(x: Array) -> Array:
    """|x| with a derivative; at 0 the slope is one."""
    return np.where(np.real(x) < 0, -x, x)


def normalize(q: Array) -> Array:
    """q/‖q‖; for q = 0 the identity, with zero slope."""
    if np.all(np.real(q) == 0):
        return np.array([1, 0, 0, 0], REAL)
    return q / root_sum(q)


def multiply(p: Array, q: Array) -> Array:
    """Hamilton product, as (w, v): (w₁w₂ - v₁·v₂, w₁v₂ + w₂v₁ + v₁×v₂)."""
    w, v, u, x = p[0], p[1:], q[0], q[1:]
    return np.concatenate(
        [np.array([w * u - np.sum(v * x)]), w * x + u * v + np.cross(v, x)]
    )


def rotate(points: Array, q: Array) -> Array:
    """q·(0, p)·q⁻¹ for each point p; the matrix product if q is a matrix."""
    if q.shape == (3, 3):
        return points @ q.T
    q = normalize(q)
    reverse = q * np.array([1, -1, -1, -1])
    moved = [multiply(multiply(q, np.array([0, *p])), reverse)[1:] for p in points]
    return np.array(moved).reshape(-1, 3)


def angle(p: Array, q: Array) -> Array:
    """2·atan(‖v‖/|w|) of p·q⁻¹; π - 2·atan(|w|/‖v‖) where ‖v‖ is larger."""
    turn = multiply(normalize(p), normalize(q) * np.array([1, -1, -1, -1]))
    sine, cosine = root_sum(turn[1:]), flip_sign(turn[0])
    if np.real(sine) == 0:  # a kink: zero slope, as documented
        return np.zeros((), REAL)
    if np.real(sine) <= np.real(cosine):
        return 2 * np.arctan(sine / cosine)
    return PI - 2 * np.arctan(cosine / sine)


def place(
    points: Array,
    q: Array,
    focal: Number = 1.875,
    distance: Number = 2.0,
    *,
    shape: Shape,
    translation: Number = 0.0,
    extent: float = 1.0,
    orthographic: bool = False,
) -> tuple[Array, Array]:
    """Continuous (row, col, depth) indices, 0 outside, and whether a point is inside.

    A point nearer to the camera than a millionth of the extent has no image.
    """
    x, y, z = (rotate(points, q) + translation).T
    ahead = z + distance
    u, v, is_before = x, y, np.ones(len(points), bool)
    if not orthographic:
        is_before = np.real(ahead) > 1e-6 * extent
        safe = np.where(is_before, ahead, 1)
        u, v = focal * x / safe, focal * y / safe
    shares = np.stack([v, u, z], axis=-1) / extent + REAL(0.5)
    is_inside = is_before & np.all((np.real(shares) >= 0) & (np.real(shares) <= 1), 1)
    coordinates = shares * np.array(shape) - REAL(0.5)
    return np.where(is_inside[:, None], coordinates, 0), is_inside


def splat(coordinates: Array, values: Array, shape: Shape, order: int = 1) -> Array:
    """Σ of products of B-splines along the axes; order 1 is trilinear."""
    places = np.real(coordinates)
    is_inside = np.all((places >= -0.5) & (places <= np.array(shape) - 0.5), axis=1)
    weights = [
        _find_splines(x, size, order)
        for x, size in zip(coordinates.T, shape, strict=True)
    ]
    return np.einsum("n,ni,nj,nk->ijk", np.where(is_inside, values, 0), *weights)


def _find_splines(places, size, order=1):
    """Weights [n, size] of the cells at each place, a B-spline.

    Σ_k (-1)^k·C(n + 1, k)·max(d + (n + 1)/2 - k, 0)^n/n!; at a kink of order 1 the side
    towards the higher index.
    """
    half = REAL(order + 1) / 2
    away = np.arange(size) - places[:, None]
    weights = 0
    for k in range(order + 2):
        start = away + half - k
        power = np.where(np.real(start) > 0, start, 0) ** order
        weights = weights + (-1) ** k * math.comb(order + 1, k) * power
    # Beyond the last knot the powers cancel, but for rounding.
    is_near = (np.real(away) > -half) & (np.real(away) <= half)
    return np.where(is_near, weights, 0) / math.factorial(order)


def weigh(cells: Array, center: Number, sigma: Number) -> Array:
    """exp(-(i - x)²/2σ²) over its sum on all integers; σ at least 0.02, as documented.

    Cells and centers have any shapes that broadcast.
    """
    center = np.asarray(center)
    if np.real(sigma) < 0.02:
        sigma = REAL(0.02)
    if np.real(sigma) < 4:
        reach = int(30 * float(np.real(sigma))) + 4
        wide = np.round(np.real(center))[..., None] + np.arange(-reach, reach + 1)
        away = wide - center[..., None]
        total = np.sum(np.exp(-(away**2) / (2 * sigma * sigma)), axis=-1)
    else:  # the integral; the next term of Poisson's formula is exp(-2π²σ²), 1e-137
        total = np.sqrt(2 * PI) * sigma
    return np.exp(-((cells - center) ** 2) / (2 * sigma * sigma)) / total


def smooth(volume: Array, sigma: Number) -> Array:
    """Direct sums over all cells, axis by axis."""
    for axis, size in enumerate(volume.shape):
        matrix = weigh(np.arange(size), np.arange(size)[:, None], sigma)
        volume = np.moveaxis(np.tensordot(matrix, volume, axes=(1, axis)), 0, axis)
    return volume


def sum_covariances(
    coordinates: Array, masses: Array, covariances: Array, shape: Shape
) -> Array:
    """Σ of Gaussians: the widest axis first, then each axis given those before it.

    An axis without a variance of its own tells nothing of the others.
    """
    volume, cells = np.zeros(shape), np.ogrid[tuple(slice(size) for size in shape)]
    for point, block, matrix in zip(coordinates, masses, covariances, strict=True):
        left, means, free = (matrix + matrix.T) / 2, list(point), {0, 1, 2}
        while free:  # pivoted elimination: what each axis leaves of the rest
            pivot = max(free, key=lambda a: float(np.real(left[a, a])))
            free.remove(pivot)
            variance, away = left[pivot, pivot], cells[pivot] - means[pivot]
            is_wide = np.real(variance) > 0
            width = np.sqrt(variance) if is_wide else REAL(0)
            block = block * weigh(cells[pivot], means[pivot], width)
            if is_wide:
                slopes = left[pivot] / variance
                left = left - np.outer(left[pivot], slopes)
                means = [m + slopes[a] * away for a, m in enumerate(means)]
        volume = volume + block
    return volume


def clip(density: Array) -> Array:
    """Clip to [0, 1]; at both ends the slope of the inner side."""
    real = np.real(density)
    return np.where(real < 0, 0, np.where(real > 1, 1, density))


def find_transparencies(occupancy: Array) -> Array:
    """Π_{u<k}(1 - o_u) for every cell k along the last axis, and for the background."""
    ones = np.ones((*occupancy.shape[:-1], 1))
    return np.cumprod(np.concatenate([ones, 1 - occupancy], axis=-1), axis=-1)


def terminate(occupancy: Array) -> tuple[Array, Array]:
    """(o_k·Π_{u<k}(1 - o_u), Π(1 - o)) cell by cell along the last axis."""
    passed = find_transparencies(occupancy)
    return occupancy * passed[..., :-1], passed[..., -1]


def find_opacity(occupancy: Array) -> Array:
    """Σ_k r_k, because 1 - Π(1 - o) would cancel."""
    return np.sum(terminate(occupancy)[0], axis=-1)


def project(
    points: Array,
    rotation: Array,
    sizes: Array,
    scale: Number,
    colors: Array,
    *scene: Number,
    shape: Shape,
    method: str = "trilinear",
    **lens,
) -> tuple[Array, Array, Array]:
    """(silhouette, depth, color [rows, cols, C]) of one cloud; see `dpc_jax.project`.

    Sizes are sigma, or covariances in the object's frame for the method "covariance".
    The scene is translation, focal length, distance, background's depth and colour; the
    lens is `extent` and `orthographic`.
    """
    translation, focal, distance, *background = scene
    coordinates, is_inside = place(
        *(points, rotation, focal, distance),
        **(lens | {"shape": shape, "translation": translation}),
    )
    masses = np.where(is_inside, scale * np.ones(len(points)), 0)
    if method == "covariance":
        ahead = rotate(points, rotation) + translation + distance * np.eye(3)[2]
        sizes = move_covariances(sizes, rotation, ahead, focal, shape=shape)
    if method == "gaussian":
        sigmas = sizes * np.ones(len(points))
        sizes = sigmas[:, None, None] ** 2 * np.eye(3)

    def fill(values):
        if method in ("covariance", "gaussian"):
            return sum_covariances(coordinates, values, sizes, shape)
        order = {"trilinear": 1, "quadratic": 2, "cubic": 3}[method]
        # Less the variance of the spline, but of the trilinear one.
        left = sizes * sizes - (REAL(order + 1) / 12 if order > 1 else 0)
        smoothed = np.sqrt(left) if np.real(left) > 0 else REAL(0)
        return smooth(splat(coordinates, values, shape, order), smoothed)

    densities = [fill(masses * values) for values in (1, *colors.T)]
    extent = lens.get("extent", 1.0)
    return end_rays(densities, distance, *background, extent=extent)


def end_rays(
    densities: list[Array],
    distance: Number,
    background_depth: Number = 10.0,
    background_color: Number = 1.0,
    *,
    extent: float = 1.0,
) -> tuple[Array, Array, Array]:
    """Silhouette, depth and colour from densities Σ f, and Σ y·f of each channel."""
    density, *channels = densities
    occupancy = clip(density)
    probabilities, passed = terminate(occupancy)
    cells = _find_centres(density.shape[2], extent)
    depth = np.sum(probabilities * (cells + distance), axis=-1)
    # r·y with y = Σ y_i f_i / Σ f_i. Up to density 1 the factor o / Σ f is one, also in
    # the limit of no density.
    before = find_transparencies(occupancy)[..., :-1]
    is_over = np.real(density) > 1
    share = np.where(is_over, 1 / np.where(is_over, density, 1), 1)
    color = [np.sum(before * share * channel, axis=-1) for channel in channels]
    return (
        np.sum(probabilities, axis=-1),
        depth + passed * background_depth,
        np.stack(color, axis=-1) + passed[..., None] * background_color,
    )


def _find_centres(size, extent):
    """Coordinates of the cells along an axis."""
    return ((np.arange(size) + REAL(0.5)) / size - REAL(0.5)) * extent


def move_covariances(
    covariances: Array, rotation: Array, ahead: Array, focal: Number, *, shape: Shape
) -> Array:
    """S·J·R·Σ·Rᵀ·Jᵀ·S written out, where J is the Jacobian of (f·y/z, f·x/z, z)."""
    axes = rotate(np.eye(3), rotation).T  # columns: where the axes go
    stretch = np.array(shape)[:, None] / REAL(shape[0])
    x, y, z = ahead.T
    zoom, none = focal / z, 0 * z
    rows = [none, zoom, -zoom * y / z], [zoom, none, -zoom * x / z]
    slopes = np.moveaxis(np.array([*rows, [none, none, none + 1]]), -1, 0)
    linear = stretch * slopes @ axes
    symmetric = (covariances + np.swapaxes(covariances, 1, 2)) / 2
    return linear @ symmetric @ np.swapaxes(linear, 1, 2)


def project_volume(
    volume: Array,
    colors: Array,
    rotation: Array,
    translation: Array,
    focal: Number,
    distance: Number,
    *background: Number,
    shape: Shape,
    extent: float = 1.0,
    orthographic: bool = False,
) -> tuple[Array, Array, Array]:
    """(silhouette, depth, color [rows, cols, C]) of occupancies of the object frame.

    See `dpc_jax.project_volume`: at every cell of the grid the tents of all cells.
    """
    centres = [_find_centres(size, extent) for size in shape]
    v, u, z = (part.ravel() for part in np.meshgrid(*centres, indexing="ij"))
    ahead = z + distance
    is_ahead = np.ones(len(z), bool) if orthographic else np.real(ahead) > 1e-6 * extent
    zoom = 1 if orthographic else np.where(is_ahead, ahead, 1) / focal
    moved = np.stack([u * zoom, v * zoom, z], axis=-1) - translation
    turned = moved @ rotate(np.eye(3), rotation).T
    edges = np.array(volume.shape)
    cells = (turned + REAL(0.5)) * edges - REAL(0.5)
    weights = [_find_splines(x, size) for x, size in zip(cells.T, edges, strict=True)]
    # Nothing beyond a cell from the rim.
    is_seen = is_ahead & np.all((np.real(cells) > -1) & (np.real(cells) < edges), 1)

    def sample(values):
        found = np.einsum("nx,ny,nz,xyz->n", *weights, values)
        return np.where(is_seen, found, 0).reshape(shape)

    densities = [sample(volume * values) for values in (1, *np.moveaxis(colors, -1, 0))]
    return end_rays(densities, distance, *background, extent=extent)

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
        return np.sum(points[:, None, :] * q, axis=-1)
    q = normalize(q)
    reverse = q * np.array([1, -1, -1, -1])
    pure = [np.concatenate([np.zeros(1), p]) for p in points]
    moved = [multiply(multiply(q, p), reverse)[1:] for p in pure]
    return np.array(moved).reshape(-1, 3)


def angle(p: Array, q: Array) -> Array:
    """2·atan(‖v‖/|w|) of p·q⁻¹; π - 2·atan(|w|/‖v‖) where ‖v‖ is larger."""
    turn = multiply(normalize(p), normalize(q) * np.array([1, -1, -1, -1]))
    sine, cosine = root_sum(turn[1:]), flip_sign(turn[0])
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


def splat(coordinates: Array, values: Array, shape: Shape) -> Array:
    """Trilinear weights, products of 1 - |x - i| along the axes."""
    volume = np.zeros(shape, np.result_type(coordinates, values))
    for point, value in zip(coordinates, values, strict=True):
        real = np.real(point)
        if np.any(real < -0.5) or np.any(real > np.array(shape) - 0.5):
            continue
        block = np.asarray(value)
        for x, size in zip(point, shape, strict=True):
            away = x - np.arange(size)
            # At a kink, the side towards the higher index.
            is_near = (np.real(away) >= -1) & (np.real(away) < 1)
            tent = np.where(np.real(away) >= 0, 1 - away, 1 + away)
            block = np.multiply.outer(block, np.where(is_near, tent, 0))
        volume = volume + block
    return volume


def splat_splines(coordinates: Array, values: Array, shape: Shape, order: int) -> Array:
    """B-splines as Σ_k (-1)^k·C(n + 1, k)·max(d + (n + 1)/2 - k, 0)^n/n!."""
    volume = np.zeros(shape, np.result_type(coordinates, values))
    for point, value in zip(coordinates, values, strict=True):
        block = np.asarray(value)
        for x, size in zip(point, shape, strict=True):
            weights = np.zeros(size, volume.dtype)
            for k in range(order + 2):
                start = np.arange(size) - x + REAL((order + 1) / 2) - k
                power = np.where(np.real(start) > 0, start, 0) ** order
                weights = weights + (-1) ** k * math.comb(order + 1, k) * power
            # Beyond the last knot the powers cancel, but for rounding.
            is_near = np.abs(np.arange(size) - np.real(x)) < (order + 1) / 2
            share = np.where(is_near, weights, 0) / math.factorial(order)
            block = np.multiply.outer(block, share)
        volume = volume + block
    return volume


def weigh(cells: Array, center: Number, sigma: Number) -> Array:
    """exp(-(i - x)²/2σ²) over its sum on all integers; σ at least 0.02, as documented.

    Cells are [n], centers have any shape [...]; the weights are [..., n].
    """
    center = np.asarray(center)[..., None]
    nearest = np.round(np.real(center))
    if np.real(sigma) < 0.02:
        sigma = REAL(0.02)
    if np.real(sigma) < 4:
        reach = int(30 * float(np.real(sigma))) + 4
        wide = nearest + np.arange(-reach, reach + 1)
        total = np.sum(np.exp(-((wide - center) ** 2) / (2 * sigma * sigma)), axis=-1)
    else:  # the integral; the next term of Poisson's formula is exp(-2π²σ²), 1e-137
        total = np.sqrt(2 * PI) * sigma * np.ones(center.shape[:-1])
    weights = np.exp(-((np.asarray(cells) - center) ** 2) / (2 * sigma * sigma))
    return weights / total[..., None]


def smooth(volume: Array, sigma: Number) -> Array:
    """Direct sums over all cells, axis by axis."""
    for axis, size in enumerate(volume.shape):
        cells = np.arange(size)
        matrix = np.stack([weigh(cells, REAL(i), sigma) for i in range(size)])
        volume = np.moveaxis(np.tensordot(matrix, volume, axes=(1, axis)), 0, axis)
    return volume


def sum_gaussians(
    coordinates: Array, masses: Array, sigmas: Number, shape: Shape
) -> Array:
    """Σ of separable Gaussians, point by point; one sigma for all, or one each."""
    volume = np.zeros(shape)
    sigmas = sigmas * np.ones(len(coordinates))
    for point, mass, sigma in zip(coordinates, masses, sigmas, strict=True):
        block = np.asarray(mass)
        for x, size in zip(point, shape, strict=True):
            block = np.multiply.outer(block, weigh(np.arange(size), x, sigma))
        volume = volume + block
    return volume


def sum_covariances(
    coordinates: Array, masses: Array, covariances: Array, shape: Shape
) -> Array:
    """Σ of Gaussians: the widest axis first, then each axis given those before it."""
    volume = np.zeros(shape)
    for point, mass, matrix in zip(coordinates, masses, covariances, strict=True):
        matrix = (matrix + matrix.T) / 2
        order, left = [], matrix
        for _ in range(3):  # pivoted elimination: what each axis leaves of the rest
            free = [a for a in range(3) if a not in order]
            pivot = max(free, key=lambda a: float(np.real(left[a, a])))
            order.append(pivot)
            if np.real(left[pivot, pivot]) > 0:
                column = left[:, pivot]
                left = left - np.outer(column, column) / left[pivot, pivot]
        matrix, mean = matrix[np.ix_(order, order)], point[order]
        first, second, third = (np.arange(shape[a]) for a in order)
        slope, across = _regress(matrix, 1)
        slopes, along = _regress(matrix, 2)
        away = first - mean[0]
        middle = mean[1] + slope[0] * away
        block = weigh(first, mean[0], np.sqrt(matrix[0, 0]))[:, None]
        block = block * weigh(second, middle, np.sqrt(across))
        end = mean[2] + slopes[0] * away[:, None] + slopes[1] * (second - mean[1])
        block = block[..., None] * weigh(third, end, np.sqrt(along))
        volume = volume + mass * np.transpose(block, np.argsort(order))
    return volume


def _regress(matrix, count):
    """Slopes of an axis on the `count` axes before it, and the variance they leave.

    An axis without a variance of its own tells nothing and gets no slope.
    """
    known, cross = matrix[:count, :count], matrix[count, :count]
    gain = np.zeros(count, matrix.dtype)
    if count == 2 and np.real(_find_minor(known)) > 0:
        turned = np.array([[known[1, 1], -known[0, 1]], [-known[1, 0], known[0, 0]]])
        gain = np.array([np.sum(cross * turned[:, k]) for k in (0, 1)])
        gain = gain / _find_minor(known)
    elif np.real(known[0, 0]) > 0:
        gain[0] = cross[0] / known[0, 0]
    variance = matrix[count, count] - np.sum(gain * cross)
    return gain, variance if np.real(variance) > 0 else 0 * variance


def _find_minor(matrix):
    return matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]


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
        **({"shape": shape, "translation": translation} | lens),
    )
    masses = np.where(is_inside, scale * np.ones(len(points)), 0)
    if method == "covariance":
        ahead = rotate(points, rotation) + translation + distance * np.eye(3)[2]
        sizes = move_covariances(sizes, rotation, ahead, focal, shape=shape)

    def fill(values):
        if method == "covariance":
            return sum_covariances(coordinates, values, sizes, shape)
        if method == "gaussian":
            return sum_gaussians(coordinates, values, sizes, shape)
        if method != "trilinear":
            order = {"quadratic": 2, "cubic": 3}[method]
            left = sizes * sizes - REAL(order + 1) / 12
            smoothed = np.sqrt(left) if np.real(left) > 0 else REAL(0)
            return smooth(splat_splines(coordinates, values, shape, order), smoothed)
        return smooth(splat(coordinates, values, shape), sizes)

    channels = [fill(masses * channel) for channel in colors.T]
    extent = lens.get("extent", 1.0)
    return end_rays(fill(masses), channels, distance, *background, extent=extent)


def end_rays(
    density: Array,
    channels: list[Array],
    distance: Number,
    background_depth: Number = 10.0,
    background_color: Number = 1.0,
    *,
    extent: float = 1.0,
) -> tuple[Array, Array, Array]:
    """Silhouette, depth and colour from the densities Σ f and Σ y·f."""
    occupancy = clip(density)
    probabilities, passed = terminate(occupancy)
    num_cells = density.shape[2]
    cells = ((np.arange(num_cells) + REAL(0.5)) / num_cells - REAL(0.5)) * extent
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


def move_covariances(
    covariances: Array, rotation: Array, ahead: Array, focal: Number, *, shape: Shape
) -> Array:
    """S·J·R·Σ·Rᵀ·Jᵀ·S written out, where J is the Jacobian of (f·y/z, f·x/z, z)."""
    axes = rotate(np.eye(3), rotation).T  # columns: where the axes go
    stretch = np.array(shape)[:, None] / REAL(shape[0])
    moved = []
    for (x, y, z), matrix in zip(ahead, covariances, strict=True):
        zoom, none = focal / z, 0 * z
        slopes = np.array(
            [[none, zoom, -zoom * y / z], [zoom, none, -zoom * x / z], [none, none, 1]]
        )
        linear = stretch * _multiply(slopes, axes)
        symmetric = (matrix + matrix.T) / 2
        moved.append(_multiply(_multiply(linear, symmetric), linear.T))
    return np.array(moved).reshape(-1, 3, 3)


def _multiply(a, b):
    return np.sum(a[:, :, None] * b[None], axis=1)


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
    centres = [((np.arange(n) + REAL(0.5)) / n - REAL(0.5)) * extent for n in shape]
    v, u, z = (part.ravel() for part in np.meshgrid(*centres, indexing="ij"))
    ahead = z + distance
    is_ahead = np.ones(len(z), bool) if orthographic else np.real(ahead) > 1e-6 * extent
    zoom = 1 if orthographic else np.where(is_ahead, ahead, 1) / focal
    moved = np.stack([u * zoom, v * zoom, z], axis=-1) - translation
    axes = rotate(np.eye(3), rotation)  # row i: where axis i goes
    turned = np.sum(moved[:, None, :] * axes, axis=-1)
    weights = [
        _find_tents((turned[:, axis] + REAL(0.5)) * size - REAL(0.5), size)
        for axis, size in enumerate(volume.shape)
    ]

    def sample(cells):
        x, y, z = weights
        spread = x[:, :, None, None] * y[:, None, :, None] * z[:, None, None, :]
        values = np.sum(spread * cells, axis=(1, 2, 3))
        return np.where(is_ahead, values, 0).reshape(shape)

    channels = [sample(volume * channel) for channel in np.moveaxis(colors, -1, 0)]
    return end_rays(sample(volume), channels, distance, *background, extent=extent)


def _find_tents(places, size):
    """Weights [n, size] of the cells at each place, none beyond a cell from the rim."""
    away = places[:, None] - np.arange(size)
    real = np.real(away)
    is_inside = (np.real(places) > -1) & (np.real(places) < size)
    # At a kink, the side towards the higher index.
    is_near = (real >= -1) & (real < 1) & is_inside[:, None]
    return np.where(is_near, np.where(real >= 0, 1 - away, 1 + away), 0)

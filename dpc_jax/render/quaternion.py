"""Unit quaternions as rotations: wxyz order, object frame to camera frame.

Every function takes one quaternion of shape [4] (`rotate` takes many points); callers
`vmap`. q and -q are the same rotation. Quaternions are normalised inside, so any
non-zero quaternion stands for a rotation; the zero quaternion is read as the identity.
"""

import jax
import jax.numpy as jnp

from dpc_jax.render import checks

IDENTITY = (1.0, 0.0, 0.0, 0.0)


def normalize(quaternion: jax.Array) -> jax.Array:
    """Scale a quaternion [4] of any length to length one.

    The zero quaternion gives the identity, with zero gradient, because the direction of
    a vector has no limit at zero.
    """
    quaternion = checks.check_array("quaternion", quaternion, (4,))
    scaled, largest = _divide_by_largest(quaternion)
    identity = jnp.array(IDENTITY, quaternion.dtype)
    scaled = jnp.where(largest == 0, identity, scaled)
    return scaled / jnp.sqrt(jnp.sum(scaled**2))


def _divide_by_largest(vector):
    """Divide a vector by about its largest magnitude; return that magnitude too.

    The largest component of the quotient is between 1 and 16, so that its square is
    representable for vectors of 1e-30 and 1e30 too. Callers use the direction only, so
    that the divisor needs no gradient.
    """
    limits = jnp.finfo(vector.dtype)
    # Compilers divide by multiplying with the inverse. Below about 1/max the inverse
    # overflows (float16 has such numbers), so a power of two lifts these. Larger ones
    # stay: in the derivative the cotangent is divided by the lifted number, and could
    # vanish.
    largest = jax.lax.stop_gradient(jnp.max(jnp.abs(vector)))
    lift = jnp.asarray(2.0 ** (-limits.minexp * 3 // 4), vector.dtype)
    factor = jnp.where(largest < limits.tiny, lift, 1)
    # Above max/16 the inverse may be subnormal, and processors flush that to zero. A
    # quotient of up to 16 has a square that float16 can represent.
    divisor = jnp.minimum(largest * factor, limits.max / 16)
    divisor = jnp.where(largest == 0, 1, divisor)
    return vector * factor / divisor, largest


def conjugate(quaternion: jax.Array) -> jax.Array:
    """Reverse the rotation: the inverse of a unit quaternion [4]."""
    quaternion = checks.check_array("quaternion", quaternion, (4,))
    return quaternion * jnp.array([1, -1, -1, -1], quaternion.dtype)


def multiply(left: jax.Array, right: jax.Array) -> jax.Array:
    """Hamilton product of two quaternions [4]: rotate by `right`, then by `left`."""
    left = checks.check_array("left", left, (4,))
    right = checks.check_array("right", right, (4,))
    w1, x1, y1, z1 = left
    w2, x2, y2, z2 = right
    return jnp.stack(
        [
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        ]
    )


def to_matrix(quaternion: jax.Array) -> jax.Array:
    """Rotation matrix [3, 3] of a quaternion [4] of any non-zero length."""
    w, x, y, z = normalize(quaternion)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return jnp.stack([jnp.stack(row) for row in rows])


def from_matrix(matrix: jax.Array) -> jax.Array:
    """Quaternion [4] of a rotation matrix [3, 3].

    Four formulas each divide by one component of the quaternion. The one with the
    largest component (at least 1/2) is taken, so that half turns are as accurate as any
    other rotation.
    """
    m = checks.check_array("matrix", matrix, (3, 3))
    x, y, z = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    xy, xz, yz = m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1]
    # Row i is 4·q_i·(w, x, y, z).
    table = (
        (1 + m[0, 0] + m[1, 1] + m[2, 2], x, y, z),
        (x, 1 + m[0, 0] - m[1, 1] - m[2, 2], xy, xz),
        (y, xy, 1 - m[0, 0] + m[1, 1] - m[2, 2], yz),
        (z, xz, yz, 1 - m[0, 0] - m[1, 1] + m[2, 2]),
    )
    rows = jnp.stack([jnp.stack(row) for row in table])
    return normalize(rows[jnp.argmax(jnp.diagonal(rows))])


def rotate(points: jax.Array, rotation: jax.Array) -> jax.Array:
    """Rotate points [N, 3] by a quaternion [4] or a rotation matrix [3, 3]."""
    points = checks.check_array("points", points, (None, 3))
    rotation = checks.check_array("rotation", rotation, (4,), (3, 3))
    matrix = to_matrix(rotation) if rotation.shape == (4,) else rotation
    # Coordinate by coordinate: a matrix product with three columns is several times
    # slower on a CPU, and a GPU might round it to TF32.
    coordinates = points.T
    moved = [
        row[0] * coordinates[0] + row[1] * coordinates[1] + row[2] * coordinates[2]
        for row in matrix
    ]
    return jnp.stack(moved, axis=-1)


def angle_between(first: jax.Array, second: jax.Array) -> jax.Array:
    """Angle in radians, in [0, π], between two rotations given as quaternions [4].

    2·atan2(‖v‖, |w|) of q₁q₂⁻¹. (Appendix "Quantitative evaluation" has 2·acos, which
    loses half the digits near 0.) The angle has kinks at 0, where the gradient is zero,
    and at π, where it is that of one side.
    """
    product = multiply(normalize(first), conjugate(normalize(second)))
    # The square of an angle of 1e-25 underflows in float32.
    scaled, largest = _divide_by_largest(product[1:])
    is_zero = largest == 0
    square = jnp.sum(scaled**2)
    sine = jnp.where(is_zero, 0, largest * jnp.sqrt(jnp.where(is_zero, 1, square)))
    return 2 * jnp.arctan2(sine, jnp.abs(product[0]))


def from_axis_angle(axis: jax.Array, angle: jax.Array) -> jax.Array:
    """Quaternion [4] that turns by `angle` radians about the unit vector `axis` [3]."""
    axis = checks.check_array("axis", axis, (3,))
    half = checks.check_real("angle", angle, ()).astype(axis.dtype) / 2
    return jnp.concatenate([jnp.cos(half)[None], jnp.sin(half) * axis])

"""The libraries compute right."""

from tiny_runs import run_python

PRODUCTS = """
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_enable_x64", True)
draws = np.random.default_rng(0)
for dtype, rows in (np.float32, 32_769), (np.float64, 32_768):
    matrix, points = draws.normal(size=(3, 3)), draws.normal(size=(rows, 3))
    m, p = jnp.asarray(matrix, dtype), jnp.asarray(points, dtype)
    found = jax.jit(jax.vmap(lambda x: jnp.sum((m @ x) ** 2)))(p)
    expected = np.sum((points @ matrix.T) ** 2, axis=1)
    # Three squares of sums of three rounded products, relative to the largest of them.
    bound = 30 * np.finfo(dtype).eps * np.sum(matrix**2) * np.sum(points**2, axis=1)
    print(np.sum(np.abs(np.asarray(found) - expected) > bound))
"""


def test_products_of_many_rows_are_those_of_numpy():
    """As users compile: without the flags of the tests."""
    done = run_python("-c", PRODUCTS, XLA_FLAGS=None)
    assert done.stdout.split() == ["0", "0"], done.stdout + done.stderr

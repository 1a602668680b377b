"""Voxel models in the objective: their losses, choice and half turns, and a step."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import (
    make_batch,
    make_network,
    make_recipe,
    make_state,
    make_step,
    random_quaternions,
    tiny_config,
)

from dpc_jax.config import build_config, replace_fields
from dpc_jax.learning import devices, signals
from dpc_jax.learning.choice.batch_choice import choose_poses
from dpc_jax.learning.choice.winners import compare_winners
from dpc_jax.learning.half_turns import compute_covariance
from dpc_jax.learning.schedules import Stage
from dpc_jax.learning.shapes import voxels
from dpc_jax.learning.shapes.voxels import Voxels
from dpc_jax.render import VoxelGrid, opacity, project_volume

pytestmark = pytest.mark.usefixtures("quickly")

STAGE = Stage(kept_points=20, grid=8)


def make_cells(seed=0):
    rng = np.random.default_rng(seed)
    cells = rng.uniform(0, 0.6, (2, 8, 8, 8)) ** 3
    colors = rng.uniform(size=(2, 8, 8, 8, 3))
    return Voxels(jnp.asarray(cells, jnp.float32), jnp.asarray(colors, jnp.float32))


def voxel_config(**fields):
    return replace_fields(tiny_config(**fields), {"network": {"shape": "voxels"}})


def render(cells, rotation, rule="termination"):
    return project_volume(cells, rotation, grid=VoxelGrid(8), ray_rule=rule).silhouette


@pytest.mark.parametrize("background", [0.0, 0.2])
@pytest.mark.parametrize("rule", ["termination", "maximum"])
def test_the_loss_is_that_of_plain_renders_by_the_rule_of_the_rays(rule, background):
    config = voxel_config(ray_rule=rule, background_weight=background)
    shapes, batch = make_cells(), make_batch()
    rotations = jnp.array(random_quaternions(3, 4), jnp.float32).reshape(2, 2, 4)

    def compare(cells):
        return compare_winners(
            dataclasses.replace(shapes, cells=cells),
            rotations,
            batch,
            recipe=make_recipe(config),
            stage=STAGE,
        )[0]

    def compare_plainly(cells):
        losses = []
        for row, place in np.ndindex(2, 2):
            seen = render(cells[row], rotations[row, place], rule)
            mask = batch["masks"][row, place] / 255.0
            mask = mask.reshape(8, 2, 8, 2).mean(axis=(1, 3))
            if background:
                cost = mask * (1 - seen) + background * (1 - mask) * seen
            else:
                cost = (seen - mask) ** 2
            losses.append(jnp.sum(cost))
        return sum(losses) / 4

    found, slope = jax.jit(jax.value_and_grad(compare))(shapes.cells)
    expected, right = jax.jit(jax.value_and_grad(compare_plainly))(shapes.cells)
    assert float(found) == pytest.approx(float(expected), rel=1e-5)
    assert float(jnp.max(jnp.abs(right))) > 1e-3
    np.testing.assert_allclose(slope, right, atol=1e-6)


def test_event_costs_of_a_ray_of_equal_cells_have_the_closed_form():
    """Cells that let q through cost qⁿ on the object, 0.2·(1 - qⁿ) beside it.

    Their slopes by q are qⁿ⁻¹ and -0.2·qⁿ⁻¹; by an occupancy the negative of it.
    """

    def cost(ray, target):
        seen = opacity(ray)[None, None]
        mask = jnp.full((1, 1), target)
        return signals.sum_event_costs(seen, mask, background=0.2)

    measure = jax.jit(jax.value_and_grad(cost))
    for target, expected, slope in ((1.0, 0.0343, -0.0382), (0.0, 0.1931, 0.00763)):
        found, slopes = measure(jnp.full(32, 0.1), target)
        assert float(found) == pytest.approx(expected, abs=5e-5)
        np.testing.assert_allclose(slopes, slope, atol=5e-5)


@pytest.mark.parametrize("coarse_side", [16, 4])
def test_the_candidate_whose_volume_fits_best_wins(coarse_side, monkeypatch):
    monkeypatch.setattr(voxels, "COARSE_SIDE", coarse_side)
    config = voxel_config(choice_top=6, renders_at_once=1)
    shapes, batch = make_cells(), make_batch()
    candidates = jnp.array(random_quaternions(10, 4 * 6), jnp.float32).reshape(4, 6, 4)
    choose = jax.jit(
        lambda shapes, masks: choose_poses(
            shapes,
            candidates,
            {"masks": masks},
            recipe=make_recipe(config),
        )
    )
    winners = choose(shapes, batch["masks"])
    targets = batch["masks"].reshape(2, 2, 8, 2, 8, 2).mean(axis=(3, 5)) / 255
    for row, place in np.ndindex(2, 2):
        losses = [
            float(jnp.sum((render(shapes.cells[row], q) - targets[row, place]) ** 2))
            for q in candidates[2 * row + place]
        ]
        assert int(winners.indices[row, place]) == np.argmin(losses)


def test_depths_of_cells_are_compared_where_their_rays_end():
    """DRC with depth: Σ of how far each ray ends from the truth, a cell let off."""
    config = voxel_config(background_weight=0.2, depth_weight=2.0)
    shapes, batch = make_cells(), make_batch()
    rotations = jnp.array(random_quaternions(3, 4), jnp.float32).reshape(2, 2, 4)
    rng = np.random.default_rng(0)
    batch["depths"] = rng.uniform(1.6, 2.4, batch["masks"].shape).astype(np.float32)
    compare = jax.jit(
        lambda cells: compare_winners(
            dataclasses.replace(shapes, cells=cells),
            rotations,
            batch,
            recipe=make_recipe(config),
            stage=STAGE,
        )
    )
    total, terms, costs = compare(shapes.cells)
    expected = []
    places = 1.5 + (np.arange(8) + 0.5) / 8
    for row, view in np.ndindex(2, 2):
        ends = project_volume(
            shapes.cells[row],
            rotations[row, view],
            grid=VoxelGrid(8),
            signals=("termination",),
        ).termination
        mask = batch["masks"][row, view] / 255.0
        share = mask.reshape(8, 2, 8, 2).mean(axis=(1, 3))
        summed = (mask * batch["depths"][row, view]).reshape(8, 2, 8, 2)
        depth = summed.mean(axis=(1, 3)) / np.where(share > 0, share, 1)
        before = depth[..., None] - 2 / 8 - places
        away = np.maximum(before, places - depth[..., None])
        expected.append(np.sum(ends * share[..., None] * np.maximum(away, 0)))
    assert float(terms["depth"]) == pytest.approx(np.mean(expected), rel=1e-4)
    both = terms["reprojection"] + 2 * terms["depth"]
    assert float(total) == pytest.approx(float(both), rel=1e-6)
    assert float(jnp.mean(costs)) == pytest.approx(float(total), rel=1e-6)


@pytest.mark.slow
def test_two_devices_learn_what_one_does(monkeypatch):
    """Also where the decoder's layers are large enough to be shared."""
    monkeypatch.setattr(devices, "SHARED_WEIGHTS", 1000)
    states = []
    for count in (1, 2):
        config = replace_fields(voxel_config(), {"run": {"devices": count}})
        network = make_network(config)
        batch = devices.assemble(make_batch(), config)
        state, _ = make_step(network, config)(make_state(network, config), batch)
        states.append(jax.tree.map(np.asarray, state.params["params"]["shape"]))
    for one, two in zip(*map(jax.tree.leaves, states), strict=True):
        # A step of Adam is 1e-3; sums over two devices differ in the last digits.
        np.testing.assert_allclose(one, two, atol=1e-4)


def test_half_turns_are_about_the_axes_of_what_is_filled():
    """A bar of full cells among empty ones: its length has nearly all variance."""
    cells = jnp.zeros((1, 8, 8, 8)).at[0, :, 3:5, 3:5].set(1.0)
    places, weights = Voxels(cells, None).find_places()
    assert weights is not None
    covariance = compute_covariance(places.reshape(-1, 3), weights.reshape(-1))
    # Uniform over 8 cells of 1/8, and over 2 of them.
    expected = np.diag([(8**2 - 1) / 12, 0.25, 0.25]) / 64
    np.testing.assert_allclose(covariance, expected, atol=1e-6)


@pytest.mark.parametrize("name", ["ours_v", "ptn", "drc"])
def test_a_variant_of_cells_has_its_rule_and_its_loss(name):
    variant = build_config("chair", f"known_pose,{name},32")
    assert variant.network.shape == "voxels" and not variant.render.fine_grid
    assert (variant.render.ray_rule == "maximum") == (name == "ptn")
    assert (variant.train.background_weight > 0) == (name == "drc")

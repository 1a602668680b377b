"""The benchmark measures what it says; no test here looks at a clock."""

import dataclasses

from dpc_jax import benchmark
from dpc_jax.measure import scenes, timing
from dpc_jax.measure.benchmark import accuracy, plan, report, speed

TINY = plan.Case(batch=2, points=40, side=8, sigma=1.0)
SURFACE = plan.Case(1, points=200, side=32, sigma=0.5)


def test_things_compared_take_turns_after_a_round_that_is_not_counted():
    order = []
    calls = {name: (lambda n=name: order.append(n)) for name in "ab"}
    assert set(timing.measure_medians(calls, rounds=3)) == {"a", "b"}
    assert "".join(order) == "ab" * 4
    # A call over its budget is measured once.
    timing.measure_medians(calls, rounds=5, budget_seconds=0.0)
    assert "".join(order) == "ab" * 6


def test_every_peer_has_the_engines_gradients():
    result = speed.compare_with_peers(TINY, rounds=1)
    peers = result["gradient_difference"]
    assert set(result["median_seconds"]) == {"project_batch", *peers}
    for differences in peers.values():
        assert len(differences) == 3  # points, quaternions, masses
        assert max(differences) < 1e-4  # float32, sums of some hundred terms


def test_errors_of_an_exact_setting_vanish_and_of_a_rough_one_do_not():
    grids = {"base_side": 8, "sides": (8,), "reference_side": 8}
    tiny = dataclasses.replace(plan.QUICK, rounds=1, **grids)
    scene = scenes.make_scenes(num_points=60, num_sparse=30, seed=0)[0]
    settings = [
        accuracy.Setting("exact", "gaussian", "float64", 8),
        accuracy.Setting("rough", "trilinear", "float32", 8),
    ]
    exact, rough = accuracy.measure_scene(scene, 1.5, plan=tiny, settings=settings)
    for kind in ("image", "gradient"):
        # The reference has the same grid here, so it is the same computation.
        assert exact[f"{kind}_error"] < 1e-12
        assert 1e-3 < rough[f"{kind}_error"] < 1


def make_record(setting, seconds, error, sigma=1.0, scene="car"):
    record = {"scene": scene, "sigma": sigma, "family": "f", "setting": setting}
    values = {"error": error, "seconds": seconds}
    return record | {
        f"{kind}_{name}": value
        for kind in ("image", "gradient")
        for name, value in values.items()
    }


def test_scenes_are_taken_together_by_their_medians():
    numbers = ((1e-3, 0.1), (3e-3, 0.3), (9, 0.2))
    records = [make_record("one", *pair, scene=str(pair)) for pair in numbers]
    (together,) = accuracy.take_scenes_together(records)
    assert together["image_seconds"] == 3e-3
    assert together["gradient_error"] == 0.2


def test_images_are_compared_in_blocks_of_the_coarsest_grids_pixels():
    for side in (*plan.FULL.sides, plan.FULL.reference_side, plan.FULL.base_side):
        assert side % min(plan.FULL.sides) == 0


def make_results():
    results = {"machine": timing.describe_machine(), "command": "python -m ..."}
    results |= {"has_torch": False, "seed": 0, "reference_side": 192, "base_side": 64}
    speeds = {"case": "B=1", "median_seconds": {"ours": 0.01, "other": 0.02}}
    speeds["gradient_difference"] = {"other": [1e-6, 2e-6, 3e-6]}
    large = {"case": "B=1", "signals": ["silhouette", "depth"], "share": 0.031}
    large |= {"median_seconds": {"blocks": 1.5}, "bytes": {"blocks": 900_000_000}}
    errors = (("one", 1e-3, 0.02), ("two", 2e-3, 0.07))
    return results | {
        "speed": [speeds],
        "sizes": [large],
        "error": [make_record(*numbers) for numbers in errors],
    }


def test_the_report_shows_its_figure_and_numbers_and_leaves_no_other_file(tmp_path):
    text = report.write_report(tmp_path, make_results()).read_text(encoding="utf-8")
    assert {path.name for path in tmp_path.iterdir()} == set(benchmark.WRITES)
    assert "(error.png)" in text
    assert "PyTorch is not installed and was left out" in text
    assert "| other | 20.00 | 3.0e-06 |" in text
    assert "| silhouette, depth | 3.1 % | – | 1.5e+03 | – | 0.9 | – |" in text


def test_one_command_measures_and_writes(tmp_path, monkeypatch, capsys):
    surface = SURFACE, ("silhouette",)
    tiny = dataclasses.replace(plan.QUICK, rounds=1, sizes=(surface,))
    monkeypatch.setattr(benchmark, "QUICK", tiny)
    assert benchmark.main(["--quick", "--parts=sizes", f"--out={tmp_path}"]) == 0
    assert "1/1 sizes: silhouette, B=1" in capsys.readouterr().out
    text = (tmp_path / "benchmark.md").read_text(encoding="utf-8")
    assert "python -m dpc_jax.benchmark --quick --parts=sizes --out=" in text


def test_parts_before_a_failing_one_are_kept(tmp_path, monkeypatch, capsys):
    def fail():
        raise RuntimeError("no memory left")

    done = make_results()["speed"]
    tasks = {"speed": [("one", lambda: done)], "sizes": [("car", fail)]}
    monkeypatch.setattr(benchmark, "list_tasks", lambda part, plan: tasks[part])
    assert benchmark.main(["--parts=speed,sizes", f"--out={tmp_path}"]) == 1
    assert "Error: no memory left" in capsys.readouterr().err
    text = (tmp_path / "benchmark.md").read_text(encoding="utf-8")
    assert "## Speed" in text and "## How large" not in text

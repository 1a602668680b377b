"""Open meshes in one command: canonical frame, origins, families, failures, reruns."""

import shutil
from unittest import mock

import numpy as np
import pytest
import trimesh
from fake_packages import (
    BLUE,
    GREEN,
    RED,
    install_commands,
    make_boxes,
    read_log,
    write_airplanes,
    write_deb,
    write_furniture,
    write_racing,
)

from dpc_jax.data import DataSpec, __main__
from dpc_jax.data.open import sweethome3d
from dpc_jax.data.sources import open_source
from dpc_jax.files import claiming, read_json

CHAIRS = [
    ("Chair", "plain", "Kitchen", ""),
    ("Armchair", "round", "Office", "turned"),
    ("Stool", "high", "Kitchen", ""),
]


@pytest.fixture
def store(tmp_path, monkeypatch):
    """Where the fake commands find packages: three chairs, for a start."""
    store = install_commands(tmp_path, monkeypatch)
    write_furniture(store, CHAIRS)
    return store


def fetch(category, tmp_path):
    return __main__.main(["fetch", category, "--out", str(tmp_path / "open")])


def read_marks(path):
    """Middle of the box, and of each colour's faces; box diagonal is checked."""
    mesh = trimesh.load_mesh(path, process=False)
    low, high = mesh.bounds
    # float32 of the file, coordinates below 1
    np.testing.assert_allclose(low, -high, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(high - low), 1, atol=1e-6)
    colors = mesh.visual.face_colors[:, :3]
    middle = mesh.triangles.mean(axis=1)

    def find(color):
        chosen = (colors == np.multiply(color, 255)).all(axis=1)
        assert chosen.sum() % 12 == 0 and chosen.any(), (path, color)
        return middle[chosen]

    return mesh, find


def assert_upright(path):
    """Red is in front, green to the left, blue on top."""
    mesh, find = read_marks(path)
    size = np.ptp(mesh.vertices, axis=0)
    front, left, top = (find(c).mean(axis=0) for c in (RED, GREEN, BLUE))
    assert front[0] > 0.35 * size[0] and abs(front[1]) < 0.05 * size[1]
    assert left[1] > 0.2 * size[1] and abs(left[0]) < 0.05 * size[0]
    assert top[2] > 0.2 * size[2] and top[2] > front[2]
    return mesh


def test_chairs_come_upright_with_colours_licence_and_origin(
    tmp_path, store, capsys, monkeypatch
):
    monkeypatch.setattr(sweethome3d, "LEFT_OUT", {"Lib-lounger": "a lounger"})
    others = (
        ("Lounger chair", "Misc"),
        ("Wheelchair", "Misc"),
        ("Table", "Kitchen"),
        ("Seat Leon", "Vehicles"),
    )
    items = [(name, name.split()[0].lower(), category, "") for name, category in others]
    write_furniture(store, [*CHAIRS, *items])
    assert fetch("chair", tmp_path) == 0
    folder = tmp_path / "open/chair"
    paths = sorted((folder / "train").glob("*.ply"))
    assert [p.stem for p in paths] == ["Lib-high", "Lib-plain", "Lib-round"]
    for path in paths:
        assert_upright(path)
        beside = read_json(path.with_suffix(".json"))
        assert beside["licence"] == "CC-BY-3.0" and beside["author"] == "Ann"
        assert beside["package"] == "sweethome3d-furniture 1.0-1"
        assert beside["original"].endswith(f"{path.stem[4:]}.obj")
    assert set(read_json(folder / "models.json")["models"]) == {
        f"train/{path.name}" for path in paths
    }
    assert "3 models" in capsys.readouterr().out
    # what is unpacked is gone, the package stays
    (kept,) = (tmp_path / "open/packages").iterdir()
    assert kept.name == "sweethome3d-furniture_1.0-1_all.deb"


def test_cars_have_their_wheels_in_place_and_the_reserved_stand_apart(tmp_path, store):
    write_racing(store)
    vehicles = [("Seat Leon", "leon", "Vehicles", ""), ("Bus", "bus", "Vehicles", "")]
    write_furniture(store, [*vehicles, *CHAIRS])
    assert fetch("car", tmp_path) == 0
    folder = tmp_path / "open/car"
    assert [p.name for p in (folder / "test").glob("*.ply")] == ["Lib-leon.ply"]
    assert_upright(folder / "test/Lib-leon.ply")
    names = ["torcs-racer", "trigger-rally-fast"]
    assert sorted(p.stem for p in (folder / "train").glob("*.ply")) == names
    for name in names:
        mesh = assert_upright(folder / f"train/{name}.ply")
        scale = 4 / np.ptp(mesh.vertices[:, 0])  # bodies are 4 m long, at the middle
        _, find = read_marks(folder / f"train/{name}.ply")
        tyres = find((0, 0, 0)) * scale
        for x in (1.2, -1.4):
            for y in (0.7, -0.7):
                # faces of a cube of side 0.6 (0.2 wide) around its middle
                near = np.abs(tyres[:, :2] - (x, y)).max(axis=1) < 0.31
                assert near.sum() == 12
                middle = tyres[near].mean(axis=0)
                np.testing.assert_allclose(middle[:2], (x, y), atol=1e-5)
        # the hubs, outwards
        hubs = np.abs(find((1, 1, 1))[:, 1]) * scale
        assert len(hubs) == 4 * 12 and hubs.min() > 0.7
        # the floor lies 0.1 m below the body: middle of the box from its corners
        height = np.ptp(mesh.vertices[:, 2]) * scale
        np.testing.assert_allclose(height, 1.6 + 0.1, atol=1e-5)
    authors = {n: read_json(folder / f"train/{n}.json")["author"] for n in names}
    assert authors["torcs-racer"] == "© 2002 Ann"


def test_airplanes_lose_their_discs_and_keep_their_families(tmp_path, store):
    disc = make_boxes()[0][1] * (0.01, 9, 9)
    planes = {
        name: {
            "Models/a.ac": [
                *make_boxes(height=0.3 + 0.02 * i),
                ("propdisc", disc, (1, 1, 1)),
                ("left Halo", disc, (1, 1, 1)),
                ("propeller.2", disc, (1, 1, 1, 0.9)),
                ("hidden", disc, (1, 1, 1, 1.0)),
            ],
            "Models/lights/large.ac": make_boxes() * 9,
            "Models/small.ac": make_boxes()[:1],
        }
        for i, name in enumerate(("733", "734", "735", "747", "E-2C", "Cub", "F-15"))
    }
    planes["Ferry"] = {"Ferry.ac": make_boxes()}
    planes["nothing"] = {"notes.txt": make_boxes()}
    write_airplanes(store, planes)
    assert fetch("airplane", tmp_path) == 0
    folder = tmp_path / "open/airplane/train"
    paths = sorted(folder.glob("*.ply"))
    names = "733 734 735 747 Cub E-2C F-15"
    assert " ".join(p.stem for p in paths) == names
    for path in paths:
        mesh = assert_upright(path)
        assert len(mesh.faces) == 4 * 12  # nothing but the four boxes is left
    families = read_json(folder / "families.json")
    assert len(set(families.values())) == 5
    assert families["733.ply"] == families["734.ply"] == families["735.ply"]


def test_a_conversion_that_was_stopped_is_made_whole(tmp_path, store, capsys):
    turns = [mock.DEFAULT, KeyboardInterrupt]
    stopped = mock.Mock(wraps=sweethome3d.make_mesh, side_effect=turns)
    with mock.patch.object(sweethome3d, "make_mesh", stopped):
        assert fetch("chair", tmp_path) == 130
    assert "continues" in capsys.readouterr().err
    folder = tmp_path / "open/chair"
    assert not (folder / "models.json").exists()
    assert len(list(folder.rglob("*.ply"))) == 1
    assert fetch("chair", tmp_path) == 0
    assert len(list(folder.rglob("*.ply"))) == 3
    assert read_log(store).count("download sweethome3d-furniture") == 1


def test_a_download_that_was_cut_goes_on(tmp_path, store, capsys):
    (store / "fails").write_text(
        "E: Failed to fetch http://host/x  Could not resolve\n"
    )
    assert fetch("chair", tmp_path) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "sweethome3d-furniture" in error and "connect to the network" in error
    (store / "fails").unlink()
    left = tmp_path / "open/packages/sweethome3d-furniture.tmp/usr"
    left.mkdir(parents=True)  # of an unpacking that was cut, too
    (left / "half").write_text("")
    assert fetch("chair", tmp_path) == 0
    assert "resumed" in read_log(store)
    assert not list((tmp_path / "open/packages").glob("*.partial"))


BOTH = ("apt-get", "dpkg-deb")
UNKNOWN = "W: a warning\nE: Unable to locate package sweethome3d-furniture\n"
MISSING = [  # commands that are there, what apt says, words of the sentence
    ((), "", ("apt-get", "not installed", "Debian", "_VERSION.deb", "packages")),
    (("apt-get",), "", ("dpkg-deb", "not installed", "dpkg")),
    (BOTH, UNKNOWN, ("(E: Unable to locate", "apt-get update", "_VERSION.deb")),
]


@pytest.mark.parametrize("commands, said, words", MISSING)
def test_what_is_missing_is_told_in_one_sentence(
    tmp_path, monkeypatch, capsys, commands, said, words
):
    store = install_commands(tmp_path, monkeypatch, commands=commands)
    write_furniture(store, CHAIRS)
    if said:
        (store / "fails").write_text(said)
    assert fetch("chair", tmp_path) == 1
    error = capsys.readouterr().err
    assert error.startswith("Error: Expected") and error.count("\n") == 1
    for word in words:
        assert word in error
    assert not (tmp_path / "open/chair").exists()


def test_damaged_and_foreign_packages_are_named(tmp_path, store, capsys):
    package = store / "sweethome3d-furniture_1.0-1_all.deb"
    package.write_bytes(b"no archive")
    assert fetch("chair", tmp_path) == 1
    error = capsys.readouterr().err
    assert package.name in error and "delete the file" in error
    sh3f = "usr/share/sweethome3d/furniture/Lib.sh3f"
    for files in ({"usr/share/doc/readme": b"moved"}, {sh3f: b"no archive"}):
        shutil.rmtree(tmp_path / "open")
        write_deb(store, "sweethome3d-furniture", files)
        assert fetch("chair", tmp_path) == 1
        error = capsys.readouterr().err
        assert package.name in error and "delete the file" in error
        assert error.count("\n") == 1


def test_a_damaged_model_is_skipped_and_named(tmp_path, store, capsys):
    write_furniture(store, [*CHAIRS, ("Chair", "broken", "Kitchen", "damaged")])
    assert fetch("chair", tmp_path) == 0
    out = capsys.readouterr().out
    assert "skipped Lib-broken" in out and "broken.obj" in out
    assert len(list((tmp_path / "open/chair").rglob("*.ply"))) == 3
    shutil.rmtree(tmp_path / "open")
    write_furniture(store, [("Chair", "broken", "Kitchen", "damaged")])
    assert fetch("chair", tmp_path) == 1
    assert "broken.obj" in capsys.readouterr().err
    assert not (tmp_path / "open/chair/models.json").exists()


def test_a_package_put_there_by_hand_is_enough(tmp_path, store, monkeypatch, capsys):
    packages = tmp_path / "open/packages"
    packages.mkdir(parents=True)
    for package in store.glob("*.deb"):
        package.rename(packages / package.name)
    install_commands(tmp_path, monkeypatch, commands=("dpkg-deb",))
    with claiming(packages / "fetching"):
        assert fetch("chair", tmp_path) == 1
    assert "another process" in capsys.readouterr().err
    assert fetch("chair", tmp_path) == 0
    made = {p: p.stat().st_mtime_ns for p in (tmp_path / "open/chair").rglob("*")}
    assert len([path for path in made if path.suffix == ".ply"]) == 3
    shutil.rmtree(packages)
    assert fetch("chair", tmp_path) == 0  # a second call does nothing
    assert made == {path: path.stat().st_mtime_ns for path in made}


def test_families_and_equal_files_stay_together(tmp_path):
    for i in range(9):
        side = 1 + 0.1 * (i // 2 if i < 4 else i)  # 0, 1 and 2, 3 are equal files
        trimesh.creation.box(extents=[side, 1, 1]).export(tmp_path / f"{i}.ply")
    families = '{"1.ply": "a", "2.ply": "a", "4.ply": "b", "5.ply": "b", "x": "c"}'
    (tmp_path / "families.json").write_text(families)
    for seed in range(4):
        spec = DataSpec("car", folder=str(tmp_path), seed=seed)
        names = open_source(spec).sides.values()
        sides = [{name[0] for name in side} for side in names]
        assert sum(len(side) for side in sides) == 9
        assert sum({"0", "1", "2", "3"} <= side for side in sides) == 1
        assert sum({"4", "5"} <= side for side in sides) == 1
    (tmp_path / "families.json").write_text('["1.ply"]')
    with pytest.raises(ValueError, match="families.json"):
        open_source(spec).list_models()

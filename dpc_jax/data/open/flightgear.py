"""Airplanes of the package flightgear-data-ai: the traffic of a flight simulator."""

import re
from pathlib import Path

import trimesh

from dpc_jax.data.open import ac3d
from dpc_jax.data.open.packages import OpenModel, move_vertices

PACKAGE = "flightgear-data-ai"
EXTRAS = ("refueling", "lights", "light", "Lights")  # folders of parts, not planes
LEFT_OUT = ("Ferry", "balloon", "SpaceShuttle", "bluebird")  # not airplanes
MOTION = re.compile(  # parts that only stand for motion or light
    r"pro?p.*dis[ck]|blur|fastprop|prop.*(fast|slow)|halo|glow|flare|flame|"
    r"cond.*cone|light.?cone|^chute$|(?<!no)shadow|wake",
    re.IGNORECASE,
)
PROPELLER = re.compile(r"prop|helice", re.IGNORECASE)
FAMILIES = {  # variants of one design, or of one drawn from another
    "Airbus A320": "A319 A320 A321",
    "Airbus wide body": "339 A300 A310 A330-MRTT A332 A333 A342 A343 A345 A346 A350",
    "ATR": "AT4 AT7",
    "BAe 146": "BAE146-300 Bae146-200",
    "Beechcraft King Air": "b1900d beech-200 beech99",
    "Boeing twin jet": "757 767 777 787",
    "Boeing 737": "733 734 735 736 738 739",
    "Bombardier CRJ": "Bombardier-Challenger CR2 CR7 CR9",
    "Cessna high wing": "c172 c177 c182 c182rg",
    "Cessna 310": "c310 c310u3a",
    "Dash 8": "DH3 DH4",
    "Douglas DC-9": "717 MD80 MD90",
    "Embraer E-Jet": "E70 E90 E95",
    "Embraer ERJ": "ERJ145 Embraer-Legacy",
    "Fokker 100": "Fokker-100 Fokker-70",
    "Saab 340": "SF3 Saab-2000",
}


def list_models(root: Path, category: str = "airplane") -> list[OpenModel]:
    """The airplanes of the unpacked package, sorted by name."""
    families = {n: family for family, ns in FAMILIES.items() for n in ns.split()}
    models = []
    for folder in root.glob("usr/share/games/flightgear/AI/Aircraft/*"):
        files = [p for p in folder.rglob("*.ac") if p.parent.name not in EXTRAS]
        files = sorted(files, key=lambda p: (-p.stat().st_size, p))
        if folder.name in LEFT_OUT or not files:
            continue
        origin = {
            "licence": "GPL-2.0-or-later",
            "author": "the FlightGear team",
            "original": str(files[0].relative_to(root)),
        }
        name, source = folder.name, (files[0], folder)
        family = families.get(name, name)
        models.append(OpenModel(name, family, "train", origin, source))
    return sorted(models)


def make_mesh(model: OpenModel, folder: Path) -> trimesh.Trimesh:
    """The mesh of an airplane in the canonical frame, without discs and lights."""
    path, textures = model.source
    parts = [p for p in ac3d.read_parts(path, textures=textures) if not _is_motion(p)]
    if not parts:
        raise ValueError(
            f"Expected an airplane in {path}, but found only discs and lights; "
            "leave it out."
        )
    # nose -x, y up
    return move_vertices(ac3d.join_parts(parts), (0, 2, 1), (-1.0, 1.0, 1.0))


def _is_motion(part):
    """Whether a part is a disc, a light or a trail, which no solid airplane has."""
    clear = part.colors[:, 3].max() < 150  # of 255; propellers stand still or turn
    return bool(
        MOTION.search(part.name)
        or (clear and PROPELLER.search(part.name))
        or part.colors[:, 3].max() < 10
    )

"""Small packages of the form of the real ones, and commands that serve them."""

import io
import os
import tarfile
import zipfile

import numpy as np

RED, GREEN, BLUE, GREY = (1, 0, 0), (0, 1, 0), (0, 0, 1), (0.5, 0.5, 0.5)
BOX = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1))
QUADS += ((2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))

APT = """#!/bin/sh
PATH=/usr/bin:/bin
echo "$@" >> {store}/log
if [ -e {store}/fails ]; then cat {store}/fails >&2; echo half > $2.part; exit 100; fi
if [ -e $2.part ]; then echo resumed >> {store}/log; fi
cp {store}/$2_*.deb .
"""
DPKG = """#!/bin/sh
PATH=/usr/bin:/bin
echo "dpkg-deb $1" >> {store}/log
if ! tar -xf "$2" -C "$3" 2>/dev/null; then
  echo "dpkg-deb: error: '$2' is not a Debian format archive" >&2; exit 2
fi
"""


def make_boxes(*, height=0.5):
    """Boxes of an object 2 long, 1 wide, `height` high with coloured marks.

    [(name, corners [8, 3] in the canonical frame, colour)]: red in front, green to the
    left, blue on top, all inside the body's box but for the top's.
    """

    def box(low, high):
        return np.array(low) + BOX * (np.array(high) - np.array(low))

    h = height
    return [
        ("body", box((-1, -0.5, 0), (1, 0.5, h)), GREY),
        ("front", box((0.8, -0.1, h), (1.0, 0.1, h + 0.1)), RED),
        ("left", box((-0.1, 0.4, h), (0.1, 0.5, h + 0.1)), GREEN),
        ("top", box((-0.1, -0.1, h), (0.1, 0.1, h + 0.3)), BLUE),
    ]


def write_obj(boxes, to_file, name):
    """{file name: bytes} of an OBJ and its MTL; `to_file` [3, 3] leaves the frame."""
    lines, materials = [f"mtllib {name}.mtl"], []
    for i, (part, corners, color) in enumerate(boxes):
        lines += ["v {} {} {}".format(*v) for v in corners @ np.array(to_file).T]
        lines += [f"g {part}", f"usemtl m{i}"]
        lines += ["f " + " ".join(str(8 * i + k + 1) for k in q) for q in QUADS]
        materials += [f"newmtl m{i}", "Kd {} {} {}".format(*color)]
    return {
        f"{name}.obj": "\n".join(lines).encode(),
        f"{name}.mtl": "\n".join(materials).encode(),
    }


def write_ac(boxes, to_file):
    """Bytes of an AC3D file; a box of four numbers as colour is that transparent."""
    text = "AC3Db\n"
    for _, _, color in boxes:
        text += write_ac_material(color[:3], *color[3:])
    text += f"OBJECT world\nkids {len(boxes)}\n"
    sides = [("0x10", quad) for quad in QUADS]
    for i, (name, corners, _) in enumerate(boxes):
        corners, data = corners @ np.array(to_file).T, [f"data {len(name)}", name]
        text += write_ac_object(corners, sides, name=name, material=i, more=data)
    return text.replace("\n", "\r\n").encode()


def write_ac_material(color, trans=0):
    """A line of an AC3D file."""
    rgb = "{} {} {}".format(*color)
    return f'MATERIAL "m" rgb {rgb}  amb 1 1 1  emis 0 0 0  shi 1  trans {trans}\n'


def write_ac_object(vertices, surfaces, *, name="part", material=0, more=(), kids=0):
    """Text of an object; surfaces are (flags, indices), corners get u, v = x, y."""
    lines = ["OBJECT poly", f'name "{name}"', *more, f"numvert {len(vertices)}"]
    lines += ["{} {} {}".format(*v) for v in vertices]
    lines += [f"numsurf {len(surfaces)}"]
    for flags, indices in surfaces:
        lines += [f"SURF {flags}", f"mat {material}", f"refs {len(indices)}"]
        lines += [f"{i} {vertices[i][0]} {vertices[i][1]}" for i in indices]
    return "\n".join([*lines, f"kids {kids}"]) + "\n"


def write_deb(store, name, files):
    """A package of the fake commands: a tar archive under a package's name."""
    with tarfile.open(store / f"{name}_1.0-1_all.deb", "w") as archive:
        for path, data in files.items():
            entry = tarfile.TarInfo(path)
            entry.size = len(data)
            archive.addfile(entry, io.BytesIO(data))


def write_furniture(store, items):
    """sweethome3d-furniture with one library; items: (name, stem, category, extra).

    Front is +z, up is +y; with the extra "turned" the front is +x and the catalogue's
    rotation says so.
    """
    straight = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
    turned = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    catalogue = ["# a comment", "id=Lib", "license=Creative Commons Attribution 3.0"]
    library = io.BytesIO()
    with zipfile.ZipFile(library, "w") as archive:
        for i, (name, stem, category, extra) in enumerate(items, start=1):
            catalogue += [f"name#{i}={name}", f"category#{i}={category}"]
            catalogue += [f"model#{i}=/lib/{stem}/{stem}.obj", f"creator#{i}=Ann"]
            if extra == "turned":
                catalogue.append(f"modelRotation#{i}=0 0 -1 0 1 0 1 0 0")
            boxes = make_boxes(height=0.3 + 0.1 * i)
            files = write_obj(boxes, turned if extra == "turned" else straight, stem)
            if extra == "damaged":
                files[f"{stem}.obj"] = b"v 0 0 0\nf 1 2 3\n"
            for file, data in files.items():
                archive.writestr(f"lib/{stem}/{file}", data)
        archive.writestr(
            "PluginFurnitureCatalog.properties", "\n".join(catalogue).encode("latin-1")
        )
    path = "usr/share/sweethome3d/furniture/Lib.sh3f"
    write_deb(store, "sweethome3d-furniture", {path: library.getvalue()})


def write_airplanes(store, planes):
    """flightgear-data-ai; planes: {folder: {file: boxes}}. The nose is -x, up is +y."""
    to_file = [[-1, 0, 0], [0, 0, 1], [0, 1, 0]]
    base = "usr/share/games/flightgear/AI/Aircraft"
    files = {
        f"{base}/{folder}/{name}": write_ac(boxes, to_file)
        for folder, members in planes.items()
        for name, boxes in members.items()
    }
    write_deb(store, "flightgear-data-ai", files)


def write_section(name, *numbers):
    """A section of the parameters of a car."""
    items = "".join(f"<attnum {number}/>" for number in numbers)
    return f'<section name="{name}">{items}</section>'


def write_racing(store):
    """torcs-data and trigger-rally-data with one car each.

    Bodies are 4 m long; wheels of radius 0.3 m stand at x = 1.2 and -1.4, y = ±0.7.
    """
    body = [(n, c * (2, 1.6, 2), color) for n, c, color in make_boxes()]
    hub = BOX * (0.2, 0.1, 0.2) + (-0.1, 0.4, -0.1)  # the outer side is the left
    wheel = [("tyre", BOX - 0.5, (0, 0, 0)), ("hub", hub, (1, 1, 1))]
    to_file = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # x forward, y up
    base = "usr/share/games/torcs"
    own = (
        '<?xml version="1.0"?><!DOCTYPE params SYSTEM "p.dtd" [<!ENTITY more SYSTEM '
        '"more.xml">]><params>&more;<section name="Car"><attstr name="category" '
        'val="A"/></section>'
    )
    general = "<params>"
    for end, x in (("Front", 1.2), ("Rear", -1.4)):
        own += write_section(f"{end} Axle", f'name="xpos" val="{x}"')
        for side, y in (("Left", 0.7), ("Right", -0.7)):
            place = f'name="ypos" unit="m" val="{y}"'
            height = 'name="ride height" unit="mm" val="100"'
            own += write_section(f"{end} {side} Wheel", place, height)
            size = f'name="rim diameter" unit="in" val="{0.4 / 0.0254}"'
            width = 'name="tire width" unit="mm" val="200"'
            ratio = 'name="tire height-width ratio" val="0.5"'
            general += write_section(f"{end} {side} Wheel", size, width, ratio)
    files = {
        f"{base}/cars/racer/racer.acc": write_ac(body, to_file),
        f"{base}/cars/racer/racer-lod1.acc": b"AC3Db\n",
        f"{base}/cars/racer/racer.xml": f"{own}</params>".encode(),
        f"{base}/cars/racer/readme.txt": "Copyright © 2002 Ann".encode("latin-1"),
        f"{base}/categories/A.xml": f"{general}</params>".encode(),
        f"{base}/wheels/trb1-5/wheel0.acc": write_ac(wheel, to_file),
    }
    write_deb(store, "torcs-data", files)

    to_file = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]  # y forward, z up
    places = [(x, y) for y in (1.2, -1.4) for x in (0.7, -0.7)]
    wheels = "".join(f'<wheel pos="{x}, {y}, 0.2" radius="0.3"/>' for x, y in places)
    vehicle = (
        '<vehicle><genparams wheelmodel="w.obj" wheelscale="0.1"/><part scale="0.01" '
        f'model="b.obj">{wheels}</part></vehicle>'
    )
    tall = [(n, c * 100, color) for n, c, color in body]
    # here the outer side is the right
    round_ = [(n, c * 20 * (1, -1, 1), color) for n, c, color in wheel]
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as data:
        for name in ("fast_wrc", "fast_kit"):
            data.writestr(f"vehicles/{name}/{name}.vehicle", vehicle)
            parts = {**write_obj(tall, to_file, "b"), **write_obj(round_, to_file, "w")}
            for file, content in parts.items():
                data.writestr(f"vehicles/{name}/{file}", content)
    path = "usr/share/games/trigger-rally/data.zip"
    write_deb(store, "trigger-rally-data", {path: archive.getvalue()})


def install_commands(tmp_path, monkeypatch, *, commands=("apt-get", "dpkg-deb")):
    """Make the fake commands the only ones on the path; the folder they serve."""
    store, place = tmp_path / "store", tmp_path / "bin"
    store.mkdir(exist_ok=True)
    place.mkdir(exist_ok=True)
    for path in place.iterdir():
        path.unlink()
    for name in commands:
        script = {"apt-get": APT, "dpkg-deb": DPKG}[name].format(store=store)
        (place / name).write_text(script)
        os.chmod(place / name, 0o755)
    monkeypatch.setenv("PATH", str(place))
    return store


def read_log(store):
    """What the commands were asked, a line each."""
    return (store / "log").read_text().splitlines() if (store / "log").exists() else []

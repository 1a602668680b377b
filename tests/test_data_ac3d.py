"""AC3D files: corners, triangles and colours, as a second reader and by hand."""

import numpy as np
import pytest
from fake_packages import write_ac_material, write_ac_object
from PIL import Image

from dpc_jax.data.open import ac3d

HEAD = "AC3Db\n" + write_ac_material((1, 0.5, 0.25))


def write(path, *, body, head=HEAD):
    path.write_text(head + body)
    return path


SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


def measure_area(part):
    a, b, c = np.moveaxis(part.vertices[part.faces], 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=-1).sum() / 2


def test_objects_are_placed_where_their_parents_are(tmp_path):
    inner = write_ac_object(SQUARE, [("0x10", range(4))], more=["loc 0 0 5"])
    outer = write_ac_object(SQUARE, [("0x10", range(4))], more=["loc 1 2 3"], kids=1)
    path = write(tmp_path / "a.ac", body=f"OBJECT world\nkids 1\n{outer}{inner}")
    first, second = ac3d.read_parts(path)
    np.testing.assert_array_equal(first.vertices, np.add(SQUARE, (1, 2, 3)))
    np.testing.assert_array_equal(second.vertices, np.add(SQUARE, (1, 2, 8)))
    # rotations multiply rows from the right, as flight simulators read them
    turned = "rot 0 1 0 -1 0 0 0 0 1"
    outer = write_ac_object(SQUARE, [], more=[turned], kids=1)
    path = write(tmp_path / "a.ac", body=outer + inner)
    (part,) = ac3d.read_parts(path)
    expected = [(-y, x, 5) for x, y, _ in SQUARE]
    np.testing.assert_array_equal(part.vertices, expected)


def test_polygons_strips_and_lines_are_told_apart(tmp_path):
    surfaces = [
        ("0x20", (0, 1, 2)),  # a triangle
        ("0X34", (0, 1, 3, 3, 2)),  # a strip that turns: one of its triangles is none
        ("0x1", (0, 1, 2)),  # lines
        ("0x02", (0, 1)),
        ("0x10", (0, 1)),  # a polygon without area
    ]
    path = write(tmp_path / "a.ac", body=write_ac_object(SQUARE, surfaces))
    (part,) = ac3d.read_parts(path)
    assert sorted(sorted(face) for face in part.faces.tolist()) == [
        [0, 1, 2],
        [0, 1, 3],
    ]
    np.testing.assert_array_equal(part.colors, [[255, 128, 64, 255]] * 2)


def test_dents_stay_open():
    rng = np.random.default_rng(0)
    dart = [(0, 0, 0), (2, 1, 0), (0, 2, 0), (0.5, 1, 0)]
    comb = [(0, 0), (5, 0), (5, 3), (4, 3), (4, 1), (3, 1), (3, 3), (2, 3), (2, 1)]
    comb.append((0, 1))
    star = [
        ((1 + i % 2) * np.cos(np.pi * i / 7), (1 + i % 2) * np.sin(np.pi * i / 7))
        for i in range(14)
    ]
    for outline in (dart, [(*p, 0) for p in comb], [(*p, 0) for p in star]):
        outline = np.array(outline, dtype=np.float64)
        x, y = outline[:, 0], outline[:, 1]
        area = abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2  # shoelace
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        for corners in (outline, outline[::-1], np.roll(outline, 3, axis=0)):
            corners = corners @ turn + 7
            faces = np.array(ac3d.split_polygon(corners))
            assert len(faces) == len(corners) - 2
            part = ac3d.Part("", corners, faces, None)
            # overlapping or outside triangles would add up to more; float64
            np.testing.assert_allclose(measure_area(part), area, rtol=1e-12)


def test_a_polygon_that_crosses_itself_still_ends():
    bow = np.array([(0, 0, 0), (1, 1, 0), (1, 0, 0), (0, 1, 0), (0.5, 2, 0)])
    assert len(ac3d.split_polygon(bow)) == 3
    assert len(ac3d.split_polygon(np.zeros((6, 3)))) == 4


def test_textures_colour_faces_and_are_found_elsewhere(tmp_path):
    pixels = np.zeros((2, 2, 4), np.uint8)  # row 0 is the top, v = 1
    pixels[0, 0], pixels[0, 1] = (255, 0, 0, 255), (0, 255, 0, 255)
    pixels[1, 0], pixels[1, 1] = (0, 0, 255, 255), (255, 255, 255, 0)
    (tmp_path / "liveries/b").mkdir(parents=True)
    Image.fromarray(pixels).save(tmp_path / "liveries/b/paint.png")
    corners = [(0.0, 0.5, 0), (0.5, 0.5, 0), (0.5, 1.0, 0), (0.0, 1.0, 0)]
    quads = [np.add(corners, shift) for shift in ((0, 0, 0), (0.5, 0, 0), (1, -0.5, 0))]
    clear = [np.add(corners, (0.5, -0.5, 0))]
    vertices = np.concatenate([*quads, *clear]).tolist()
    surfaces = [("0x0", range(4 * i, 4 * i + 4)) for i in range(4)]
    body = write_ac_object(vertices, surfaces, more=['texture "C:\\\\x\\paint.png"'])
    path = write(tmp_path / "a.ac", body=body)
    for textures in (None, tmp_path / "none"):
        (part,) = ac3d.read_parts(path, textures=textures)
        assert (part.colors == (255, 128, 64, 255)).all()  # the material alone
    (part,) = ac3d.read_parts(path, textures=tmp_path)
    seen = part.colors.reshape(4, 2, 4)[:, 0].tolist()
    assert seen == [  # material times texture, rounded
        [255, 0, 0, 255],
        [0, 128, 0, 255],
        [0, 0, 64, 255],  # beyond 1 the texture repeats
        [255, 128, 64, 0],
    ]
    # the second quad, half as wide on the texture and half of it lower: lower left
    body = body.replace("numvert", "texrep 0.5 1\ntexoff 0 -0.5\nnumvert")
    (part,) = ac3d.read_parts(write(tmp_path / "a.ac", body=body), textures=tmp_path)
    assert part.colors[2].tolist() == [0, 0, 64, 255]
    head = HEAD.replace("trans 0", "trans 0.75")
    path = write(
        tmp_path / "a.ac", body=write_ac_object(SQUARE, surfaces[:1]), head=head
    )
    assert (ac3d.read_parts(path)[0].colors[:, 3] == 64).all()


def test_sloppy_files_are_read(tmp_path):
    square = write_ac_object(
        SQUARE, [("0x10", range(4))], more=["data 10", "kids", "loc 9"]
    )
    spaced = square.replace("refs 4", "refs 4\n\n").replace("\n", "\r\n")
    path = tmp_path / "a.ac"
    path.write_bytes(f"{HEAD}OBJECT world\r\nkids 3\r\n{spaced}".encode())
    (part,) = ac3d.read_parts(path)  # three objects announced, one is there
    assert len(part.faces) == 2
    # the normals and further texture coordinates of games
    lines = square.replace("1 1 0\n0 1 0", "1 1 0 0 0 1\n0 1 0 0 0 1")
    lines = lines.replace("2 1 1\n", "2 1 1 0.3 0.3\n")
    (part,) = ac3d.read_parts(write(path, body=lines))
    np.testing.assert_array_equal(part.vertices, SQUARE)


WHOLE = write_ac_object(SQUARE, [("0x0", range(4))])
DAMAGED = [
    "", "PLY", HEAD, HEAD.partition("trans")[0], f"{HEAD}OBJECT world\nkids x\n",
    f"{HEAD}OBJECT poly\nnumvert 1\n0 0\nnumsurf 0\nkids 0\n",
    HEAD + write_ac_object(SQUARE, [("0x1", (0, 1))]), HEAD + WHOLE[:-80],
    HEAD + WHOLE.replace("3 0 1", "9 0 1"), HEAD + "OBJECT group\nkids 1\n" * 5000,
]  # fmt: skip


@pytest.mark.parametrize("text", DAMAGED)
def test_damaged_files_are_named(tmp_path, text):
    path = tmp_path / "bad.ac"
    path.write_text(text)
    with pytest.raises(ValueError, match="bad.ac"):
        ac3d.read_parts(path)
    with pytest.raises(ValueError, match="absent.ac"):
        ac3d.read_parts(tmp_path / "absent.ac")

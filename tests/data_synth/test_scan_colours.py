"""Colours of a scan: what each format means by its numbers, and nothing that is in the file left out."""

import io
import json
import struct

import numpy as np
import pytest
from PIL import Image
from test_import_scan import egg

from data_synth.scan_material import NEUTRAL_ALBEDO
from data_synth.scan_mesh import read_scan_mesh
from sira_assets.numerics.colour import linear_from_srgb

VERTICES, FACES = egg(2)
SPAN = VERTICES.min(0), np.ptp(VERTICES, axis=0)
GREY = [128, 128, 128]
HALF = float(linear_from_srgb(np.array(128 / 255)))
COMPONENT = {"uint8": 5121, "uint16": 5123, "uint32": 5125, "float32": 5126}


def by_place(points):
    """A colour that is linear in the position, from 0 to 1."""
    return np.clip((points - SPAN[0]) / SPAN[1], 0.0, 1.0)


def albedo_of(path, texture=None):
    """The scan, and its linear albedo at every vertex."""
    scan = read_scan_mesh(path, texture)
    return scan, scan.material(scan.coordinates)[0]


def write_picture(path, colour, **options):
    Image.new("RGB", (8, 8), tuple(colour)).save(path, **options)


def png(colour, size=8, **options) -> bytes:
    data = io.BytesIO()
    Image.new("RGB", (size, size), tuple(colour)).save(data, "PNG", **options)
    return data.getvalue()


def write_glb(path, *, colours=None, factor=None, picture=None):
    """The egg as glTF 2.0; `colours` (V, 3) keep their type; a material where there is a factor or a picture."""
    blobs, views, accessors = [], [], []

    def view(data: bytes) -> int:
        views.append({"buffer": 0, "byteOffset": sum(map(len, blobs)), "byteLength": len(data)})
        blobs.append(data + b"\0" * (-len(data) % 4))
        return len(views) - 1

    def accessor(array, kind, **more) -> int:
        entry = {"bufferView": view(array.tobytes()), "componentType": COMPONENT[str(array.dtype)], "type": kind}
        accessors.append(entry | {"count": array.size if kind == "SCALAR" else len(array)} | more)
        return len(accessors) - 1

    attributes = {"POSITION": accessor(VERTICES.astype(np.float32), "VEC3")}
    if colours is not None:
        whole = 1.0 if colours.dtype.kind == "f" else np.iinfo(colours.dtype).max
        four = np.column_stack([colours, np.full(len(colours), whole, colours.dtype)])
        attributes["COLOR_0"] = accessor(four, "VEC4", normalized=colours.dtype.kind == "u")
    primitive = {"attributes": attributes, "indices": accessor(FACES.astype(np.uint32).ravel(), "SCALAR")}
    tree = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}]}
    if factor is not None or picture is not None:
        primitive["material"] = 0
        material = {} if factor is None else {"baseColorFactor": [*factor, 1.0]}
        if picture is not None:
            attributes["TEXCOORD_0"] = accessor(by_place(VERTICES)[:, :2].astype(np.float32), "VEC2")
            tree |= {"images": [{"bufferView": view(picture), "mimeType": "image/png"}], "textures": [{"source": 0}]}
            material["baseColorTexture"] = {"index": 0}
        tree["materials"] = [{"pbrMetallicRoughness": material}]
    binary = b"".join(blobs)
    tree |= {"meshes": [{"primitives": [primitive]}], "bufferViews": views, "accessors": accessors}
    text = json.dumps(tree | {"buffers": [{"byteLength": len(binary)}]}).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)


def write_obj(folder, material, *, colours=None):
    """The egg with texture coordinates and one material."""
    rows = VERTICES if colours is None else np.column_stack([VERTICES, colours])
    lines = ["mtllib egg.mtl", *("v " + " ".join(map(str, row)) for row in rows.tolist())]
    lines += [f"vt {u} {v}" for u, v in by_place(VERTICES)[:, :2].tolist()]
    lines += ["usemtl skin", *("f " + " ".join(f"{v}/{v}" for v in face) for face in (FACES + 1).tolist())]
    (folder / "egg.obj").write_text("\n".join(lines))
    (folder / "egg.mtl").write_text("newmtl skin\n" + material)
    return folder / "egg.obj"


def write_ply(path, *, vertex_colours=None, face_colours=None):
    """The egg with texture coordinates of its own at every corner, so that each vertex is cut, and no picture."""
    names = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    header = f"ply\nformat ascii 1.0\nelement vertex {len(VERTICES)}\n"
    header += "".join(f"property float {name}\n" for name in "xyz") + ("" if vertex_colours is None else names)
    header += f"element face {len(FACES)}\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\n"
    rows = VERTICES.tolist() if vertex_colours is None else [
        [*x, *c] for x, c in zip(VERTICES.tolist(), vertex_colours.tolist(), strict=True)
    ]  # fmt: skip
    corners = np.random.default_rng(0).random((len(FACES), 6)).tolist()
    faces = [[3, *f, 6, *uv] for f, uv in zip(FACES.tolist(), corners, strict=True)]
    if face_colours is not None:
        header, faces = header + names, [[*f, *c] for f, c in zip(faces, face_colours.tolist(), strict=True)]
    path.write_text(header + "end_header\n" + "\n".join(" ".join(map(str, row)) for row in [*rows, *faces]) + "\n")


def display_p3() -> bytes:
    """An ICC profile: Display P3's primaries under D50, sRGB's curve as a parametric one (ICC.1:2022, 10.18)."""

    def fixed(*values):
        return b"".join(struct.pack(">i", round(65536 * v)) for v in values)

    text = "Display P3".encode("utf-16-be")
    curve = b"para\0\0\0\0\0\3\0\0" + fixed(2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
    primaries = {"r": (0.51512, 0.2412, -0.00105), "g": (0.29198, 0.69225, 0.04189), "b": (0.1571, 0.06657, 0.78407)}
    tags = {"desc": b"mluc\0\0\0\0" + struct.pack(">II4sII", 1, 12, b"enUS", len(text), 28) + text}
    tags["wtpt"] = b"XYZ \0\0\0\0" + fixed(0.9642, 1.0, 0.8249)
    tags |= {f"{c}XYZ": b"XYZ \0\0\0\0" + fixed(*xyz) for c, xyz in primaries.items()}
    tags |= {f"{c}TRC": curve for c in "rgb"}
    table, data = struct.pack(">I", len(tags)), b""
    for name, content in tags.items():
        table += struct.pack(">4sII", name.encode(), 132 + 12 * len(tags) + len(data), len(content))
        data += content + b"\0" * (-len(content) % 4)
    head = struct.pack(
        ">I4xI4s4s4s12x4s28x", 128 + len(table) + len(data), 0x04000000, b"mntr", b"RGB ", b"XYZ ", b"acsp"
    )
    return (head + fixed(0.9642, 1.0, 0.8249)).ljust(128, b"\0") + table + data


@pytest.mark.parametrize("factor", [None, [1.0, 0.6, 0.2]], ids=["no material", "material"])
@pytest.mark.parametrize("kind", ["uint8", "uint16", "float32"])
def test_colours_of_gltf_vertices_are_linear_and_times_the_factor(tmp_path, kind, factor):
    whole = 1 if kind == "float32" else np.iinfo(kind).max
    stored = by_place(VERTICES) * whole
    stored = stored.astype(kind) if kind == "float32" else np.round(stored).astype(kind)
    write_glb(tmp_path / "egg.glb", colours=stored, factor=factor)
    scan, albedo = albedo_of(tmp_path / "egg.glb")
    # Half a code of the coarsest type.
    assert np.allclose(albedo, by_place(scan.vertices) * (1.0 if factor is None else factor), atol=0.5 / 255 + 1e-6)
    assert scan.notes == ()


@pytest.mark.parametrize("size", [8, 2, 1])
def test_a_gltf_texture_is_times_factor_and_vertex_colours(tmp_path, size):
    colours = by_place(VERTICES).astype(np.float32)
    write_glb(tmp_path / "egg.glb", colours=colours, factor=[1.0, 0.6, 0.2], picture=png(GREY, size))
    scan, albedo = albedo_of(tmp_path / "egg.glb")
    assert np.allclose(albedo, HALF * by_place(scan.vertices) * [1.0, 0.6, 0.2], atol=1e-6)
    write_picture(tmp_path / "own.png", GREY)
    assert np.allclose(albedo_of(tmp_path / "egg.glb", tmp_path / "own.png")[1], HALF)


def test_one_colour_of_a_material_is_read_where_there_is_no_other(tmp_path):
    write_glb(tmp_path / "egg.glb", factor=[0.8, 0.4, 0.2])
    scan, albedo = albedo_of(tmp_path / "egg.glb")
    assert np.allclose(albedo, [0.8, 0.4, 0.2])
    assert "material's one colour" in scan.notes[0]
    scan, albedo = albedo_of(write_obj(tmp_path, "Kd 0.8 0.4 0.2\n"))
    assert np.allclose(albedo, linear_from_srgb(np.array([0.8, 0.4, 0.2])))
    assert "no picture" in scan.notes[0]
    write_picture(tmp_path / "skin.png", GREY)
    assert np.allclose(albedo_of(write_obj(tmp_path, "Kd 0.8 0.4 0.2\nmap_Kd skin.png\n"))[1], HALF)


def test_a_white_material_and_none_give_a_neutral_grey(tmp_path):
    write_glb(tmp_path / "egg.glb", factor=[1.0, 1.0, 1.0])
    write_ply(tmp_path / "egg.ply")
    for path in (tmp_path / "egg.glb", tmp_path / "egg.ply", write_obj(tmp_path, "Kd 1 1 1\n")):
        scan, albedo = albedo_of(path)
        assert np.allclose(albedo, NEUTRAL_ALBEDO)
        assert "neutral grey" in scan.notes[0]


def test_colours_of_vertices_and_faces_are_read_beside_texture_coordinates(tmp_path):
    scan, albedo = albedo_of(write_obj(tmp_path, "map_Kd missing.png\n", colours=by_place(VERTICES)))
    assert np.allclose(albedo, linear_from_srgb(by_place(scan.vertices)), atol=1e-6)
    codes = np.round(255 * by_place(VERTICES)).astype(np.uint8)
    write_ply(tmp_path / "vertices.ply", vertex_colours=codes)
    scan, albedo = albedo_of(tmp_path / "vertices.ply")
    # Half a code, where sRGB is steepest.
    assert np.allclose(albedo, linear_from_srgb(by_place(scan.vertices)), atol=0.5 / 255 * 2.3)
    assert scan.notes == ()
    codes = np.round(255 * by_place(VERTICES[FACES].mean(1))).astype(np.uint8)
    write_ply(tmp_path / "faces.ply", face_colours=codes)
    scan, albedo = albedo_of(tmp_path / "faces.ply")
    centres = scan.vertices[scan.faces].mean(1)
    assert np.allclose(albedo[scan.faces], linear_from_srgb(by_place(centres))[:, None], atol=0.5 / 255 * 2.3)
    write_picture(tmp_path / "own.png", GREY)
    assert np.allclose(albedo_of(tmp_path / "vertices.ply", tmp_path / "own.png")[1], HALF)


def test_pictures_of_another_colour_profile_are_converted(tmp_path):
    colour, profile = (200, 120, 100), display_p3()
    write_picture(tmp_path / "p3.png", colour, icc_profile=profile)
    write_glb(tmp_path / "named.glb", picture=png(colour, icc_profile=profile))
    write_glb(tmp_path / "plain.glb", picture=png(GREY))
    # Linear Display P3 to linear Rec. 709: both primaries' matrices under D65 (SMPTE EG 432-1, ITU-R BT.709).
    rec709_from_p3 = np.array([[1.22494, -0.22494, 0.0], [-0.04206, 1.04206, 0.0], [-0.01964, -0.07864, 1.09827]])
    expected = rec709_from_p3 @ linear_from_srgb(np.array(colour) / 255)
    for path, texture in (
        (tmp_path / "named.glb", None),
        (tmp_path / "plain.glb", tmp_path / "p3.png"),
        (write_obj(tmp_path, "map_Kd p3.png\n"), None),
    ):
        scan, albedo = albedo_of(path, texture)
        # A code of eight bits is up to 0.008 here; the wrong primaries are 0.09 off.
        assert np.allclose(albedo, expected, atol=0.008)
        assert "converted from colour profile 'Display P3' to sRGB" in scan.notes[0]

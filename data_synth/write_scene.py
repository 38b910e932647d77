"""Write one synthetic scene in the scene format, whole or not at all.

Notation: frame 0 is the portrait; the scene's folder has it again as `image.png`, `image.exr` and `mask.png`, so that
what reads one portrait reads a synthetic scene too. `gt/` holds frame 0's maps and what all frames share.
"""

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_synth.render import Rendering
from data_synth.render_light import F0_DIELECTRIC
from sira_assets.atomic import write_bytes, write_text
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.numerics.colour import srgb_from_linear
from sira_assets.scene.camera import OPENCV_FROM_OPENGL, Camera
from sira_assets.scene.envmap import envmap_from_sg, write_envmap
from sira_assets.scene.image import write_exr, write_png
from sira_assets.scene.sg_light import SGLight

ENVMAP_HEIGHT = 128
# A landmark is seen if nothing stands before it by more than this; landmarks lie within a millimetre of the surface.
VISIBLE_WITHIN_M = 0.004


@dataclass(frozen=True)
class SynthScene:
    """All of a synthetic scene, in its world.

    Parameters
    ----------
    mesh : world metres; vertex_albedo (V, 3) linear
    cameras, renderings : one of each a frame; all cameras have the same intrinsics
    light, roughness : what the renderings were made with
    canonical_from_world : (4, 4) similarity
    landmarks_world : the nine names of the canonical frame -> (3,)
    landmarks68_world : (68, 3) iBUG; anchors_world (A, 3) dense correspondences
    relight : frame 0 under a second light, or None
    provenance : how it was drawn; kept in gt/provenance.json
    """

    mesh: TriangleMesh
    vertex_albedo: np.ndarray
    cameras: list[Camera]
    renderings: list[Rendering]
    light: SGLight
    roughness: float
    canonical_from_world: np.ndarray
    landmarks_world: Mapping[str, np.ndarray]
    landmarks68_world: np.ndarray
    anchors_world: np.ndarray
    relight: tuple[SGLight, Rendering] | None
    provenance: Mapping[str, object]


def write_scene(scene: SynthScene, folder: str | os.PathLike) -> None:
    """Write `scene` to `folder`: built beside it, then renamed, so that a folder of that name is a whole scene.

    A folder left over from an interrupted run (`.NAME.partial`) is removed first.
    """
    folder = Path(folder)
    partial = folder.parent / f".{folder.name}.partial"
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    try:
        _write_frames(scene, partial)
        _write_truth(scene, partial / "gt")
        if scene.relight is not None:
            light, rendering = scene.relight
            _write_light(light, partial / "relight")
            _write_picture(rendering.image, partial / "relight" / "image")
        _write_json(partial / "transforms.json", transforms(scene))
        os.replace(partial, folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def transforms(scene: SynthScene) -> dict:
    """`transforms.json` (nerfstudio's: OpenGL camera to world) with `canonical_from_world`."""
    camera = scene.cameras[0]
    k = camera.intrinsics
    frames = [
        {
            "file_path": f"images/{index:03d}.png",
            "mask_path": f"masks/{index:03d}.png",
            "transform_matrix": (camera.world_from_camera @ OPENCV_FROM_OPENGL).tolist(),
        }
        for index, camera in enumerate(scene.cameras)
    ]
    return {
        "camera_model": "OPENCV",
        "fl_x": k[0, 0],
        "fl_y": k[1, 1],
        "cx": k[0, 2],
        "cy": k[1, 2],
        "w": camera.width,
        "h": camera.height,
        "k1": 0.0,
        "k2": 0.0,
        "p1": 0.0,
        "p2": 0.0,
        "frames": frames,
        "canonical_from_world": np.asarray(scene.canonical_from_world).tolist(),
    }


def ply_bytes(mesh: TriangleMesh, vertex_srgb: np.ndarray) -> bytes:
    """Binary PLY with normals and 8-bit vertex colours.

    Parameters
    ----------
    vertex_srgb : (V, 3) in [0, 1], encoded
    """
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(mesh.vertices)}\n"
        + "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
        + "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
        + f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    vertex = np.empty(len(mesh.vertices), [("x", "<f4", 3), ("n", "<f4", 3), ("c", "u1", 3)])
    vertex["x"], vertex["n"] = mesh.vertices, mesh.normals
    vertex["c"] = np.round(np.clip(vertex_srgb, 0.0, 1.0) * 255.0)
    face = np.empty(len(mesh.faces), [("n", "u1"), ("v", "<i4", 3)])
    face["n"], face["v"] = 3, mesh.faces
    return header.encode("ascii") + vertex.tobytes() + face.tobytes()


def landmarks(scene: SynthScene) -> dict:
    """`landmarks.json`: the nine names with frame 0's pixel and visibility, and lists of all points, metres."""
    camera, depth_map = scene.cameras[0], scene.renderings[0].depth
    points = np.array(list(scene.landmarks_world.values()), np.float64)
    pixels, depth = camera.project(points)
    cell = np.clip(pixels.astype(int), 0, [camera.width - 1, camera.height - 1])
    seen = depth_map[cell[:, 1], cell[:, 0]]
    inside = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(1)
    visible = inside & (depth > 0) & (seen > 0) & (depth - seen < VISIBLE_WITHIN_M)
    out: dict = {
        name: {"xyz_m": points[k].tolist(), "pixel": pixels[k].tolist(), "visible": bool(visible[k])}
        for k, name in enumerate(scene.landmarks_world)
    }
    out["landmarks_m"] = {name: points[k].tolist() for k, name in enumerate(scene.landmarks_world)}
    out["lm68_m"] = np.asarray(scene.landmarks68_world).tolist()
    out["anchors_m"] = np.asarray(scene.anchors_world).tolist()
    return out


def _write_frames(scene: SynthScene, folder: Path) -> None:
    for index, rendering in enumerate(scene.renderings):
        _write_picture(rendering.image, folder / "images" / f"{index:03d}")
        write_png(folder / "masks" / f"{index:03d}.png", rendering.mask)
    for suffix in (".png", ".exr"):
        shutil.copyfile(folder / "images" / f"000{suffix}", folder / f"image{suffix}")
    shutil.copyfile(folder / "masks" / "000.png", folder / "mask.png")


def _write_picture(linear: np.ndarray, stem: Path) -> None:
    write_exr(stem.with_suffix(".exr"), linear)
    write_png(stem.with_suffix(".png"), srgb_from_linear(np.clip(linear, 0.0, 1.0)))


def _write_light(light: SGLight, folder: Path) -> None:
    _write_json(folder / "lights.json", light.to_dict())
    write_envmap(folder / "envmap.exr", envmap_from_sg(light, ENVMAP_HEIGHT))


def _write_truth(scene: SynthScene, folder: Path) -> None:
    rendering = scene.renderings[0]
    for name, pixels in (
        ("albedo", rendering.albedo),
        ("specular", rendering.specular),
        ("normal", rendering.normal_world),
        ("depth", rendering.depth),
        ("position", rendering.position_world),
        ("alpha", rendering.alpha),
        ("diffuse_radiance", rendering.diffuse_radiance),
        ("specular_radiance", rendering.specular_radiance),
        ("diffuse_unshadowed", rendering.diffuse_unshadowed),
        ("specular_unshadowed", rendering.specular_unshadowed),
        ("diffuse_shading", rendering.diffuse_shading),
    ):
        write_exr(folder / f"{name}.exr", pixels)
    write_bytes(folder / "mesh.ply", ply_bytes(scene.mesh, srgb_from_linear(np.clip(scene.vertex_albedo, 0.0, 1.0))))
    _write_light(scene.light, folder)
    brdf = {
        "roughness": scene.roughness,
        "alpha": scene.roughness**2,
        "F0": F0_DIELECTRIC,
        "model": "kd/pi + ks*D_GGX*G_Smith_separable*F_Schlick/(4 nl nv)",
    }
    _write_json(folder / "brdf.json", brdf)
    _write_json(folder / "landmarks.json", landmarks(scene))
    _write_json(folder / "provenance.json", dict(scene.provenance))


def _write_json(path: Path, data: dict) -> None:
    write_text(path, json.dumps(data, indent=1, allow_nan=False) + "\n")

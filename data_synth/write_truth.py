"""The folder `gt/` of a synthetic scene.

Notation: maps are frame 0's; a file that the scene has no truth for is left out (docs/formats.md says which may be).
"""

import io
import json
from pathlib import Path

import numpy as np

from data_synth.render_light import F0_DIELECTRIC
from data_synth.synth_scene import SynthScene
from sira_assets.atomic import write_bytes, write_text
from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.numerics.colour import srgb_from_linear
from sira_assets.scene.camera import Camera
from sira_assets.scene.envmap import EnvironmentMap, envmap_from_sg, write_envmap
from sira_assets.scene.image import write_exr, write_png
from sira_assets.scene.sg_light import SGLight

ENVMAP_HEIGHT = 128
# A landmark is seen if nothing stands before it by more than this; landmarks lie within a millimetre of the surface.
VISIBLE_WITHIN_M = 0.004
# Maps that training reads, and those that only measuring does.
TRAIN_MAPS = ("albedo", "specular", "alpha")


def write_truth(scene: SynthScene, folder: Path) -> None:
    """Write all that `scene` knows: the full truth where it has one, else what training reads."""
    rendering = scene.portrait
    maps = {
        "albedo": rendering.albedo,
        "specular": rendering.specular,
        "normal": rendering.normal_world,
        "depth": rendering.depth,
        "position": rendering.position_world,
        "alpha": rendering.alpha,
        "diffuse_radiance": rendering.diffuse_radiance,
        "specular_radiance": rendering.specular_radiance,
        "diffuse_unshadowed": rendering.diffuse_unshadowed,
        "specular_unshadowed": rendering.specular_unshadowed,
        "diffuse_shading": rendering.diffuse_shading,
    }
    for name, pixels in maps.items():
        if scene.full is not None or name in TRAIN_MAPS:
            write_exr(folder / f"{name}.exr", pixels)
    colours = srgb_from_linear(np.clip(scene.vertex_albedo, 0.0, 1.0))
    write_bytes(folder / "mesh.ply", ply_bytes(scene.mesh, colours))
    if scene.closed is not scene.mesh:
        write_bytes(folder / "mesh_closed.ply", ply_bytes(scene.closed, None))
    write_light(scene.light, folder, envmap=scene.full is not None, exact=scene.envmap)
    brdf = {
        "roughness": scene.roughness,
        "alpha": scene.roughness**2,
        "F0": F0_DIELECTRIC,
        "model": "kd/pi + ks*D_GGX*G_Smith_separable*F_Schlick/(4 nl nv)",
    }
    write_json(folder / "brdf.json", brdf)
    write_json(folder / "landmarks.json", landmarks(scene))
    write_json(folder / "provenance.json", dict(scene.provenance))
    if scene.full is not None:
        _write_full(scene, folder)


def _write_full(scene: SynthScene, folder: Path) -> None:
    full = scene.full
    for k, pixels in enumerate(full.visibility):
        write_exr(folder / "visibility" / f"{k:03d}.exr", pixels)
    if full.regions is not None:
        for index, region in enumerate(full.regions):
            write_png(folder / "regions" / f"{index:03d}.png", region)
        write_json(folder / "regions.json", {str(k): name for k, name in sorted(full.region_names.items())})
    data = io.BytesIO()
    np.savez(data, points_m=full.sdf_points_world, sdf_m=full.sdf, known=full.sdf_known)
    write_bytes(folder / "sdf.npz", data.getvalue())


def ply_bytes(mesh: TriangleMesh, vertex_srgb: np.ndarray | None) -> bytes:
    """Binary PLY with normals and 8-bit vertex colours.

    Parameters
    ----------
    vertex_srgb : (V, 3) in [0, 1], encoded; None for a mesh without colours
    """
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(mesh.vertices)}\n"
        + "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
        + "".join(f"property uchar {name}\n" for name in ("red", "green", "blue") if vertex_srgb is not None)
        + f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    colour = [] if vertex_srgb is None else [("c", "u1", 3)]
    vertex = np.empty(len(mesh.vertices), [("x", "<f4", 3), ("n", "<f4", 3), *colour])
    vertex["x"], vertex["n"] = mesh.vertices, mesh.normals
    if vertex_srgb is not None:
        vertex["c"] = np.round(np.clip(vertex_srgb, 0.0, 1.0) * 255.0)
    face = np.empty(len(mesh.faces), [("n", "u1"), ("v", "<i4", 3)])
    face["n"], face["v"] = 3, mesh.faces
    return header.encode("ascii") + vertex.tobytes() + face.tobytes()


def landmarks(scene: SynthScene) -> dict:
    """`landmarks.json`: the nine names with frame 0's pixel and visibility, lists of all points, metres, and the 68 in
    every view. `lm68_m` is null, `views` empty and `anchors_m` empty where a scan came without."""
    caster = Raycaster(scene.mesh)
    names = list(scene.landmarks_world)
    points = np.array([scene.landmarks_world[name] for name in names], np.float64)
    pixels, visible = seen_points(scene.mesh, caster, scene.cameras[0], points)
    out: dict = {
        name: {"xyz_m": points[k].tolist(), "pixel": pixels[k].tolist(), "visible": bool(visible[k])}
        for k, name in enumerate(names)
    }
    out["landmarks_m"] = {name: points[k].tolist() for k, name in enumerate(names)}
    out["lm68_m"] = None
    out["views"] = []
    if scene.landmarks68_world is not None:
        out["lm68_m"] = np.asarray(scene.landmarks68_world).tolist()
        for camera in scene.cameras:
            pixels, visible = seen_points(scene.mesh, caster, camera, scene.landmarks68_world)
            out["views"].append({"lm68_pixels": pixels.tolist(), "lm68_visible": visible.tolist()})
    out["anchors_m"] = np.asarray(scene.anchors_world).tolist()
    return out


def seen_points(
    mesh: TriangleMesh, caster: Raycaster, camera: Camera, points_world: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (N, 2) of points on the surface, and (N,) bool: inside the picture, on a side of the surface that faces
    the camera, with nothing standing before them."""
    points = np.asarray(points_world, np.float64)
    pixels, depth = camera.project(points)
    inside = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(1) & (depth > 0)
    nearest = caster.closest(points)
    ray = points - camera.world_from_camera[:3, 3]
    reach = 1.0 - VISIBLE_WITHIN_M / np.linalg.norm(ray, axis=1)
    first = caster.cast(np.broadcast_to(camera.world_from_camera[:3, 3], ray.shape), ray).t
    facing = (mesh.normals[mesh.faces[nearest.face]].mean(1) * ray).sum(1) < 0.0
    return pixels, inside & facing & (first > reach)


def write_picture(linear: np.ndarray, stem: Path, *, exr: bool) -> None:
    """A picture as sRGB PNG and, with `exr`, as linear EXR."""
    if exr:
        write_exr(stem.with_suffix(".exr"), linear)
    write_png(stem.with_suffix(".png"), srgb_from_linear(np.clip(linear, 0.0, 1.0)))


def write_light(light: SGLight, folder: Path, *, envmap: bool, exact: EnvironmentMap | None = None) -> None:
    """lights.json and, with `envmap` or where it is an `exact` map that the gaussians stand for, envmap.exr."""
    write_json(folder / "lights.json", light.to_dict())
    if envmap or exact is not None:
        write_envmap(folder / "envmap.exr", exact or envmap_from_sg(light, ENVMAP_HEIGHT))


def write_json(path: Path, data: dict) -> None:
    """JSON that any reader takes: no NaN."""
    write_text(path, json.dumps(data, indent=1, allow_nan=False) + "\n")

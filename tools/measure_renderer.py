#!/usr/bin/env python3
"""Measure the generator's renderer against Mitsuba 3, an independent path tracer: diffuse light with shadows.

Takes the scenes that make_scenes.py wrote. Of each it reads the mesh, its vertex normals, frame 0's camera and the
light, lets Mitsuba render a white `diffuse` surface with direct light only, multiplies that by gt/albedo.exr and
compares with gt/diffuse_radiance.exr: masked, sRGB-encoded PSNR.

Scenes made with --supersample 1 are shaded at pixel centres, so Mitsuba is given a ray through each pixel's centre and
no pixel filter: a row of pixels is a `batch` of `radiancemeter` sensors, one a pixel. What then differs is light and
shadow, not how an edge is filtered. Light is lights.json on a lat-long map fine enough for its sharpest lobe.

No pixel of the mask is left out of the PSNR. Rays exactly through an edge may slip between triangles in one renderer
and not in the other. The column `black` counts pixels that only one of the two has black, `lit dB` is the PSNR without.

--curve needs no Mitsuba: it renders each scene's mesh with 16 to 256 directions a pixel and with 4096, and prints the
PSNR between them and the CPU seconds, which is the generator's own noise against its cost.

Exit status: 0 all scenes agree, 3 unusable input or no Mitsuba, 4 a scene is below --least.
"""

import argparse
import json
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from _cli import run

# A map has at least as many rows in a lobe's standard deviation, 1 / sqrt(sharpness) radians: bilinear lookup then
# lowers the lobe's peak by 1 / (4 * 6^2), less than 1 %, and keeps its energy.
ROWS_PER_DEVIATION = 6.0
MAP_HEIGHTS = (256, 512, 1024, 2048)
CURVE_SAMPLES = (16, 32, 64, 128, 256)
CURVE_COLUMNS = ("scene", "samples", "diffuse dB", "picture dB", "CPU seconds")
COLUMNS = ("PSNR dB", "SSIM", "lit dB", "black", "bias %", "pixels", "map rows", "seconds")


@dataclass(frozen=True)
class SceneFigures:
    """One scene.

    Parameters
    ----------
    psnr_db, ssim : over the mask, sRGB-encoded
    lit_psnr_db : the same without the `black` pixels, which only one renderer has black
    bias : mean linear difference, the generator's less Mitsuba's, over Mitsuba's mean radiance
    pixels : in the mask; map_height : rows of the light's map
    """

    scene: str
    psnr_db: float
    ssim: float | None
    lit_psnr_db: float
    black: int
    bias: float
    pixels: int
    map_height: int
    seconds: float


def parser() -> argparse.ArgumentParser:
    """The command line."""
    out = argparse.ArgumentParser(
        prog="measure_renderer.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    out.add_argument("scenes", type=Path, metavar="SCENES_DIR", help="folder that make_scenes.py wrote, or one scene")
    out.add_argument("--samples", type=int, default=1024, metavar="N", help="Mitsuba's samples a pixel (default 1024)")
    out.add_argument("--least", type=float, default=38.0, metavar="DB", help="PSNR that every scene needs (default 38)")
    out.add_argument("--threads", type=int, default=1, metavar="N", help="threads of Mitsuba (default 1)")
    out.add_argument("--json", action="store_true", help="print JSON instead of the table")
    out.add_argument("--curve", action="store_true", help="print noise and cost against samples instead; no Mitsuba")
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the tool; returns the exit status."""
    arguments = parser().parse_args(argv)
    if arguments.samples < 1 or arguments.threads < 1:
        parser().error("--samples and --threads must be at least 1")
    return run(lambda: measure(arguments))


def measure(arguments: argparse.Namespace) -> int:
    """Print a line a scene and the worst, or the curve."""
    if arguments.curve:
        rows = [(folder.resolve().name, *row) for folder in scene_folders(arguments.scenes) for row in curve(folder)]
        if arguments.json:
            print(json.dumps([dict(zip(CURVE_COLUMNS, row, strict=True)) for row in rows], indent=1))
        else:
            print(f"{CURVE_COLUMNS[0]:<20}" + "".join(f"{name:>14}" for name in CURVE_COLUMNS[1:]))
            for name, samples, diffuse, image, seconds in rows:
                print(f"{name:<20}{samples:>14}{diffuse:>14.2f}{image:>14.2f}{seconds:>14.2f}")
        return 0
    mi = load_mitsuba(arguments.threads)
    figures = []
    for folder in scene_folders(arguments.scenes):
        figures.append(measure_scene(mi, folder, arguments.samples))
        if not arguments.json:
            if len(figures) == 1:
                print(f"{'scene':<20}" + "".join(f"{name:>9}" for name in COLUMNS))
            f = figures[-1]
            ssim = "-" if f.ssim is None else f"{f.ssim:.4f}"
            row = f"{f.scene:<20}{f.psnr_db:>9.2f}{ssim:>9}{f.lit_psnr_db:>9.2f}{f.black:>9}{100 * f.bias:>+9.2f}"
            print(f"{row}{f.pixels:>9}{f.map_height:>9}{f.seconds:>9.1f}", flush=True)
    worst = min(figures, key=lambda f: f.psnr_db)
    if arguments.json:
        rows = [asdict(f) for f in figures]
        summary = {"least_db": arguments.least, "worst_db": worst.psnr_db, "samples": arguments.samples}
        print(json.dumps({**summary, "mitsuba": mi.__version__, "scenes": rows}, indent=1))
    else:
        verdict = "at least" if worst.psnr_db >= arguments.least else "BELOW"
        print(f"worst {worst.psnr_db:.2f} dB ({worst.scene}), {verdict} {arguments.least:g} dB")
    return 0 if worst.psnr_db >= arguments.least else 4


def load_mitsuba(threads: int):
    """Mitsuba in its scalar variant, which runs on any processor and needs no LLVM.

    Raises
    ------
    MissingExtraError : it is not installed.
    """
    from sira_assets.errors import MissingExtraError

    try:
        import drjit
        import mitsuba
    except ImportError:
        raise MissingExtraError("mitsuba", "dev") from None
    mitsuba.set_variant("scalar_rgb")
    drjit.set_thread_count(threads)
    return mitsuba


def scene_folders(folder: Path) -> list[Path]:
    """The scenes in `folder`, or itself if it is one, by name.

    Raises
    ------
    InputError : there is none.
    """
    from sira_assets.errors import InputError

    candidates = [folder, *sorted(p for p in folder.glob("*") if not p.name.startswith("."))]
    found = [p for p in candidates if (p / "gt" / "diffuse_radiance.exr").is_file()]
    if not found:
        raise InputError(
            expected=f"scenes with gt/diffuse_radiance.exr in {folder}",
            received="none" if folder.is_dir() else "no such folder",
            remedy="make some with tools/make_scenes.py",
        )
    return found


def measure_scene(mi, folder: Path, samples: int) -> SceneFigures:
    """Render a written scene's frame 0 in Mitsuba and compare.

    Raises
    ------
    InputError : the scene has several samples a pixel, a panorama or an occluder, or a file is missing or damaged.
    """
    import numpy as np

    from sira_assets.errors import InputError
    from sira_assets.measure.image_metrics import score_image
    from sira_assets.scene.exr import read_exr
    from sira_assets.scene.image import read_mask
    from sira_assets.scene.landmarks import read_json
    from sira_assets.scene.read_scene import read_frames
    from sira_assets.scene.sg_light import SGLight

    begin = time.perf_counter()
    provenance = read_json(folder / "gt" / "provenance.json")
    settings = provenance.get("settings", {})
    if settings.get("panoramas") or provenance.get("occluder"):
        raise InputError(
            expected="scenes lit by spherical gaussians, with nothing held before the face",
            received=f"a panorama or something held in {folder.name}",
            remedy="make them without --panorama and --occluders",
        )
    if settings.get("supersample", 1) != 1:
        raise InputError(
            expected="scenes with one sample at each pixel's centre",
            received=f"--supersample {settings['supersample']} in {folder.name}",
            remedy="make them with --supersample 1",
        )
    frame = read_frames(folder)[0]
    mask = read_mask(frame.mask_path)
    light = SGLight.from_dict(read_json(folder / "gt" / "lights.json"))
    height = map_height(float(light.sharpness.max()))
    white = render_white(mi, folder / "gt" / "mesh.ply", frame.camera, light, mask, height, samples)
    theirs, ours = white * read_exr(folder / "gt" / "albedo.exr"), read_exr(folder / "gt" / "diffuse_radiance.exr")
    score = score_image(ours, theirs, mask, encoding="srgb")
    black = mask & ((ours.max(-1) > 0) != (theirs.max(-1) > 0))
    return SceneFigures(
        scene=folder.resolve().name,
        psnr_db=score.psnr_db,
        ssim=score.ssim,
        lit_psnr_db=score_image(ours, theirs, mask & ~black).psnr_db,
        black=int(black.sum()),
        bias=float((ours - theirs)[mask].mean() / np.maximum(theirs[mask].mean(), 1e-12)),
        pixels=int(mask.sum()),
        map_height=height,
        seconds=time.perf_counter() - begin,
    )


def curve(folder: Path) -> list[tuple[int, float, float, float]]:
    """(samples, PSNR of the diffuse part, PSNR of the picture, CPU seconds), all against 4096 samples.

    The scene's mesh has its vertices' colours here, and ks of 1, so that highlights count fully.
    """
    import numpy as np
    import trimesh

    from data_synth.render import RayScene, RenderConfig, Surface, render
    from sira_assets.measure.image_metrics import score_image
    from sira_assets.mesh.triangle_mesh import TriangleMesh
    from sira_assets.numerics.colour import linear_from_srgb
    from sira_assets.scene.landmarks import read_json
    from sira_assets.scene.read_scene import read_frames
    from sira_assets.scene.sg_light import SGLight

    loaded = trimesh.load(folder / "gt" / "mesh.ply", process=False)
    albedo = linear_from_srgb(np.asarray(loaded.visual.vertex_colors)[:, :3] / 255.0)
    mesh = TriangleMesh(loaded.vertices, loaded.faces, loaded.vertex_normals)
    roughness = read_json(folder / "gt" / "brdf.json")["roughness"]
    rays = RayScene(Surface(mesh, albedo, lambda c: (c, np.full(len(c), 0.04)), roughness))
    camera, light = read_frames(folder)[0].camera, SGLight.from_dict(read_json(folder / "gt" / "lights.json"))
    truth = render(rays, camera, light, np.random.default_rng(1), RenderConfig(4096))
    out = []
    for samples in CURVE_SAMPLES:
        begin = time.process_time()
        ours = render(rays, camera, light, np.random.default_rng(0), RenderConfig(samples))
        seconds = time.process_time() - begin
        scores = [
            score_image(getattr(ours, name), getattr(truth, name), truth.mask, encoding="srgb").psnr_db
            for name in ("diffuse_radiance", "image")
        ]
        out.append((samples, *scores, seconds))
    return out


def map_height(sharpness: float) -> int:
    """Rows of a lat-long map that resolves a lobe of this sharpness.

    Raises
    ------
    InputError : the largest map does not.
    """
    import numpy as np

    from sira_assets.errors import InputError

    needed = ROWS_PER_DEVIATION * np.pi * np.sqrt(sharpness)
    if needed > MAP_HEIGHTS[-1]:
        raise InputError(
            expected=f"lobes that a map of {MAP_HEIGHTS[-1]} rows resolves (sharpness up to 11000)",
            received=f"a sharpness of {sharpness:.6g}",
            remedy="measure scenes with broader lights",
        )
    return next(height for height in MAP_HEIGHTS if height >= needed)


def render_white(mi, mesh_path: Path, camera, light, mask, height: int, samples: int):
    """Direct light off a white diffuse surface through the centres of masked pixels.

    Parameters
    ----------
    mi : Mitsuba, its variant set
    mesh_path : PLY with vertex normals, in the world
    camera, light : Camera and SGLight, in the world
    mask : (H, W) bool, the pixels wanted
    height : rows of the light's map
    samples : paths a pixel

    Returns
    -------
    (H, W, 3) float32 radiance, zero outside the mask
    """
    import numpy as np
    import trimesh

    mesh = trimesh.load(mesh_path, process=False)
    # Mitsuba counts in single precision here; the light is distant, so all may move to the origin.
    centre = np.asarray(mesh.bounds).mean(0)
    scene = mi.load_dict(
        {
            "type": "scene",
            "light": {"type": "envmap", "bitmap": light_bitmap(mi, light, height)},
            "head": mitsuba_mesh(mi, mesh.vertices - centre, mesh.vertex_normals, mesh.faces),
        }
    )
    integrator = mi.load_dict({"type": "path", "max_depth": 2, "hide_emitters": True})
    origins, directions = (a.reshape(*mask.shape, 3) for a in camera.rays_world())
    out = np.zeros((*mask.shape, 3), np.float32)
    for row in np.flatnonzero(mask.any(1)):
        here = mask[row]
        sensor = mi.load_dict(ray_sensors(origins[row, here] - centre, directions[row, here], samples))
        out[row, here] = np.array(mi.render(scene, sensor=sensor, integrator=integrator, seed=int(row)))[0, :, :3]
    return out


def light_bitmap(mi, light, height: int):
    """The light's radiance on Mitsuba's lat-long map, (height, 2 height).

    Mitsuba has the first and last rows at the poles themselves, not half a row beside them, and columns at half-pixel
    centres. A map with its rows at pixel centres would be stretched there, and so be 1 / height too bright.
    """
    import numpy as np

    theta = (np.pi * np.arange(height) / (height - 1))[:, None]
    phi = (np.pi * (np.arange(2 * height) + 0.5) / height)[None]
    y = np.broadcast_to(np.cos(theta), (height, 2 * height))
    directions = np.stack([np.sin(theta) * np.sin(phi), y, -np.sin(theta) * np.cos(phi)], -1)
    return mi.Bitmap(light.radiance(directions).astype(np.float32))


def mitsuba_mesh(mi, vertices, normals, faces):
    """A white diffuse mesh with interpolated vertex normals."""
    import numpy as np

    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}})
    shape = mi.Mesh("head", len(vertices), len(faces), properties, has_vertex_normals=True)
    buffers = mi.traverse(shape)
    buffers["vertex_positions"] = np.asarray(vertices, np.float32).ravel()
    buffers["vertex_normals"] = np.asarray(normals, np.float32).ravel()
    buffers["faces"] = np.asarray(faces, np.uint32).ravel()
    buffers.update()
    return shape


def ray_sensors(origins, directions, samples: int) -> dict:
    """A picture one pixel high whose k-th pixel looks along the k-th ray alone; rays (N, 3)."""

    def film(width: int) -> dict:
        pixels = {"pixel_format": "rgb", "component_format": "float32", "rfilter": {"type": "box"}}
        return {"type": "hdrfilm", "width": width, "height": 1, **pixels}

    rays = {
        f"ray_{k:05d}": {"type": "radiancemeter", "origin": o, "direction": d, "film": film(1)}
        for k, (o, d) in enumerate(zip(origins.tolist(), directions.tolist(), strict=True))
    }
    sampler = {"type": "independent", "sample_count": samples}
    return {"type": "batch", **rays, "film": film(len(rays)), "sampler": sampler}


if __name__ == "__main__":
    sys.exit(main())

"""What a run leaves on disk: the asset, the fitted field, the renders, the lights and the report.

Everything is written into a folder beside the target, which takes the target's name when it is whole.
"""

import os
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from sira_assets import __version__
from sira_assets.asset.exr_header import colour_header
from sira_assets.asset.textures import irradiance_white
from sira_assets.asset.write_avatar import write_avatar
from sira_assets.atomic import check_parent, replacing_folder
from sira_assets.errors import InputError
from sira_assets.fields.fitted import save_fitted
from sira_assets.measure.exported import ExportedView, measure_exported
from sira_assets.measure.image_metrics import score_image
from sira_assets.measure.report import Curve, Decision, Metric, Picture, Report, write_report_json
from sira_assets.measure.report_page import write_report_html
from sira_assets.numerics.colour import srgb_from_linear
from sira_assets.pipeline import Journey, Settings
from sira_assets.scene.image import write_exr, write_png
from sira_assets.texture.texture_size import TEXELS_PER_WAVE
from sira_assets.viewer.scene import ViewerScene, viewer_scene

FILES = (
    ("avatar.glb", "the asset: mesh, material and maps in one file, the scene's own coordinates"),
    ("avatar.obj", "the same as OBJ and MTL, with textures/"),
    ("textures", "diffuse, specular, normal and irradiance maps"),
    ("lights.json", "the spherical gaussians that lit the photo"),
    ("envmap.exr", "the same light as a lat-long panorama; also as .hdr"),
    ("sh.json", "the same light as spherical harmonics of bands 0 to 2"),
    ("field.safetensors", "the fitted neural field"),
    ("renders", "what the input camera sees; final.exr is linear radiance"),
    ("report.json", "figures, decisions and settings"),
)
USD_FILES = (
    ("avatar.usdc", "the same as USD, with textures/"),
    ("avatar.usdz", "the same as one package"),
)


def check_target(folder: Path, *, overwrite: bool, marker: str = "report.json", holds: str = "an avatar") -> None:
    """Refuse to write over somebody's work.

    Parameters
    ----------
    marker : the file by which a folder of ours is known
    holds : what such a folder holds, in words

    Raises
    ------
    InputError : the folder holds something and `overwrite` was not said, or it holds something else than an avatar; it
        is a mount point, which cannot be replaced; or nothing can be written beside it.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(expected=f"a folder at {folder}", received="a file", remedy="choose another --out")
    if os.path.ismount(folder.resolve()):
        raise InputError(
            expected=f"a folder that can be replaced whole at {folder}",
            received="a mount point",
            remedy="give a folder inside it",
        )
    held = folder.exists() and any(folder.iterdir())
    if held and not overwrite:
        raise InputError(
            expected=f"an empty or new folder at {folder}",
            received="one that holds files",
            remedy="choose another --out, or say --overwrite",
        )
    if held and not (folder / marker).is_file():
        raise InputError(
            expected=f"{holds} to overwrite at {folder}",
            received="a folder of other files",
            remedy="choose another --out",
        )
    check_parent(folder.resolve())


def deliver(journey: Journey, settings: Settings, folder: Path, *, decisions: tuple[Decision, ...] = ()) -> Report:
    """Write everything a run made into `folder`, whole or not at all, and give its report.

    Parameters
    ----------
    decisions : to be reported beside the run's own, such as a plan's
    """
    with replacing_folder(folder) as fresh:
        write_avatar(journey.avatar, fresh, settings.export, levels=journey.levels)
        save_fitted(journey.appearance.head, fresh / "field.safetensors")
        portrait = journey.portrait
        # As the field was seen, with shadows or without: the figures of file and field then differ by the file alone.
        compared = journey.view.final, portrait.image_linear, portrait.mask
        exported = measure_exported(fresh / "avatar.glb", *compared, shadows=journey.appearance.shadowed)
        pictures = _pictures(journey, exported)
        for name, pixels in pictures.items():
            write_png(fresh / "renders" / f"{name}.png", pixels)
        said = colour_header("radiance of the fitted field at the portrait's camera")
        write_exr(fresh / "renders" / "final.exr", journey.view.final, header=said)
        viewer = viewer_scene(fresh / "avatar.glb", shadows=journey.appearance.shadowed)
        report = _report(journey, settings, pictures, exported, viewer)
        report = replace(report, decisions=(*decisions, *report.decisions))
        write_report_json(report, fresh / "report.json")
        write_report_html(report, fresh / "report.html")
    return report


def _pictures(journey: Journey, exported: ExportedView) -> dict[str, np.ndarray]:
    """renders/*.png, uint8."""
    view, portrait = journey.view, journey.portrait
    encode = lambda linear: np.round(255 * srgb_from_linear(linear)).astype(np.uint8)  # noqa: E731
    white = irradiance_white(journey.avatar.textures)
    rotation = portrait.camera.camera_from_world[:3, :3]
    normals = view.normals_world @ rotation.T * np.array([1.0, -1.0, -1.0])  # x right, y up, z to the camera
    shaded = np.where(view.hit[..., None], 0.5 + 0.5 * normals, 0.0)
    headlight = np.where(view.hit, 0.08 + 0.92 * np.clip(normals[..., 2], 0.0, 1.0), 0.0)
    return {
        "input": encode(portrait.image_linear),
        "final": encode(view.final),
        "geometry": np.round(255 * np.repeat(headlight[..., None] ** (1 / 2.2), 3, -1)).astype(np.uint8),
        "normals": np.round(255 * shaded).astype(np.uint8),
        "albedo": encode(view.diffuse),
        "specular": np.repeat(
            np.round(255 * np.clip(view.specular_f0 / 0.08, 0, 1)).astype(np.uint8)[..., None], 3, -1
        ),
        "irradiance": encode(view.irradiance / white),
        "diffuse": encode(view.diffuse_radiance),
        "highlights": encode(view.specular_radiance),
        "asset": encode(exported.render.radiance),
    }


CAPTIONS = {
    "geometry": "the fitted surface under a headlight",
    "normals": "x right, y up, z towards the camera",
    "albedo": "diffuse albedo, sRGB-encoded",
    "specular": "specular albedo, white is F0 = 0.08",
    "irradiance": "the found light on the found normals, under the shadows that the head casts on itself",
    "diffuse": "diffuse radiance alone",
    "highlights": "specular radiance alone",
    "final": "diffuse and specular together",
    "asset": "the exported file, read back and rendered by glTF's BRDF",
}


def _report(
    journey: Journey,
    settings: Settings,
    pictures: dict[str, np.ndarray],
    exported: ExportedView,
    viewer: ViewerScene,
) -> Report:
    view, portrait, avatar = journey.view, journey.portrait, journey.avatar
    both = portrait.mask & view.hit
    union = portrait.mask | view.hit
    score = score_image(view.final, portrait.image_linear, portrait.mask)
    metrics = (
        Metric("final_psnr_db", "render against photo", score.psnr_db, "dB", "PSNR in the mask, sRGB-encoded", True, 1),
        Metric("final_ssim", "structural similarity", score.ssim, "", "SSIM in the mask, sRGB-encoded", True, 3),
        *_exported_metrics(exported),
        Metric("mask_iou", "silhouette overlap", float(both.sum() / max(union.sum(), 1)), "", "mask against render"),
        Metric("triangles", "triangles", float(len(avatar.mesh.faces)), "", "of the exported mesh", False, 0),
        *_mesh_metrics(journey),
        Metric("charts", "charts", float(avatar.atlas.report.charts), "", f"by {avatar.atlas.report.method}", False, 0),
        Metric("texture_size", "texels a side", float(avatar.textures.size), "", "of every map", False, 0),
        Metric("texture_utilisation", "texels used", 100 * avatar.atlas.report.utilisation, "%", "", False, 1),
        Metric("pose_change_deg", "pose refined by", journey.geometry.pose_change_deg, "degrees", "rotation"),
        Metric("pose_change_mm", "and moved by", 1000 * journey.geometry.pose_change_m, "mm", "mostly depth"),
    )
    curves = []
    for name, history in (("geometry", journey.geometry.history), ("appearance", journey.appearance.history)):
        terms = dict.fromkeys(term for _, losses in history for term in losses)
        curves += [
            Curve(f"{name}: {term.replace('_', ' ')}", tuple((s, x[term]) for s, x in history if term in x))
            for term in terms
        ]
    maps = tuple(Picture(name, caption, pictures[name]) for name, caption in CAPTIONS.items())
    return Report(
        title=portrait.name,
        subtitle=f"{settings.quality} quality",
        photo=Picture("photo", "the input", pictures["input"]),
        render=Picture("render", "the fitted field, same camera, found light", pictures["final"]),
        maps=maps,
        curves=tuple(curves),
        metrics=metrics,
        decisions=_decisions(journey, settings),
        warnings=portrait.warnings + journey.doubts,
        settings=_flat(settings),
        seconds=journey.seconds,
        peak_memory_bytes=peak_memory_bytes(),
        version=__version__,
        seed=settings.seed,
        metres_per_unit=portrait.metres_per_unit,
        files=(*FILES, *_level_files(journey), *(USD_FILES if settings.export.usd else ())),
        viewer=viewer,
    )


def _mesh_metrics(journey: Journey) -> tuple[Metric, ...]:
    facts = journey.facts
    how = "exported mesh to the field's zero set and back, the greater; canonical mm, without the rim of the bust's cut"
    asked = f"with {facts.extract.gradients} gradients; {facts.extract.dense} would be a dense grid of the same cell"
    mean = max(facts.gap.mean_there, facts.gap.mean_back)
    return (
        Metric("mesh_gap_max_mm", "mesh off the field by at most", 1e3 * facts.gap.greatest, "mm", how, False, 3),
        Metric("mesh_gap_mean_mm", "and on average", 1e3 * mean, "mm", "", False, 4),
        Metric("field_evaluations", "field evaluations", float(facts.extract.evaluations), "", asked, False, 0),
        Metric(
            "self_intersecting_faces",
            "faces through faces",
            float(facts.clean.self_intersecting_faces),
            "",
            "of the full surface",
            False,
            0,
        ),
    )


def _exported_metrics(exported: ExportedView) -> tuple[Metric, ...]:
    how = "avatar.glb read back, its own camera and light, glTF's BRDF by ray casting; PSNR in the mask, sRGB-encoded"
    same = "the same without glTF's 1 - F on the diffuse lobe, which the fit's model has not"
    final, photo, plain = exported.against_final.psnr_db, exported.against_photo.psnr_db, exported.unweighted_psnr_db
    return (
        Metric("asset_vs_final_psnr_db", "exported asset against render", final, "dB", how, False, 1),
        Metric("asset_vs_photo_psnr_db", "exported asset against photo", photo, "dB", how, False, 1),
        Metric("asset_vs_final_without_f_psnr_db", "without glTF's weighting", plain, "dB", same, False, 1),
    )


def _level_files(journey: Journey) -> tuple[tuple[str, str], ...]:
    return tuple(
        (f"avatar_lod{k}.glb", f"the same in {len(level.mesh.faces)} triangles, with maps of its own")
        for k, level in enumerate(journey.levels, 1)
    )


def _decisions(journey: Journey, settings: Settings) -> tuple[Decision, ...]:
    atlas = journey.avatar.atlas.report
    pose = Decision(
        "head pose",
        "refined" if journey.portrait.pose_is_estimated else "as given",
        "placed by 2D landmarks, which leave some degrees and 2 % of distance open"
        if journey.portrait.pose_is_estimated
        else "canonical_from_world or 3D landmarks were given",
    )
    size = journey.avatar.textures.size
    how = (
        f"{density:g} texels for each pixel of the photo, but no more than {density * TEXELS_PER_WAVE:g} for each "
        f"{1000 * journey.appearance.head.shortest_wave_m:g} mm, the field's finest detail"
        if (density := settings.texels_per_pixel)
        else "as asked"
    )
    if size == settings.largest_texture:
        how += "; no more for the time asked"
    texels = Decision("texture size", f"{size} x {size}", how)
    tried = "; ".join(atlas.attempts) or "first method asked, within its time and without faults"
    found = (Decision(d.what, d.chosen, d.evidence) for d in journey.appearance.decisions)
    return (*found, pose, texels, Decision("unwrap", atlas.method, tried))


def _flat(config, prefix: str = "") -> tuple[tuple[str, object], ...]:
    """A config's numbers as (dotted name, value)."""
    out: list[tuple[str, object]] = []
    for field in fields(config):
        value = getattr(config, field.name)
        name = f"{prefix}{field.name}"
        out += _flat(value, f"{name}.") if hasattr(value, "__dataclass_fields__") else [(name, value)]
    return tuple(out)


def peak_memory_bytes() -> int:
    """The most memory this process has had resident; children not counted. 0 where the system does not say."""
    try:
        import resource
    except ImportError:
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak

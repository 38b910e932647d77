"""An exported avatar against a scene's truth, read back from its files alone.

Surface: `protocols.measure_surface`, as placed and after rigid ICP. Maps: the GLB's own textures ray cast at the input
camera against the scene's `gt/` maps inside the scene's mask, a pixel the avatar misses counting as black. Final:
`renders/final.exr` against `image.exr`, or against the photo where there is no linear truth. Every picture is compared
linear and sRGB-encoded, raw and after one global gain.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sira_assets.measure.image_metrics import ImageScore, correlation, score_image
from sira_assets.measure.protocols import ProtocolConfig, SurfaceReport, measure_prepared, without_inner
from sira_assets.measure.truth import camera_in_metres, read_truth
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.relight.asset_view import AssetView, view_asset
from sira_assets.relight.glb_model import GlbModel, read_glb
from sira_assets.scene.camera import Camera
from sira_assets.scene.frame import Frame
from sira_assets.scene.image import read_image
from sira_assets.scene.read_scene import read_frame
from sira_assets.scene.transforms_json import read_transforms


@dataclass(frozen=True)
class PictureScore:
    """One picture's comparison.

    Parameters
    ----------
    what : "final", "diffuse" or "specular"
    scale_invariant : whether one global gain was fitted first
    score : the figures
    flat_psnr_db : the bar to clear: the PSNR of the truth's own mean colour in the same encoding
    """

    what: str
    scale_invariant: bool
    score: ImageScore
    flat_psnr_db: float


@dataclass(frozen=True)
class AvatarReport:
    """Everything measured; None where the scene has no truth for it, `notes` saying why.

    Parameters
    ----------
    placed, after_icp : surface figures as exported and after rigid ICP on the face
    mask_iou : of the avatar's silhouette and the scene's mask
    normal_deg, mapped_normal_deg : mean angle to the true normals inside both silhouettes, without and with the normal
        map
    specular_correlation : Pearson's, inside both silhouettes
    """

    triangles: int
    metallic: float
    roughness: float
    placed: SurfaceReport | None
    after_icp: SurfaceReport | None
    mask_iou: float | None
    normal_deg: float | None
    mapped_normal_deg: float | None
    specular_correlation: float | None
    pictures: tuple[PictureScore, ...]
    notes: tuple[str, ...]


def measure_avatar(
    avatar: str | Path,
    scene: str | Path,
    *,
    truth: str | Path | None = None,
    config: ProtocolConfig = ProtocolConfig(),
) -> AvatarReport:
    """Measure an avatar folder against a scene.

    Parameters
    ----------
    avatar : folder with `avatar.glb` and `renders/final.exr`, in the scene's own world coordinates
    scene : the scene it was made from
    truth : scene or head folder whose `gt/` to use; default `scene`. Maps count only where its camera is the scene's.

    Raises
    ------
    InputError : no avatar.glb, no scene, or files that cannot be read.
    """
    avatar, scene = Path(avatar), Path(scene)
    truth = scene if truth is None else Path(truth)
    model = read_glb(avatar / "avatar.glb")
    described = read_transforms(scene / "transforms.json", only_first=True)
    frame = described.frames[0]
    notes: list[str] = []
    placed = after_icp = None
    if (truth / "gt" / "mesh.ply").is_file() or (truth / "mesh.ply").is_file():
        placed, after_icp = _surfaces(model, frame, truth, described.metres_per_unit, config)
        notes += [f"alignment failed: {problem}" for problem in after_icp.alignment.problems]
    else:
        notes.append(f"no gt/mesh.ply in {truth.name}: no surface figures; name another scene of this head by --truth")
    photo, mask = _photo_and_mask(frame, scene)
    if mask is None:
        notes.append("the scene has no mask: no pictures are compared")
        return _report(model, placed, after_icp, None, (), notes)
    view = view_asset(model, frame.camera)
    gt = truth / "gt" if _same_camera(frame.camera, truth) else None
    if gt is None and truth != scene:
        notes.append(f"{truth.name} has another camera: its maps are not compared")
    pictures = _maps(view, gt, mask, notes) + _final(avatar, photo, mask, notes)
    return _report(model, placed, after_icp, _Seen(view, mask, gt), pictures, notes)


@dataclass(frozen=True)
class _Seen:
    view: AssetView
    mask: np.ndarray
    gt: Path | None


def _report(model: GlbModel, placed, after_icp, seen: _Seen | None, pictures, notes) -> AvatarReport:
    used = model.materials[int(np.bincount(model.material).argmax())]
    iou = normal = mapped = specular = None
    if seen is not None:
        view, both = seen.view, seen.mask & seen.view.hit
        iou = float(both.sum() / max((seen.mask | view.hit).sum(), 1))
        if seen.gt is not None and (seen.gt / "normal.exr").is_file() and both.any():
            true = read_image(seen.gt / "normal.exr").linear
            normal = mean_angle_deg(view.normal_world, true, both)
            if view.mapped_normal_world is not None:
                mapped = mean_angle_deg(view.mapped_normal_world, true, both)
        if seen.gt is not None and (seen.gt / "specular.exr").is_file() and both.any():
            specular = correlation(view.specular_ks, read_image(seen.gt / "specular.exr").linear.mean(-1), both)
    return AvatarReport(
        triangles=len(model.faces),
        metallic=used.metallic,
        roughness=used.roughness,
        placed=placed,
        after_icp=after_icp,
        mask_iou=iou,
        normal_deg=normal,
        mapped_normal_deg=mapped,
        specular_correlation=specular,
        pictures=tuple(pictures),
        notes=tuple(notes),
    )


def mean_angle_deg(a: np.ndarray, b: np.ndarray, mask: np.ndarray) -> float:
    """Mean angle in degrees of two unit vector pictures (H, W, 3) inside a mask; arctan2 keeps small angles exact."""
    a, b = np.asarray(a, np.float64)[mask], np.asarray(b, np.float64)[mask]
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(1))).mean())


def _surfaces(model, frame: Frame, truth: Path, metres_per_unit, config) -> tuple[SurfaceReport, SurfaceReport]:
    unit = metres_per_unit or _own_unit(model)
    known = read_truth(truth, metres_per_unit=metres_per_unit, assumed_unit=unit)
    known = replace(known, camera=camera_in_metres(frame.camera, unit))
    pred = TriangleMesh(model.vertices * unit, model.faces, model.normals)
    pred, known = without_inner(pred, known, config)
    return tuple(measure_prepared(pred, known, replace(config, align=kind)) for kind in ("none", "rigid"))


def _own_unit(model: GlbModel) -> float:
    """Metres per unit as the export says it, which knows what the scene's reader assumed; 1 where it does not."""
    said = model.extras.get("metres_per_unit")
    return float(said) if isinstance(said, int | float) and 0 < said < float("inf") else 1.0


def _photo_and_mask(frame: Frame, scene: Path) -> tuple[np.ndarray | None, np.ndarray | None]:
    """The linear picture to explain, and the mask; `image.exr` is truth and goes before the photo."""
    if frame.mask_path is None and (scene / "mask.png").is_file():
        frame = replace(frame, mask_path=scene / "mask.png")
    image, mask = read_frame(frame)
    exr = scene / "image.exr"
    return (read_image(exr).linear if exr.is_file() else image.linear), mask


def _same_camera(camera: Camera, truth: Path) -> bool:
    file = truth / "transforms.json"
    if not file.is_file():
        return False
    other = read_transforms(file, only_first=True).frames[0].camera
    same_pose = np.allclose(other.world_from_camera, camera.world_from_camera, rtol=0, atol=1e-6)
    same_lens = np.allclose(other.intrinsics, camera.intrinsics, rtol=1e-6, atol=1e-6)
    return same_pose and same_lens and (other.width, other.height) == (camera.width, camera.height)


def _maps(view: AssetView, gt: Path | None, mask: np.ndarray, notes: list[str]) -> tuple[PictureScore, ...]:
    out: list[PictureScore] = []
    for what, file, ours in (("diffuse", "albedo.exr", view.diffuse), ("specular", "specular.exr", view.specular_ks)):
        if gt is None or not (gt / file).is_file():
            notes.append(f"no gt/{file} for this camera: {what} is not compared")
            continue
        true = read_image(gt / file).linear
        out += _compared(what, ours, true if ours.ndim == 3 else true.mean(-1), mask)
    return tuple(out)


def _final(avatar: Path, photo: np.ndarray | None, mask: np.ndarray, notes: list[str]) -> tuple[PictureScore, ...]:
    file = avatar / "renders" / "final.exr"
    if photo is None or not file.is_file():
        notes.append("no renders/final.exr: final is not compared")
        return ()
    ours = read_image(file).linear
    if ours.shape != photo.shape:
        sizes = (f"{x.shape[1]}x{x.shape[0]}" for x in (ours, photo))
        notes.append("renders/final.exr is {}, the photo {}: final is not compared".format(*sizes))
        return ()
    return _compared("final", ours, photo, mask)


def _compared(what: str, ours: np.ndarray, true: np.ndarray, mask: np.ndarray) -> tuple[PictureScore, ...]:
    flat = np.ones_like(true) * np.asarray(true, np.float64)[mask].mean(0)
    out = []
    for encoding in ("linear", "srgb"):
        bar = score_image(flat, true, mask, encoding=encoding).psnr_db
        for invariant in (False, True):
            score = score_image(ours, true, mask, encoding=encoding, scale_invariant=invariant)
            out.append(PictureScore(what, invariant, score, bar))
    return tuple(out)

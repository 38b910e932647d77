"""An exported avatar from where its photo's camera did not stand, against a scene's truth; its light against the true.

Notation: a scene holds other views in `novel/`: a scene folder of its own (transforms.json, pictures, masks), beside it
`depth_I.exr`, the distance along the camera's axis in the scene's unit, and is lit as the portrait was, by
`gt/lights.json` or `gt/envmap.exr`. E(n) is the irradiance of a surface of normal n that nothing shades.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sira_assets.errors import InputError
from sira_assets.measure.image_metrics import best_gain, score_image
from sira_assets.mesh.raycast import Raycaster
from sira_assets.relight.glb_model import GlbModel
from sira_assets.relight.surface import mesh_of
from sira_assets.relight.turntable import QUALITIES, Quality, Turn, render_turn
from sira_assets.scene.envmap import EnvironmentMap, envmap_from_sg, read_envmap
from sira_assets.scene.exr import read_exr
from sira_assets.scene.image import read_image, read_mask
from sira_assets.scene.landmarks import read_json
from sira_assets.scene.read_scene import read_frames
from sira_assets.scene.sg_light import SGLight
from sira_assets.scene.transforms_json import read_camera

# A panorama of 64 rows and 642 normals give a smooth light's irradiance to a thousandth.
ENVMAP_ROWS = 64
NORMALS = 642


@dataclass(frozen=True)
class NovelScore:
    """One other view.

    Parameters
    ----------
    view : number
    psnr_db : inside the true mask, sRGB-encoded; pixels that the avatar does not cover are black
    psnr_both_db : where avatar and truth both are
    overlap : intersection over union of the two silhouettes
    depth_error : mean distance of the two surfaces along the camera's axis where both are, in the scene's unit
    """

    view: int
    psnr_db: float
    psnr_both_db: float
    overlap: float
    depth_error: float


@dataclass(frozen=True)
class LightScore:
    """Irradiance under the avatar's light against the true one's, over all normals.

    Parameters
    ----------
    error : RMS difference over RMS truth
    error_after_gain : the same after the one gain that linear least squares gives
    facing_after_gain : the same over the normals that face the camera: what the photo can tell
    gain : that gain, of all normals
    """

    error: float
    error_after_gain: float
    facing_after_gain: float
    gain: float


def measure_novel(
    model: GlbModel, light: SGLight, scene: str | Path, quality: Quality = QUALITIES["draft"]
) -> tuple[NovelScore, ...]:
    """Render the avatar under its own `light`, shadows cast, from every other view of the scene.

    Raises
    ------
    InputError : the scene has no other views.
    """
    folder = Path(scene) / "novel"
    if not (folder / "transforms.json").is_file():
        raise InputError(
            expected=f"other views in {folder}", received="no transforms.json there", remedy="give a scene with novel/"
        )
    caster = Raycaster(mesh_of(model))
    out = []
    for number, frame in enumerate(read_frames(folder)):
        truth, mask = read_image(frame.image_path.with_suffix(".exr")).linear, read_mask(frame.mask_path)
        (seen,) = render_turn(model, frame.camera, light, Turn(), quality)
        covered = seen.render.alpha > 0.5
        both = mask & covered
        origins, directions = frame.camera.rays_world()
        hits = caster.cast(origins, directions)
        ahead = directions @ frame.camera.world_from_camera[:3, 2]
        depth = np.where(hits.hit, hits.t * ahead, np.nan).reshape(mask.shape)
        true_depth = read_exr(folder / f"depth_{number}.exr").reshape(*mask.shape, -1)[..., 0]
        there = both & np.isfinite(depth)
        out.append(
            NovelScore(
                number,
                score_image(seen.render.radiance, truth, mask).psnr_db,
                score_image(seen.render.radiance, truth, both).psnr_db,
                float(both.sum() / (mask | covered).sum()),
                float(np.abs(depth - true_depth)[there].mean()),
            )
        )
    return tuple(out)


def measure_light(light: SGLight, scene: str | Path) -> LightScore:
    """Irradiance of the avatar's light against the scene's.

    Raises
    ------
    InputError : the scene does not say how it is lit.
    """
    normals = _normals()
    truth = _irradiance(_true_light(Path(scene) / "gt"), normals)
    found = _irradiance(envmap_from_sg(light, ENVMAP_ROWS), normals)
    towards_camera = -read_camera(Path(scene) / "transforms.json").world_from_camera[:3, 2]
    facing = normals @ towards_camera > 0.0
    error, _ = _error(found, truth, gain=1.0)
    after, gain = _error(found, truth)
    facing_after, _ = _error(found[facing], truth[facing])
    return LightScore(error, after, facing_after, gain)


def _error(found: np.ndarray, truth: np.ndarray, gain: float | None = None) -> tuple[float, float]:
    """RMS difference over RMS truth after `gain`, the best one if None; and that gain."""
    gain = best_gain(found, truth, np.ones(len(truth), bool)) if gain is None else gain
    return float(np.sqrt(((gain * found - truth) ** 2).mean() / (truth**2).mean())), gain


def _true_light(folder: Path) -> EnvironmentMap:
    """Lobes that say they are the light; else the panorama, which they may only stand for; else the lobes there are."""
    lights, panorama = folder / "lights.json", folder / "envmap.exr"
    described = read_json(lights) if lights.is_file() else None
    exact = isinstance(described, dict) and described.get("type") == "spherical_gaussians"
    if panorama.is_file() and not exact:
        return read_envmap(panorama)
    if described is None:
        raise InputError(
            expected=f"lights.json or envmap.exr in {folder}", received="neither", remedy="give a scene with its light"
        )
    return envmap_from_sg(SGLight.from_dict(described), ENVMAP_ROWS)


def _normals() -> np.ndarray:
    """(NORMALS, 3) nearly even directions."""
    i = np.arange(NORMALS) + 0.5
    z, turn = 1.0 - 2.0 * i / NORMALS, np.pi * (1.0 + 5.0**0.5) * i
    across = np.sqrt(1.0 - z * z)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], 1)


def _irradiance(light: EnvironmentMap, normals: np.ndarray) -> np.ndarray:
    """(N, 3) by quadrature over the map's pixels."""
    weighted = light.radiance.reshape(-1, 3) * light.solid_angles().reshape(-1, 1)
    return np.maximum(normals @ light.directions().reshape(-1, 3).T, 0.0) @ weighted

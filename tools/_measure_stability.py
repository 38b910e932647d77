"""Portraits that are not as they should be: one sound scene spoilt in every way that users' are.

A case passes ("sane") when the journey ends with a closed mesh of one piece and of a head's size, finite light and
finite radiance; what was said of it and the face's error beside the sound run's are shown.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from _fit_measurement import Scene

# Extent of a head with its shoulders, metres; the head's box is 0.54 m high.
SIZES_M = (0.2, 0.9)
HEAD_CENTRE_M = np.array([0.0, -0.02, -0.06])


@dataclass(frozen=True)
class Case:
    """One way to spoil a scene: name, and scene -> portrait."""

    name: str
    spoil: Callable[[Scene], object]


def sound(scene: Scene):
    """As it is."""
    return scene.portrait


def extreme_light(scene: Scene):
    """One narrow lamp from the side, ten times as strong as would expose the face: clipped on one side, black beyond.

    From exact normals and albedo, without shadows or highlights.
    """
    import torch

    from sira_assets.numerics.sg import irradiance
    from sira_assets.scene.image import read_image

    p, gt = scene.portrait, scene.folder / "gt"
    normals, albedo = (read_image(gt / f"{name}.exr").linear for name in ("normal", "albedo"))
    side = p.world_from_canonical[:3, :3] @ np.array([1.0, 0.1, 0.2])
    axis = torch.as_tensor(side / np.linalg.norm(side), dtype=torch.float32)[None]
    n = torch.nn.functional.normalize(torch.as_tensor(normals[p.mask]), dim=-1)
    lit = irradiance(n, axis, torch.tensor([200.0]), torch.ones(1, 3)).numpy() * albedo[p.mask]
    image = np.zeros_like(p.image_linear)
    image[p.mask] = 10.0 * 0.2 * lit / max(lit.mean(), 1e-9)
    return clipped(p, image)


def clipped(portrait, image: np.ndarray):
    """The portrait with that linear picture, clipped as a file would and marked so."""
    return replace(portrait, image_linear=np.minimum(image, 1.0).astype(np.float32), saturated=(image >= 1.0).any(-1))


def saturated(scene: Scene):
    """Six times overexposed."""
    return clipped(scene.portrait, 6.0 * scene.portrait.image_linear)


def black_region(scene: Scene):
    """A third of the head's width is black."""
    p = scene.portrait
    columns = np.nonzero(p.mask.any(0))[0]
    image = p.image_linear.copy()
    image[:, columns[0] : columns[0] + len(columns) // 3] = 0.0
    return replace(p, image_linear=image)


def holes_in_mask(scene: Scene):
    """Twelve round holes, a twentieth of the picture wide each."""
    p = scene.portrait
    rng = np.random.default_rng(0)
    rows, columns = np.nonzero(p.mask)
    y, x = np.mgrid[: p.mask.shape[0], : p.mask.shape[1]]
    mask = p.mask.copy()
    for k in rng.integers(len(rows), size=12):
        mask &= np.hypot(y - rows[k], x - columns[k]) > p.mask.shape[1] / 40
    return replace(p, mask=mask)


def focal_length(scene: Scene, factor: float):
    """The camera says another focal length than it has."""
    camera = scene.portrait.camera
    k = camera.intrinsics.copy()
    k[:2, :2] *= factor
    return replace(scene.portrait, camera=replace(camera, intrinsics=k))


def turned_head(scene: Scene, degrees: float, axis: int):
    """The camera stands elsewhere about the head: canonical_from_world is off by a turn about the head's centre."""
    from scipy.spatial.transform import Rotation

    p = scene.portrait
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec(np.radians(degrees) * np.eye(3)[axis]).as_matrix()
    turn[:3, 3] = HEAD_CENTRE_M - turn[:3, :3] @ HEAD_CENTRE_M
    return replace(p, canonical_from_world=turn @ p.canonical_from_world)


def turned_camera(scene: Scene, degrees: float):
    """The camera looks past the head: its pose is turned about its own centre."""
    from scipy.spatial.transform import Rotation

    p = scene.portrait
    pose = p.camera.world_from_camera.copy()
    pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(np.radians(degrees) * np.eye(3)[1]).as_matrix()
    return replace(p, camera=replace(p.camera, world_from_camera=pose))


def resized(scene: Scene, size: int):
    """The same photo at another number of pixels, by area downwards and linear upwards."""
    from skimage.transform import resize

    p = scene.portrait
    factor = size / p.camera.width
    height = round(p.camera.height * factor)
    options = {"output_shape": (height, size), "order": 1, "anti_aliasing": factor < 1.0}
    image = resize(p.image_linear, **options).astype(np.float32)
    mask, bright = (resize(a.astype(np.float32), **options) > 0.5 for a in (p.mask, p.saturated))
    k = p.camera.intrinsics.copy()
    k[0] *= size / p.camera.width
    k[1] *= height / p.camera.height
    camera = replace(p.camera, intrinsics=k, width=size, height=height)
    return replace(p, image_linear=np.maximum(image, 0.0), mask=mask, saturated=bright, camera=camera)


CASES = (
    Case("sound", sound),
    Case("extreme light", extreme_light),
    Case("saturated", saturated),
    Case("black region", black_region),
    Case("holes in the mask", holes_in_mask),
    Case("focal length 1.2 times", lambda scene: focal_length(scene, 1.2)),
    Case("focal length 0.8 times", lambda scene: focal_length(scene, 0.8)),
    Case("camera 3 deg about the head, yaw", lambda scene: turned_head(scene, 3.0, 1)),
    Case("camera 3 deg about the head, pitch", lambda scene: turned_head(scene, 3.0, 0)),
    Case("camera 3 deg about itself", lambda scene: turned_camera(scene, 3.0)),
    Case("64 pixels", lambda scene: resized(scene, 64)),
    Case("4096 pixels", lambda scene: resized(scene, 4096)),
)


def measure_case(case: Case, scene: Scene, prior, settings) -> dict[str, object]:
    """Run the whole journey on a spoilt scene; a refusal in words is a result as well."""
    import time

    from _fit_measurement import Shape, face_errors

    from sira_assets.errors import InputError
    from sira_assets.pipeline import run

    started = time.process_time()
    try:
        journey = run(case.spoil(scene), settings, prior=prior)
    except InputError as error:
        return {"sane": False, "wrong": "refused", "said": [str(error)]}
    seconds = time.process_time() - started
    shape = Shape(journey.portrait, journey.geometry, journey.surface, {})
    wrong = insane(journey)
    errors = face_errors(shape, scene)
    return {
        "sane": not wrong,
        "wrong": ", ".join(wrong),
        "placed": errors["placed"],
        "after_icp": errors["after_icp"],
        "said": [*journey.portrait.warnings, *journey.doubts],
        "seconds": seconds,
    }


def insane(journey) -> list[str]:
    """What about an avatar is not as any head's is."""
    from sira_assets.mesh.topology import topology

    facts, vertices = topology(journey.surface), journey.avatar.mesh.vertices
    wrong = []
    if not (facts.watertight and facts.pieces == 1):
        wrong.append(f"{facts.boundary_edges} open edges, {facts.pieces} pieces")
    extent = np.ptp(vertices, axis=0).max() * journey.portrait.metres_per_unit
    if not (np.isfinite(vertices).all() and SIZES_M[0] < extent < SIZES_M[1]):
        wrong.append(f"size {extent:.2f} m")
    light, view = journey.avatar.light, journey.view
    if not (len(light) and np.isfinite(light.amplitude).all() and np.isfinite(light.sharpness).all()):
        wrong.append("light")
    if not (np.isfinite(view.final).all() and view.hit.any()):
        wrong.append("radiance")
    return wrong


def print_stability(rows: list[Mapping[str, object]]) -> None:
    """A line a case."""
    from _fit_measurement import print_table

    lines = [
        [r["case"], "yes" if r["sane"] else f"no: {r['wrong']}", r.get("placed"), r.get("after_icp"), r.get("seconds")]
        for r in rows
    ]
    print_table(["case", "sane", "face placed", "after ICP", "CPU s"], lines)
    for row in rows:
        for line in row["said"]:
            print(f"{row['case']}: {line}")

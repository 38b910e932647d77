"""What a folder of synthetic scenes holds, in figures: counts and distributions, read back from the scenes themselves.

Notation: a distribution is of one number a scene (or view, or lobe); angles in degrees, the canonical frame: yaw turns
from +Z (the face's front) towards +X (the subject's left), pitch lifts.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from sira_assets.atomic import write_text
from sira_assets.errors import InputError
from sira_assets.numerics.colour import luminance, srgb_from_linear
from sira_assets.scene.camera import OPENCV_FROM_OPENGL
from sira_assets.scene.canonical import similarity_scale, transform_points
from sira_assets.scene.exr import read_exr
from sira_assets.scene.image import read_image, read_mask
from sira_assets.scene.landmarks import read_json

FULL_FRAME_MM = 36.0  # width of the picture that 35 mm equivalent focal lengths refer to
CHEEKS_M = 0.035  # around the nose tip: mostly bare skin, whoever it is
BINS = 20
# D65 white and the matrix of linear Rec. 709 to CIE XYZ (ITU-R BT.709-6; IEC 61966-2-1).
XYZ_FROM_RGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


@dataclass(frozen=True)
class Distribution:
    """Of finite numbers: how many, their moments and a histogram of `BINS` equal bins (one where all are equal)."""

    name: str
    unit: str
    count: int
    mean: float
    std: float
    least: float
    median: float
    most: float
    edges: tuple[float, ...]
    counts: tuple[int, ...]


@dataclass(frozen=True)
class Tally:
    """How often each word occurs, most frequent first."""

    name: str
    counts: tuple[tuple[str, int], ...]


@dataclass(frozen=True)
class Datasheet:
    """Facts of a folder. `settings`: each data set's settings file, by name; `by_group`: section -> its figures."""

    scenes: int
    pictures: int
    settings: dict[str, dict]
    by_group: dict[str, tuple[Distribution | Tally, ...]]


def distribution(name: str, unit: str, values: list[float]) -> Distribution:
    """The distribution of `values`; six significant digits, so that the file reads well."""
    x = np.array(values, np.float64)
    x = x[np.isfinite(x)]
    if not len(x):
        return Distribution(name, unit, 0, 0.0, 0.0, 0.0, 0.0, 0.0, (), ())
    low, high = float(x.min()), float(x.max())
    span = high - low > 1e-9 * max(abs(low), abs(high), 1e-300)
    counts, edges = np.histogram(x, BINS if span else 1, (low, high) if span else (low - 0.5, low + 0.5))
    moments = (_short(v) for v in (x.mean(), x.std(), low, np.median(x), high))
    return Distribution(name, unit, len(x), *moments, tuple(map(_short, edges)), tuple(int(c) for c in counts))


def tally(name: str, words: list[str]) -> Tally:
    """Counts of `words`, most frequent first, then by name."""
    found = {word: words.count(word) for word in set(words)}
    return Tally(name, tuple(sorted(found.items(), key=lambda item: (-item[1], item[0]))))


def describe(folder: Path) -> Datasheet:
    """Read all scenes in `folder` that the generator made; a function of their bytes alone."""
    scenes = sorted(
        path.parent for path in folder.glob("[!.]*/transforms.json") if (path.parent / "gt/provenance.json").is_file()
    )
    rows = [_read(scene) for scene in scenes]
    found = {path.stem: _settings(path) for path in sorted(folder.glob("[!.]*.json"))}
    settings = {name: data for name, data in found.items() if data is not None}
    light = (
        tally("light rig", [row.rig for row in rows]),
        distribution("lobes a scene", "", [len(row.sharpness) for row in rows]),
        distribution(
            "sharpness of a lobe, decimal logarithm", "", [float(np.log10(s)) for r in rows for s in r.sharpness]
        ),
        distribution("luminance of the portrait's head, sRGB-encoded", "", [row.encoded for row in rows]),
        distribution("clipped pixels of the portrait's head", "%", [100 * row.clipped for row in rows]),
        distribution("roughness", "", [row.roughness for row in rows]),
    )
    camera = (
        distribution("focal length, 35 mm equivalent", "mm", [row.focal_mm for row in rows]),
        distribution("distance from the head", "m", [d for row in rows for d in row.distance]),
        distribution("yaw of the portrait", "degrees", [row.yaw[0] for row in rows]),
        distribution("pitch of the portrait", "degrees", [row.pitch[0] for row in rows]),
        distribution("yaw of all views", "degrees", [y for row in rows for y in row.yaw]),
        distribution("pitch of all views", "degrees", [p for row in rows for p in row.pitch]),
        distribution("picture filled by the head, all views", "%", [100 * c for row in rows for c in row.covered]),
    )
    skin = (
        distribution(
            "individual typology angle, below 10 brown and dark, above 41 light", "degrees", [r.ita for r in rows]
        ),
        distribution("luminance of the albedo around the nose", "", [row.albedo for row in rows]),
    )
    groups = {"Skin, as rendered": skin, "Light and exposure": light, "Cameras": camera}
    return Datasheet(len(scenes), sum(len(r.yaw) for r in rows), settings, groups | _parameters([r.head for r in rows]))


@dataclass(frozen=True)
class _Row:
    """One scene's figures."""

    rig: str
    sharpness: list[float]
    encoded: float
    clipped: float
    roughness: float
    focal_mm: float
    distance: list[float]
    yaw: list[float]
    pitch: list[float]
    covered: list[float]
    ita: float
    albedo: float
    head: dict


def _settings(path: Path) -> dict | None:
    """A data set's settings; None for any other file."""
    try:
        data = read_json(path)
    except InputError:
        return None
    return data if isinstance(data, dict) and {"kind", "generator"} <= data.keys() else None


def _read(scene: Path) -> _Row:
    transforms, truth = json.loads((scene / "transforms.json").read_text()), scene / "gt"
    provenance = json.loads((truth / "provenance.json").read_text())
    canonical = np.array(transforms["canonical_from_world"])
    poses = [np.array(f["transform_matrix"]) @ OPENCV_FROM_OPENGL for f in transforms["frames"]]
    centres = transform_points(canonical, np.array([pose[:3, 3] for pose in poses]))
    metres = np.linalg.norm(centres, axis=1) / similarity_scale(canonical)
    masks = [read_mask(scene / f["mask_path"]) for f in transforms["frames"]]
    portrait = read_image(scene / transforms["frames"][0]["file_path"])
    head = masks[0]
    nose = json.loads((truth / "landmarks.json").read_text()).get("nose_tip")
    colour = _around_the_nose(scene, transforms, poses[0], nose) if nose else np.full(3, np.nan)
    nan = float("nan")
    lights = json.loads((truth / "lights.json").read_text())["sgs"]
    return _Row(
        rig=str(provenance.get("rig")),
        sharpness=[lobe["sharpness"] for lobe in lights],
        encoded=float(srgb_from_linear(luminance(portrait.linear[head]).astype(np.float64).mean()))
        if head.any()
        else nan,
        clipped=float(portrait.saturated[head].mean()) if head.any() else nan,
        roughness=json.loads((truth / "brdf.json").read_text())["roughness"],
        focal_mm=transforms["fl_x"] / transforms["w"] * FULL_FRAME_MM,
        distance=metres.tolist(),
        yaw=np.degrees(np.arctan2(centres[:, 0], centres[:, 2])).tolist(),
        pitch=np.degrees(np.arctan2(centres[:, 1], np.hypot(centres[:, 0], centres[:, 2]))).tolist(),
        covered=[float(mask.mean()) for mask in masks],
        ita=typology_angle(colour),
        albedo=float(luminance(colour)),
        head=provenance.get("head", {}),
    )


def _around_the_nose(scene: Path, transforms: dict, world_from_camera: np.ndarray, nose: dict) -> np.ndarray:
    """Median linear albedo (3,) of the portrait within `CHEEKS_M` of the nose tip; NaN where nothing is seen."""
    albedo = read_exr(scene / "gt" / "albedo.exr")
    scale = similarity_scale(np.array(transforms["canonical_from_world"]))
    depth = float((np.array(nose["xyz_m"]) - world_from_camera[:3, 3]) @ world_from_camera[:3, 2])
    radius = transforms["fl_x"] * CHEEKS_M / (scale * max(depth, 1e-6))
    x, y = np.meshgrid(np.arange(albedo.shape[1]) + 0.5, np.arange(albedo.shape[0]) + 0.5)
    near = (np.hypot(x - nose["pixel"][0], y - nose["pixel"][1]) < radius) & (albedo.max(-1) > 0)
    return np.median(albedo[near], axis=0).astype(np.float64) if near.any() else np.full(3, np.nan)


def typology_angle(albedo: np.ndarray) -> float:
    """Individual typology angle of a linear albedo (3,), degrees: atan2(L* - 50, b*) in CIE L*a*b*, D65.

    References
    ----------
    Chardon, Cretois and Hourseau 1991, DOI 10.1111/j.1467-2494.1991.tb00561.x: very light above 55, light above 41,
    intermediate above 28, tan above 10, brown above -30, else dark.
    """
    white = XYZ_FROM_RGB.sum(1)
    t = XYZ_FROM_RGB @ np.asarray(albedo, np.float64) / white
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return float(np.degrees(np.arctan2(116.0 * f[1] - 16.0 - 50.0, 200.0 * (f[1] - f[2]))))


def _parameters(heads: list[dict]) -> dict[str, tuple[Distribution | Tally, ...]]:
    """Every parameter that the heads were drawn with, by the part of the head it belongs to."""
    words: dict[str, dict[str, list[str]]] = {}
    numbers: dict[str, dict[str, list[float]]] = {}
    for head in heads:
        for group, name, value in _leaves(head):
            if isinstance(value, str | bool):
                words.setdefault(group, {}).setdefault(name, []).append(str(value))
            elif value is not None:
                numbers.setdefault(group, {}).setdefault(name, []).append(float(value))
    out: dict[str, tuple[Distribution | Tally, ...]] = {}
    for group in sorted({*words, *numbers}):
        of_words = [tally(name, found) for name, found in sorted(words.get(group, {}).items())]
        of_numbers = [distribution(name, "", found) for name, found in numbers.get(group, {}).items()]
        out[f"Parameters: {group}"] = (*of_words, *of_numbers)
    return out


def _leaves(head: dict):
    """(group, name, value) of each parameter; a list's entries share its name, nested names are joined."""
    for key, value in head.items():
        if key == "seed":
            continue
        if isinstance(value, dict):
            for _, name, inner in _leaves(value):
                yield key, name, inner
        elif isinstance(value, list):
            yield from (("head", key, item) for item in value)
        else:
            yield "head", key, value


def _short(value: float) -> float:
    return float(f"{float(value):.6g}")


def write_datasheet(folder: Path) -> Datasheet:
    """Describe `folder` in folder/datasheet.json and folder/datasheet.html; the same scenes give the same bytes."""
    from data_synth.datasheet_page import page

    sheet = describe(folder)
    write_text(folder / "datasheet.json", json.dumps(asdict(sheet), indent=1) + "\n")
    write_text(folder / "datasheet.html", page(sheet))
    return sheet

"""What the tools that measure fits share: fit a portrait, score it against its scene's truth, keep what is done.

Notation: lengths in mm, in the truth's world; "placed" as the fit stands, "after ICP" after rigid ICP on the face;
seconds are processor time of one process, so that a busy machine does not change them.
"""

import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

# Points a surface is measured with: noise of a face's mean below 0.01 mm.
SAMPLES = 20_000
# Raised when figures come out differently for the same fit: 2, renders have the fitted roughness.
SCORING = 2


@dataclass(frozen=True)
class Shape:
    """A portrait's fitted shape.

    Parameters
    ----------
    portrait : posed as the fit found it
    surface : closed triangles, canonical metres
    """

    portrait: object
    geometry: object
    surface: object
    seconds: Mapping[str, float]


@dataclass(frozen=True)
class Scene:
    """A portrait and its truth, the true surface without what no one sees."""

    name: str
    folder: Path
    portrait: object
    truth: object


def scene_and_truth(argument: str) -> tuple[Path, Path]:
    """`SCENE` or `SCENE=TRUTH` of a command line."""
    scene, _, truth = argument.partition("=")
    return Path(scene), Path(truth or scene)


def read_measured_scene(folder: Path, truth: Path) -> Scene:
    """Read a scene and the truth of its head.

    Raises
    ------
    InputError : either cannot be read.
    """
    from sira_assets.measure.outer_surface import outer_surface
    from sira_assets.measure.truth import camera_in_metres, read_truth
    from sira_assets.scene.read_scene import read_scene

    portrait = read_scene(folder)
    known = read_truth(truth, assumed_unit=portrait.metres_per_unit)
    camera = camera_in_metres(portrait.camera, portrait.metres_per_unit)
    known = replace(known, mesh=outer_surface(known.mesh), camera=camera)
    return Scene(portrait.name, folder, portrait, known)


def fit_shape(portrait, prior, settings) -> Shape:
    """Fit the geometry, extract and clean it, as the pipeline does."""
    from sira_assets.fit.appearance import unlit_head
    from sira_assets.fit.geometry import fit_geometry
    from sira_assets.mesh.clean import clean_mesh
    from sira_assets.mesh.extract import extract_mesh

    seconds: dict[str, float] = {}
    geometry = timed(seconds, "geometry", fit_geometry, portrait, prior, settings.geometry)
    surface = timed(seconds, "extract", extract_mesh, unlit_head(geometry, prior), settings.extract)
    surface = timed(seconds, "clean", clean_mesh, surface, settings.clean)
    posed = replace(portrait, canonical_from_world=geometry.canonical_from_world)
    return Shape(posed, geometry, surface, seconds)


def fit_material(shape: Shape, prior, settings):
    """The appearance fit on a fitted shape, and its processor seconds."""
    from sira_assets.fit.appearance import fit_appearance

    seconds: dict[str, float] = {}
    given = (shape.portrait, shape.geometry, prior, shape.surface, settings.appearance)
    return timed(seconds, "appearance", fit_appearance, *given), seconds


def timed(seconds: dict[str, float], name: str, function: Callable, *arguments):
    """Call, adding the processor seconds to `seconds[name]`."""
    started = time.process_time()
    out = function(*arguments)
    seconds[name] = seconds.get(name, 0.0) + time.process_time() - started
    return out


def face_errors(shape: Shape, scene: Scene) -> dict[str, float]:
    """Mean distances of the face, mm: placed, pred_to_gt, seen, unseen, after_icp (rigid), after_similarity; and of the
    whole head: head."""
    from sira_assets.measure.protocols import PRED_TO_GT, ProtocolConfig, measure_prepared

    unit = shape.portrait.metres_per_unit
    world_from_canonical = np.diag([unit, unit, unit, 1.0]) @ shape.portrait.world_from_canonical
    pred = shape.surface.transformed(world_from_canonical)
    config = ProtocolConfig(samples=SAMPLES)
    placed = measure_prepared(pred, scene.truth, config)
    kinds = {"after_icp": "rigid", "after_similarity": "similarity"}
    aligned = {n: measure_prepared(pred, scene.truth, replace(config, align=kind)) for n, kind in kinds.items()}
    found = {
        "placed": placed.distances("face"),
        "pred_to_gt": placed.distances("face", PRED_TO_GT),
        "seen": placed.distances("face", seen="seen"),
        "unseen": placed.distances("face", seen="unseen"),
        **{name: report.distances("face") for name, report in aligned.items()},
        "head": placed.distances("head"),
    }
    return {name: summary.mean_mm for name, summary in found.items() if summary is not None}


def picture_scores(shape: Shape, appearance, scene: Scene, *, photo=None, **options) -> dict[str, float]:
    """dB of the neural render: final (sRGB, raw); with exact maps also diffuse (linear, after one gain), specular
    (linear ks), specular_correlation, and what a constant specular would score; relit (sRGB, after one gain) where the
    scene has a relit truth.

    Parameters
    ----------
    photo : linear, where it is not the scene's own
    options : of `rendered`
    """
    from sira_assets.measure.image_metrics import correlation, score_image
    from sira_assets.measure.relit import relit_truth
    from sira_assets.scene.image import read_image

    mask, folder, gt = shape.portrait.mask, scene.folder, scene.folder / "gt"
    exact = folder / "image.exr"
    if photo is None:
        photo = read_image(exact).linear if exact.is_file() else shape.portrait.image_linear
    view = rendered(shape, appearance, shape.portrait.camera, appearance.light, **options)
    out = {"final": score_image(view.final, photo, mask).psnr_db}
    if (gt / "albedo.exr").is_file():
        albedo, ks = read_image(gt / "albedo.exr").linear, read_image(gt / "specular.exr").linear.mean(-1)
        ours = view.specular_f0 / 0.04
        out["diffuse"] = score_image(view.diffuse, albedo, mask, encoding="linear", scale_invariant=True).psnr_db
        out["specular"] = score_image(ours, ks, mask, encoding="linear").psnr_db
        flat = np.full_like(ks, ks[mask].mean())
        out["specular_constant"] = score_image(flat, ks, mask, encoding="linear").psnr_db
        out["specular_correlation"] = correlation(ours, ks, mask & view.hit)
    if (folder / "relight" / "image.exr").is_file():
        camera, light, truth, where = relit_truth(folder)
        view = rendered(shape, appearance, camera, light, **options)
        out["relit"] = score_image(view.final, truth, where, scale_invariant=True).psnr_db
    return out


def rendered(shape: Shape, appearance, camera, light, *, shadows: bool = True):
    """The fitted head seen by a camera under a light of the scene's world, with the shadows it casts."""
    from sira_assets.render.view import render_view
    from sira_assets.render.visibility_table import surface_visibility

    pose = shape.portrait.canonical_from_world
    cast = surface_visibility(shape.surface, light, pose) if shadows and appearance.shadowed else None
    return render_view(appearance.head, shape.surface, camera, pose, light, appearance.roughness, shadows=cast)


class Results:
    """Figures kept one file a case, so that a stopped run goes on; a case counts only under the same facts."""

    def __init__(self, folder: Path, facts: Mapping[str, object]):
        self.folder, self.facts = Path(folder), json.loads(json.dumps({"scoring": SCORING} | dict(facts)))

    def of(self, case: str, compute: Callable[[], Mapping[str, object]], **facts) -> dict[str, object]:
        """The case's figures as its file holds them, computed now unless they are there; `facts` are its own."""
        from sira_assets.atomic import write_text

        path, facts = self.folder / f"{case}.json", self.facts | facts
        try:
            kept = json.loads(path.read_text())
        except (OSError, ValueError):
            kept = {}
        if kept.get("facts") != facts:
            self.folder.mkdir(parents=True, exist_ok=True)
            text = json.dumps({"facts": facts, "figures": rounded(compute())}, indent=1)
            write_text(path, text + "\n")
            kept = json.loads(text)
        return kept["figures"]


def rounded(figures: Mapping[str, object]) -> dict[str, object]:
    """Floats to five digits after the point, for files that people read."""
    plain = {k: float(v) if isinstance(v, np.floating) else v for k, v in figures.items()}
    return {k: round(v, 5) if isinstance(v, float) else v for k, v in plain.items()}


def case_names(folders: Sequence[Path]) -> list[str]:
    """Each folder's name, told apart by where it lies if another has it too."""
    places = [folder.resolve() for folder in folders]
    names = [place.name for place in set(places)]
    told_apart = {place: f"-{short_digest(bytes(place))}" for place in places if names.count(place.name) > 1}
    return [place.name + told_apart.get(place, "") for place in places]


def scene_facts(folder: Path, truth: Path) -> str:
    """A short digest of a scene's description and its portrait's pixels, and of where its truth lies if elsewhere.

    Raises
    ------
    InputError : it cannot be read.
    """
    from sira_assets.scene.read_scene import read_frames

    frame = read_frames(folder)[0]
    described = [folder / name for name in ("transforms.json", "cameras.npz", "landmarks.json")]
    files = [path for path in (*described, frame.image_path, frame.mask_path) if path is not None and path.is_file()]
    elsewhere = b"" if truth == folder else bytes(truth.resolve())
    return short_digest(*(path.read_bytes() for path in files), elsewhere)


def short_digest(*parts: bytes) -> str:
    """Sixteen hex digits that change with any of the parts."""
    import hashlib

    return hashlib.sha256(b"".join(hashlib.sha256(part).digest() for part in parts)).hexdigest()[:16]


def prior_facts(path: Path | None) -> str:
    """A short digest of a prior's file (the shipped one's if None)."""
    from sira_assets.fields import prior

    file = Path(prior.__file__).parent / "weights" / "prior.safetensors" if path is None else Path(path)
    try:
        return short_digest(file.read_bytes())
    except OSError:
        return "none"  # reading it says so, with the remedy


def mean_of(rows: Iterable[Mapping[str, object]], name: str) -> float:
    """Mean of the figures of that name that are there and finite; NaN where none is."""
    values = [row[name] for row in rows if isinstance(row.get(name), int | float) and np.isfinite(row[name])]
    return float(np.mean(values)) if values else float("nan")


def print_table(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Aligned text; floats with two decimals, what is not there as a dash."""
    text = [[_cell(value) for value in row] for row in (columns, *rows)]
    widths = [max(len(row[k]) for row in text) for k in range(len(columns))]
    for row in text:
        cells = [row[0].ljust(widths[0]), *(cell.rjust(w) for cell, w in zip(row[1:], widths[1:], strict=True))]
        print("  ".join(cells).rstrip())


def write_rows(path: Path, rows: Sequence[Mapping[str, object]]) -> None:
    """All rows as JSON, or as CSV where the path ends so."""
    import csv
    import io

    from sira_assets.atomic import write_text

    if path.suffix == ".csv":
        names = list(dict.fromkeys(name for row in rows for name in row))
        text = io.StringIO()
        table = csv.DictWriter(text, names, lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
        write_text(path, text.getvalue())
    else:
        write_text(path, json.dumps(list(rows), indent=1) + "\n")


def _cell(value: object) -> str:
    if value is None or (isinstance(value, float) and not np.isfinite(value)):
        return "-"
    return f"{value:.2f}" if isinstance(value, float) else str(value)

"""Unwrapping that always ends: good methods in processes that can be killed, then a plain one that cannot fail.

Notation: V vertices, F faces, T atlas vertices (see `texture.atlas`). The way: what unwrappers choke on is taken away
(`sound_surface`), the rest is split into parts, each method gets the parts that are left and the time that is left,
box charts take what nobody could, faces that overlap, are squeezed or stand at a notch (`notches`) get charts of their
own, and all charts are packed.
"""

import time
from dataclasses import dataclass

import numpy as np

from sira_assets.mesh.triangle_mesh import TriangleMesh, face_cross_products
from sira_assets.texture.atlas import Atlas, chart_labels, measure_atlas, signed_uv_areas
from sira_assets.texture.box_charts import box_charts
from sira_assets.texture.notches import faces_at_notches, squeezed_faces
from sira_assets.texture.overlap import losers, overlapping_pairs
from sira_assets.texture.packing import pack_charts
from sira_assets.texture.sound_surface import SoundSurface, cut_open, face_pieces, sound_surface
from sira_assets.texture.texture_size import USUAL_UTILISATION
from sira_assets.texture.unwrap_cost import predicted_seconds
from sira_assets.texture.unwrap_parts import Part, split_parts, unwrap_parts

# UVAtlas never ends on a soup of hundreds of loose triangles.
_UVATLAS_PIECES = 30
# Up to so many faces xatlas is as good as UVAtlas, and does without Open3D's import in its process.
_FEW_FACES = 10_000
# A bank that is taken away has another bank behind it, most often far enough from the first.
_NOTCH_ROUNDS = 3


@dataclass(frozen=True)
class UnwrapConfig:
    """How the atlas is made.

    Parameters
    ----------
    texture_size : texels a side the padding is counted in
    padding : least distance between charts, texels; 4 keeps two mip levels apart
    methods : tried in this order in processes of their own; box charts, which cannot fail, follow by themselves. None:
        UVAtlas first, which makes fewer charts, but xatlas for small surfaces, where it is as good in half the time
    budget_s : seconds for all of it. A method whose predicted cost is beyond what is left is not begun
    whole_faces : surfaces of up to this many faces are unwrapped in one piece
    part_faces : larger ones are cut into parts of at most this many, unwrapped side by side
    workers : processes at once
    """

    texture_size: int = 1024
    padding: int = 4
    methods: tuple[str, ...] | None = None
    budget_s: float = 240.0
    whole_faces: int = 65000
    part_faces: int = 25000
    workers: int = 2


@dataclass(frozen=True)
class _Charts:
    """Charts of all sound faces, each where it fell, one texel density: uv (T, 2), faces_uv (G, 3)."""

    uv: np.ndarray
    faces_uv: np.ndarray


def unwrap(mesh: TriangleMesh, config: UnwrapConfig = UnwrapConfig()) -> Atlas:
    """Texture coordinates for every face of `mesh`, whatever the mesh.

    Faces of no area, and second copies of a face, are set aside (they defeat unwrappers) and put back afterwards: a
    copy shares its original's texels, a face of no area gets a point.

    Raises
    ------
    InputError : the mesh has no face of any area.
    """
    start, start_cpu = time.monotonic(), time.process_time()
    sound = sound_surface(mesh)
    charts, method, attempts, predicted = _charts(sound, config, start, start_cpu)
    charts = _without_squeezed(sound, _without_overlap(sound, charts))
    charts = _without_notches(sound, charts, config.texture_size)
    chart = chart_labels(charts.faces_uv, len(charts.uv))
    packed = pack_charts(charts.uv, charts.faces_uv, chart, config.texture_size, config.padding)
    uv, faces_uv = _put_back(mesh, sound, packed.uv, charts.faces_uv)
    report = measure_atlas(
        TriangleMesh(sound.vertices, sound.faces),
        packed.uv,
        charts.faces_uv,
        method=method,
        attempts=attempts,
        padding_texels=packed.padding,
        texture_size=config.texture_size,
        seconds=time.monotonic() - start,
        predicted_s=predicted,
    )
    return Atlas(uv, faces_uv, report)


def _charts(
    sound: SoundSurface, config: UnwrapConfig, start: float, start_cpu: float
) -> tuple[_Charts, str, tuple[str, ...], float]:
    """Charts of every part by the first method that manages it, the methods' names, what failed, the predicted cost."""
    faces, vertex = cut_open(sound.faces)
    most = config.whole_faces if len(faces) <= config.whole_faces else config.part_faces
    part = split_parts(sound.vertices[vertex], faces, face_pieces(faces), most)
    members = np.split(np.argsort(part, kind="stable"), np.cumsum(np.bincount(part))[:-1])
    left, done, attempts, used = list(range(len(members))), [], [], []
    # A machine that is busy gives this process a share only, and will give no more to what follows. Judged over little
    # time that is mostly chance, hence one second on an idle machine is counted in.
    slowness = max(1.0, (1.0 + time.monotonic() - start) / (1.0 + time.process_time() - start_cpu))
    after = predicted_seconds("boxes", [len(faces)]) + predicted_seconds("after", [len(faces)])
    after *= slowness
    predicted = predicted_seconds("after", [len(faces)])
    order = ("xatlas", "uvatlas") if len(faces) <= _FEW_FACES else ("uvatlas", "xatlas")
    for method in order if config.methods is None else config.methods:
        if method == "boxes":
            break
        fit, refused = _fit_for(method, faces, vertex, sound, members, left)
        attempts += refused
        if not fit:
            continue
        cost = slowness * predicted_seconds(method, [len(members[k]) for k in fit], min(config.workers, len(fit)))
        seconds = config.budget_s - after - (time.monotonic() - start)
        if cost > seconds:
            attempts.append(f"{method}: would take about {cost:.0f} s of the {max(seconds, 0.0):.3g} s left")
            continue
        predicted += cost / slowness
        results = unwrap_parts(method, list(fit.values()), seconds, config.workers)
        faults: dict[str, int] = {}
        for number, result in zip(fit, results, strict=True):
            if isinstance(result, str):
                faults[result] = faults.get(result, 0) + 1
            else:
                done.append((members[number], *_to_scale(fit[number], *result)))
                left.remove(number)
        used += [method] if len(faults) < len(fit) and any(not isinstance(r, str) for r in results) else []
        of = f"{{}} of {len(members)} parts "
        attempts += [f"{method}: {of.format(n) if len(members) > 1 else ''}{why}" for why, n in faults.items()]
    if left:
        rest = np.concatenate([members[k] for k in left])
        predicted += predicted_seconds("boxes", [len(rest)])
        done.append((rest, *box_charts(sound.vertices, sound.faces[rest])))
        used.append("boxes")
    return _joined(done, len(faces)), " + ".join(used), tuple(attempts), predicted


def _fit_for(method: str, faces: np.ndarray, vertex: np.ndarray, sound: SoundSurface, members: list, left: list[int]):
    """The parts a method may be given, {number: Part}, and a line for those it may not."""
    fit: dict[int, Part] = {}
    refused = 0
    for number in left:
        # Where a part was cut out, two fans may touch at a vertex: cut again.
        own, corner_vertex = cut_open(faces[members[number]])
        if method == "uvatlas" and face_pieces(own).max() + 1 > _UVATLAS_PIECES:
            refused += 1
            continue
        fit[number] = Part(sound.vertices[vertex[corner_vertex]], own)
    many = f"{refused} of {len(members)} parts are" if len(members) > 1 else "it is"
    return fit, [f"{method}: {many} of more than {_UVATLAS_PIECES} pieces"] if refused else []


def _to_scale(part: Part, uv: np.ndarray, faces_uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every chart turned right side up and scaled to the surface's own area: one texel density all over."""
    chart = chart_labels(faces_uv, len(uv))
    name = chart[faces_uv[:, 0]]
    area = signed_uv_areas(uv, faces_uv)
    surface = 0.5 * np.linalg.norm(face_cross_products(part.vertices, part.faces), axis=1)
    count = int(chart.max()) + 1
    signed, covered, true = (np.bincount(name, values, count) for values in (area, np.abs(area), surface))
    scale = np.sqrt(true / np.maximum(covered, 1e-300))
    scale[covered <= 0] = 1.0  # nothing to scale: its faces get other charts
    out = uv * scale[chart, None]
    out[:, 0] *= np.where(signed < 0, -1.0, 1.0)[chart]
    return out, faces_uv


def _joined(done: list[tuple[np.ndarray, np.ndarray, np.ndarray]], count: int) -> _Charts:
    faces_uv, offset = np.full((count, 3), -1), 0
    for members, uv, part_faces in done:
        faces_uv[members] = part_faces + offset
        offset += len(uv)
    return _Charts(np.concatenate([uv for _, uv, _ in done]), faces_uv)


def _without_overlap(sound: SoundSurface, charts: _Charts) -> _Charts:
    """Faces that are turned over, or lie over others of their chart, get box charts; no pair is left."""
    faces_uv = charts.faces_uv
    chart = chart_labels(faces_uv, len(charts.uv))[faces_uv[:, 0]]
    # Charts by box projection are free of overlap already, but looking again costs less than remembering which.
    pairs = overlapping_pairs(charts.uv, faces_uv, chart)
    return _in_boxes(sound, charts, losers(pairs, len(faces_uv)) | (signed_uv_areas(charts.uv, faces_uv) <= 0.0))


def _without_squeezed(sound: SoundSurface, charts: _Charts) -> _Charts:
    """Faces that a chart squeezes get box charts, which shrink a face by 1.8 at most."""
    return _in_boxes(sound, charts, squeezed_faces(charts.uv, charts.faces_uv, sound.vertices, sound.faces))


def _without_notches(sound: SoundSurface, charts: _Charts, size: int) -> _Charts:
    """Where a chart all but touches itself, faces of one bank get box charts."""
    area = 0.5 * np.linalg.norm(face_cross_products(sound.vertices, sound.faces), axis=1).sum()
    texel = float(np.sqrt(area / USUAL_UTILISATION)) / size
    for _ in range(_NOTCH_ROUNDS):
        wrong = faces_at_notches(charts.uv, charts.faces_uv, sound.vertices, sound.faces, texel)
        if not wrong.any():
            break
        charts = _in_boxes(sound, charts, wrong)
    return charts


def _in_boxes(sound: SoundSurface, charts: _Charts, some: np.ndarray) -> _Charts:
    """The same charts, but some faces (F,) in box charts of their own."""
    if not some.any():
        return charts
    members = np.flatnonzero(some)
    uv, own = box_charts(sound.vertices, sound.faces[members])
    return _joined([(np.flatnonzero(~some), charts.uv, charts.faces_uv[~some]), (members, uv, own)], len(some))


def _put_back(
    mesh: TriangleMesh, sound: SoundSurface, uv: np.ndarray, faces_uv: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Give every face of the mesh its place; then one mesh vertex for each atlas vertex, and none unused."""
    out = np.zeros((len(mesh.faces), 3), np.int64)
    placed = np.flatnonzero(sound.original >= 0)
    welded = sound.welded[mesh.faces]
    originals = sound.original[placed]
    for k in range(3):
        # A copy may start at another corner, or run the other way: corners are matched by their place.
        match = sound.faces[originals] == welded[placed, k, None]
        out[placed, k] = np.take_along_axis(faces_uv[originals], match.argmax(1)[:, None], 1)[:, 0]
    somewhere = np.full(len(sound.vertices), faces_uv[0, 0])
    somewhere[sound.faces] = faces_uv
    flat = sound.original < 0
    out[flat] = somewhere[welded[flat, :1]]
    key, inverse = np.unique((mesh.faces.reshape(-1) << 32) | out.reshape(-1), return_inverse=True)
    return uv[key & 0xFFFFFFFF], inverse.reshape(-1, 3)

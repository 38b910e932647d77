"""Unwrapping that always ends: a good method in a process that can be killed, then plainer ones.

Notation: V vertices, F faces, T atlas vertices (see `texture.atlas`).
"""

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sira_assets.errors import InputError
from sira_assets.mesh.topology import topology
from sira_assets.mesh.triangle_mesh import TriangleMesh, face_cross_products
from sira_assets.texture.atlas import Atlas, AtlasReport, chart_labels, signed_uv_areas, stretch
from sira_assets.texture.box_charts import box_atlas
from sira_assets.texture.raster import overlapping_faces

# xatlas chooses its own size, up to this much above the one asked for; its padding shrinks so when scaled back.
_XATLAS_OVERSIZE = 1.4
# UVAtlas never ends on a soup of hundreds of loose triangles; a cleaned head is one piece.
_UVATLAS_PIECES = 30
# An axis may be stretched this much more than the other to fill the square: more texels against a little anisotropy.
_MAX_ANISOTROPY = 1.25


@dataclass(frozen=True)
class UnwrapConfig:
    """How the atlas is made.

    Parameters
    ----------
    texture_size : texels a side the padding is counted in
    padding : least distance between charts, texels; 4 keeps two mip levels apart
    methods : tried in this order in processes of their own; "boxes", which cannot fail, follows by itself. On heads of
        20-25 thousand triangles UVAtlas cuts 4 to 28 charts, xatlas 80 to 400 (many of them slivers inside others),
        in about the same time
    budget_s : seconds each of them may take
    max_overlap : share of faces that may overlap another before a result is refused
    """

    texture_size: int = 1024
    padding: int = 4
    methods: tuple[str, ...] = ("uvatlas", "xatlas")
    budget_s: float = 60.0
    max_overlap: float = 0.002


def unwrap(mesh: TriangleMesh, config: UnwrapConfig = UnwrapConfig()) -> Atlas:
    """Texture coordinates for every face of `mesh`, whatever the mesh.

    Faces of no area, and second copies of a face, are set aside (they defeat unwrappers) and put back afterwards.

    Raises
    ------
    InputError : the mesh has no face of any area.
    """
    start = time.perf_counter()
    size = np.ptp(mesh.vertices, axis=0).max() if len(mesh.vertices) else 0.0
    unit = (mesh.vertices - mesh.vertices.min(0, initial=np.inf)) / max(size, 1e-300)
    sound = _sound_faces(unit, mesh.faces)
    if not sound.any():
        raise InputError(
            expected="a mesh with some area", received=f"{len(mesh.faces)} faces, none of any area", remedy="mend it"
        )
    faces = mesh.faces[sound]
    used, compact = np.unique(faces, return_inverse=True)
    compact, unit = compact.reshape(-1, 3), unit[used]
    attempts: list[str] = []
    for method in (*config.methods, "boxes"):
        result = _attempt(method, unit, compact, config)
        if not isinstance(result, str):
            uv, faces_uv = result
            break
        attempts.append(f"{method}: {result}")
    uv = _fill_square(uv, config)
    uv, faces_uv = _split_shared(uv, faces_uv, faces)
    uv, faces_uv = _put_back(mesh, sound, uv, faces_uv)
    ratio = stretch(mesh, uv, faces_uv)[sound]
    weight = np.linalg.norm(face_cross_products(mesh.vertices, faces), axis=1)
    order = np.argsort(ratio)
    middle = order[np.searchsorted(np.cumsum(weight[order]), 0.5 * weight.sum())]
    report = AtlasReport(
        method=method,
        charts=int(chart_labels(faces_uv[sound], len(uv))[np.unique(faces_uv[sound])].max()) + 1,
        utilisation=float(np.abs(signed_uv_areas(uv, faces_uv[sound])).sum()),
        seconds=time.perf_counter() - start,
        stretch=float(ratio[middle]),
        attempts=tuple(attempts),
    )
    return Atlas(uv, faces_uv, report)


def _attempt(
    method: str, unit: np.ndarray, faces: np.ndarray, config: UnwrapConfig
) -> tuple[np.ndarray, np.ndarray] | str:
    """uv and faces_uv by one method, or the reason why not."""
    if method == "boxes":
        return box_atlas(unit, faces, config.texture_size, config.padding)
    if method == "uvatlas":
        shape = topology(TriangleMesh(unit, faces))
        faults = shape.nonmanifold_edges + shape.nonmanifold_vertices + shape.misoriented_edges
        if faults or shape.pieces > _UVATLAS_PIECES:
            return f"needs one manifold surface, not {shape.pieces} pieces with {faults} faults"
    with tempfile.TemporaryDirectory(prefix="sira-unwrap-") as folder:
        source, target = Path(folder, "in.npz"), Path(folder, "out.npz")
        padding = int(np.ceil(config.padding * (_XATLAS_OVERSIZE if method == "xatlas" else 1.0)))
        np.savez(source, vertices=unit, faces=faces, size=config.texture_size, padding=padding)
        failure = _run_worker(method, source, target, config.budget_s)
        if failure:
            return failure
        with np.load(target, allow_pickle=False) as data:
            uv, faces_uv = np.asarray(data["uv"], np.float64), np.asarray(data["faces_uv"], np.int64)
    return _fault(uv, faces_uv, len(faces), config) or (uv, faces_uv)


def _run_worker(method: str, source: Path, target: Path, budget_s: float) -> str | None:
    """Run the worker; None if it wrote its result, else the reason in a few words."""
    # The package's own parent first, so that the child finds it however this process did.
    parent = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join(p for p in (parent, os.environ.get("PYTHONPATH")) if p)
    command = [sys.executable, "-m", "sira_assets.texture.unwrap_worker", method, str(source), str(target)]
    try:
        done = subprocess.run(
            command,
            env={**os.environ, "PYTHONPATH": path},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            timeout=budget_s,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"not done within {budget_s:g} s"
    if done.returncode or not target.exists():
        lines = done.stderr.decode(errors="replace").strip().splitlines()
        return f"ended with code {done.returncode}" + (f" ({lines[-1][:160]})" if lines else "")
    return None


def _fault(uv: np.ndarray, faces_uv: np.ndarray, faces: int, config: UnwrapConfig) -> str | None:
    """What is wrong with a result, if anything."""
    if faces_uv.shape != (faces, 3) or uv.ndim != 2 or not len(uv) or faces_uv.max() >= len(uv):
        return f"returned {faces_uv.shape[0]} faces of {faces}"
    if not np.isfinite(uv).all():
        return f"returned {int((~np.isfinite(uv)).any(1).sum())} coordinates that are not finite"
    flat = uv - uv.min(0)
    if np.ptp(flat, axis=0).min() <= 0:
        return "returned a picture of no extent"
    overlap = len(overlapping_faces(flat / flat.max(), faces_uv, config.texture_size)) / faces
    return f"{100 * overlap:.1f} % of the faces overlap" if overlap > config.max_overlap else None


def _sound_faces(unit: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F,) bool: faces of some area, the first of each set on the same three vertices."""
    if not len(faces):
        return np.zeros(0, bool)
    _, first = np.unique(np.sort(faces, 1), axis=0, return_index=True)
    out = np.zeros(len(faces), bool)
    out[first] = True
    # 1e-14 of the unit box's area: below it float32, in which unwrappers work, sees a segment.
    return out & (np.linalg.norm(face_cross_products(unit, faces), axis=1) > 1e-14)


def _fill_square(uv: np.ndarray, config: UnwrapConfig) -> np.ndarray:
    """Scale to the unit square less half the padding all round, so that repeating the picture does not bleed."""
    extent = np.ptp(uv, axis=0)
    scale = np.minimum(1.0 / extent, _MAX_ANISOTROPY / extent.max())
    margin = 0.5 * config.padding / config.texture_size
    return margin + (1.0 - 2.0 * margin) * np.clip((uv - uv.min(0)) * scale, 0.0, 1.0)


def _split_shared(uv: np.ndarray, faces_uv: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Make sure that an atlas vertex stands for one mesh vertex, and that none is unused."""
    key = np.stack([faces.reshape(-1), faces_uv.reshape(-1)], 1)
    rows, inverse = np.unique(key, axis=0, return_inverse=True)
    return uv[rows[:, 1]], inverse.reshape(-1, 3)


def _put_back(
    mesh: TriangleMesh, sound: np.ndarray, uv: np.ndarray, faces_uv: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Give the faces set aside their place: a copy its original's, a face of no area a point."""
    out = np.full((len(mesh.faces), 3), -1)
    out[sound] = faces_uv
    if sound.all():
        return uv, out
    numbers = np.flatnonzero(sound).tolist()
    originals = {tuple(sorted(mesh.faces[number].tolist())): number for number in numbers}
    somewhere = np.zeros(len(mesh.vertices), np.int64)
    somewhere[mesh.faces[sound]] = faces_uv
    extra: list[np.ndarray] = []
    for number in np.flatnonzero(~sound):
        face = mesh.faces[number].tolist()
        original = originals.get(tuple(sorted(face)))
        if original is not None:
            place = dict(zip(mesh.faces[original].tolist(), out[original].tolist(), strict=True))
            out[number] = [place[vertex] for vertex in face]
        else:
            # One new atlas vertex for each distinct corner, all at one spot: no area, nothing overdrawn.
            names = {vertex: len(uv) + len(extra) + k for k, vertex in enumerate(dict.fromkeys(face))}
            extra += [uv[somewhere[face[0]]]] * len(names)
            out[number] = [names[vertex] for vertex in face]
    return (np.vstack([uv, np.array(extra)]) if extra else uv), out

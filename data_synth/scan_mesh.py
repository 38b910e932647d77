"""A scan's parts to one clean mesh with material coordinates.

Notation: U vertices as the file has them, split where a texture is cut; V welded by position; `weld` (U,) -> V.
"""

from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

import numpy as np

from data_synth.scan_material import ScanMaterial
from data_synth.scan_parts import read_scan_parts
from sira_assets.errors import InputError

# Vertices nearer than this part of the scan's size are one: far below a scan's noise, above single precision.
WELD_WITHIN = 1e-6
DUST = 1e-3  # pieces with less of the whole area are floating scraps; an eyeball is 2 % of a head
LEAST_FACES = 200  # a head of fewer triangles shows no face
MOST_BORDER = 0.2  # of all edges; beyond, faces do not hang together


@dataclass(frozen=True)
class ScanMesh:
    """vertices (U, 3), faces (F, 3) into them, weld (U,), coordinates (U, 6), material; notes on what was done."""

    vertices: np.ndarray
    faces: np.ndarray
    weld: np.ndarray
    coordinates: np.ndarray
    material: ScanMaterial
    notes: tuple[str, ...]

    def only(self, keep: np.ndarray, *notes: str) -> "ScanMesh":
        """The faces where `keep` (F,) is True, without unused vertices."""
        used, faces = np.unique(self.faces[keep], return_inverse=True)
        _, weld = np.unique(self.weld[used], return_inverse=True)
        return replace(
            self,
            vertices=self.vertices[used],
            faces=faces.reshape(-1, 3),
            weld=weld,
            coordinates=self.coordinates[used],
            notes=(*self.notes, *notes),
        )

    def digest(self) -> str:
        """SHA-256 of the geometry, the coordinates and the pictures, hexadecimal.

        Coordinates hold decoded colours, whose last bits differ between processors: they count to six decimals.
        """
        total = sha256()
        for array in (self.vertices, self.faces, np.round(self.coordinates, 6) + 0.0, *self.material.pictures):
            total.update(b"\0" if array is None else f"{array.dtype} {array.shape} ".encode() + array.tobytes())
        return total.hexdigest()


def read_scan_mesh(path: str | Path, texture: str | Path | None = None, *, pieces: str = "all") -> ScanMesh:
    """Read any mesh that trimesh reads, and clean it: finite, welded, no double or empty faces, no scraps.

    Parameters
    ----------
    texture : picture for all parts with texture coordinates; None takes what the file names
    pieces : "all" or "largest"

    Raises
    ------
    InputError : unreadable, no triangles, too few of them, or faces that do not hang together.
    """
    path = Path(path)
    parts = read_scan_parts(path, None if texture is None else Path(texture))
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    mesh = ScanMesh(
        vertices=np.concatenate([part.vertices for part in parts]),
        faces=np.concatenate([part.faces + start for part, start in zip(parts, first, strict=False)]),
        weld=np.arange(first[-1]),
        coordinates=np.concatenate(
            [np.column_stack([np.full(len(p.vertices), k), p.uv, p.tint]) for k, p in enumerate(parts)]
        ),
        material=ScanMaterial(tuple(part.picture for part in parts)),
        notes=tuple(dict.fromkeys(note for part in parts for note in part.notes)),
    )
    return _cleaned(mesh, path, pieces)


def _cleaned(mesh: ScanMesh, path: Path, pieces: str) -> ScanMesh:
    finite = np.isfinite(mesh.vertices).all(1) & np.isfinite(mesh.coordinates).all(1)
    keep = finite[mesh.faces].all(1)
    left_out = () if keep.all() else (f"{int((~keep).sum())} faces with NaN or inf left out",)
    mesh = mesh.only(keep, *left_out)  # vertices of no face go too: size, weld and cameras reach for every vertex
    if len(mesh.faces) < LEAST_FACES:
        raise InputError(
            expected=f"a head of at least {LEAST_FACES} triangles in {path}",
            received=f"{len(mesh.faces)}",
            remedy="give the scan itself, not its bounding shape",
        )
    size = float(np.ptp(mesh.vertices, axis=0).max())
    grid = np.round((mesh.vertices - mesh.vertices.min(0)) / max(WELD_WITHIN * size, 1e-300)).astype(np.int64)
    _, first, weld = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    in_order = np.argsort(np.argsort(first))  # welded vertices keep the file's order
    mesh = replace(mesh, weld=in_order[weld.reshape(-1)])
    f = mesh.weld[mesh.faces]
    whole = (f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])
    _, first = np.unique(np.sort(f, axis=1), axis=0, return_index=True)
    single = np.zeros(len(f), bool)
    single[first] = True
    if not (whole & single).all():
        mesh = mesh.only(whole & single, f"{int((~(whole & single)).sum())} empty or double faces left out")
    border = border_share(mesh.weld[mesh.faces])
    if border <= MOST_BORDER:
        mesh = _without_scraps(mesh, pieces)
    if len(mesh.faces) < LEAST_FACES or border > MOST_BORDER:
        raise InputError(
            expected=f"a surface whose triangles hang together in {path}",
            received=f"{len(mesh.faces)} triangles left, {100 * border:.0f} % of the edges open",
            remedy="weld or remesh the scan",
        )
    return mesh


def border_share(faces: np.ndarray) -> float:
    """Part of the edges that belong to one face alone."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    return float((count == 1).mean())


def _without_scraps(mesh: ScanMesh, pieces: str) -> ScanMesh:
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    f, x = mesh.weld[mesh.faces], mesh.vertices[mesh.faces]
    count = int(mesh.weld.max()) + 1
    edges = np.concatenate([f[:, [0, 1]], f[:, [1, 2]]])
    _, label = connected_components(coo_matrix((np.ones(len(edges)), edges.T), (count, count)), directed=False)
    area = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
    of_piece = np.bincount(label[f[:, 0]], area)
    wanted = of_piece >= (of_piece.max() if pieces == "largest" else DUST * of_piece.sum())
    keep = wanted[label[f[:, 0]]]
    if keep.all():
        return mesh
    return mesh.only(keep, f"{int((of_piece > 0).sum() - wanted.sum())} separate pieces left out")

"""A scan's file to clean triangles with material coordinates.

Notation: U vertices as the file has them, split where a texture is cut; V welded by position; `weld` (U,) -> V.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from data_synth.scan_material import NEUTRAL_ALBEDO, ScanMaterial
from sira_assets.errors import InputError
from sira_assets.numerics.colour import linear_from_srgb

# Vertices nearer than this part of the scan's size are one: far below a scan's noise, above single precision.
WELD_WITHIN = 1e-6
DUST = 1e-3  # pieces with less of the whole area are floating scraps; an eyeball is 2 % of a head
LEAST_FACES = 200  # a head of fewer triangles shows no face
MOST_BORDER = 0.2  # of all edges; beyond, faces do not hang together


@dataclass(frozen=True)
class ScanMesh:
    """vertices (U, 3), faces (F, 3) into them, weld (U,), coordinates (U, 4), material; notes on what was done."""

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

    def welded_vertices(self) -> np.ndarray:
        """(V, 3); of vertices that are one, the first."""
        _, first = np.unique(self.weld, return_index=True)
        return self.vertices[first]


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
    picture = None if texture is None else _read_picture(Path(texture))
    vertices, faces, coordinates, pictures, notes, offset = [], [], [], [], [], 0
    for part in _load_parts(path):
        x, f, c, own = _part_arrays(part, len(pictures), picture, notes)
        vertices.append(x)
        faces.append(f + offset)
        coordinates.append(c)
        pictures.append(own)
        offset += len(x)
    if picture is not None and all(p is None for p in pictures):
        raise InputError(
            expected=f"texture coordinates in {path}",
            received="none",
            remedy="leave out the texture, or unwrap the mesh",
        )
    x, f = np.concatenate(vertices), np.concatenate(faces)
    mesh = ScanMesh(x, f, np.arange(len(x)), np.concatenate(coordinates), ScanMaterial(tuple(pictures)), tuple(notes))
    return _cleaned(mesh, path, pieces)


def _load_parts(path: Path) -> list:
    import trimesh

    if not path.is_file():
        raise InputError(expected=f"a mesh file {path}", received="no such file", remedy="check the path")
    try:
        loaded = trimesh.load(path, process=False)
        scene = loaded if isinstance(loaded, trimesh.Scene) else trimesh.Scene(loaded)
        parts = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh) and len(part.faces)]
    except Exception as error:  # trimesh's readers raise whatever their parsers do
        raise InputError(
            expected=f"a mesh that trimesh reads at {path}",
            received=f"{type(error).__name__}: {error}"[:200],
            remedy="export it as PLY, OBJ or GLB",
        ) from None
    if not parts:
        raise InputError(
            expected=f"triangles in {path}", received="none (points?)", remedy="export a surface, not a point cloud"
        )
    return parts


def _read_picture(path: Path) -> np.ndarray:
    from PIL import Image, UnidentifiedImageError

    if not path.is_file():
        raise InputError(expected=f"a picture {path}", received="no such file", remedy="check the path")
    try:
        with Image.open(path) as image:
            return np.asarray(image.convert("RGB"))
    except (UnidentifiedImageError, OSError, Image.DecompressionBombError) as error:
        raise InputError(
            expected=f"a picture {path}", received=str(error)[:120], remedy="export as PNG or JPEG"
        ) from None


def _part_arrays(part, number: int, picture: np.ndarray | None, notes: list[str]):
    """Vertices, faces, coordinates and picture of one part."""
    x, f = np.asarray(part.vertices, np.float64), np.asarray(part.faces, np.int64)
    visual, own = part.visual, None
    uv = getattr(visual, "uv", None)
    if uv is not None and len(uv) == len(x):
        own = picture if picture is not None else _picture_of(visual.material)
    if own is not None:
        colour = np.column_stack([np.asarray(uv, np.float64), np.zeros(len(x))])
    elif visual.kind == "face":
        x, f = x[f].reshape(-1, 3), np.arange(3 * len(f)).reshape(-1, 3)
        colour = linear_from_srgb(np.repeat(np.asarray(visual.face_colors)[:, :3], 3, axis=0) / 255.0)
    elif visual.kind == "vertex":
        colour = linear_from_srgb(np.asarray(visual.vertex_colors)[:, :3] / 255.0)
    else:
        colour = np.broadcast_to(NEUTRAL_ALBEDO, x.shape)
        what = "texture coordinates but no picture (give one with --scan-texture)" if uv is not None else "no colours"
        notes.append(f"{what}: neutral grey {NEUTRAL_ALBEDO[0]:g}")
    return x, f, np.column_stack([np.full(len(x), number), colour]), own


def _picture_of(material) -> np.ndarray | None:
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    return None if image is None else np.asarray(image.convert("RGB"))


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

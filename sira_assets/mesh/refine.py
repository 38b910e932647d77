"""Splitting triangles where the zero set leaves them by more than a tolerance.

Notation: t the tolerance; f the field's signed distance; g its slope at a vertex, |f| at t along the normal over t (at
most 1). An edge or face is tested by |f| / g in its middle, with the least g of its vertices: trained fields are as
flat as g = 0.2 in hollows. A split face gets one, two or three of its edges' midpoints, each on the zero set, so that
the mesh stays conforming. Whenever an edge of a face is split, its longest one is as well: angles then stay bounded
however often it happens (Rivara 1984, DOI 10.1002/nme.1620200412).
"""

import numpy as np

from sira_assets.errors import InputError
from sira_assets.fields.head_field import BOUNDS_M, HeadField, query
from sira_assets.mesh.lattice import bounds_sdf, chunk_for
from sira_assets.mesh.project import ProjectConfig, project_points
from sira_assets.mesh.topology import edge_keys
from sira_assets.mesh.triangle_mesh import TriangleMesh, face_cross_products

# The middle of an edge or face is not quite its worst point, and slopes change between vertices, so half the tolerance
# is asked of the tested points.
SHARE = 0.5
# Flatter fields than this count as this flat: their distances are guesses.
LEAST_SLOPE = 0.05
# Vertices count as on the zero set at |f| up to ProjectConfig's tolerance; less than twice that cannot be asked.
LEAST_LIMIT_M = 2 * ProjectConfig.tolerance_m
# Edges 256 times shorter. At a sharp crease, where each pass gains a fifth only, some hundredths of a cell are left
# then; networks of smooth activations have none.
MAX_PASSES = 8


def refine_mesh(
    field: HeadField,
    mesh: TriangleMesh,
    tolerance_m: float,
    *,
    max_triangles: int = 20_000_000,
    margin_m: float = 0.0,
    device: str = "cpu",
) -> tuple[TriangleMesh, int]:
    """Split triangles of a mesh on the zero set until their middles stand within `tolerance_m` of it.

    Splitting cannot mend a mesh that joins what the zero set keeps apart, such as two nostrils through a septum thinner
    than the lattice's cell: its faces there are counted as lost, and left.

    Parameters
    ----------
    mesh : canonical metres, manifold, vertices on the zero set
    margin_m : edges within this of the head's box are left alone, for the box cuts the surface there

    Returns
    -------
    TriangleMesh : closed where `mesh` is, vertices of `mesh` first, unmoved where they are on the zero set; field
        normals at moved and new ones.
    int : lost faces, none of whose corners came within the tolerance of the zero set

    Raises
    ------
    InputError : more than `max_triangles` would be needed.
    """
    vertices, faces, normals = mesh.vertices, mesh.faces, mesh.normals
    tested = np.empty(0, np.int64)  # keys of edges that need no split
    untested = np.ones(len(faces), bool)
    limit = _limits(field, vertices, normals, tolerance_m, device)
    off = np.flatnonzero(_far(field, vertices, limit, margin_m, device))  # vertices that are not on the zero set
    reach = np.zeros(len(vertices))
    if len(off):
        ends = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        length = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1)
        np.maximum.at(reach, ends[:, 0], 0.5 * length)
    for _ in range(MAX_PASSES):
        edges, face_edge = _edges(faces)
        keys = edge_keys(edges)
        fresh = np.zeros(len(edges), bool)
        fresh[face_edge[untested].reshape(-1)] = True
        fresh &= ~np.isin(keys, tested)
        # Where no corner could be brought to the zero set, smaller faces cannot be either: the lattice missed a wall or
        # a gap there, and splitting would go on until the last pass without coming nearer.
        lost = np.isin(np.arange(len(vertices)), off)
        fresh &= ~lost[edges].all(1)
        middle = 0.5 * (vertices[edges[:, 0]] + vertices[edges[:, 1]])
        split = np.zeros(len(edges), bool)
        split[fresh] = _far(field, middle[fresh], limit[edges[fresh]].min(1), margin_m, device)
        tested = np.union1d(tested, keys[fresh & ~split])
        # A face whose edges are all good may still bulge between them.
        whole = np.flatnonzero(untested & ~split[face_edge].any(1) & ~lost[faces].all(1))
        own = faces[whole]
        bulging = whole[_far(field, vertices[own].mean(1), limit[own].min(1), margin_m, device)]
        length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        longest = face_edge[np.arange(len(faces)), length[face_edge].argmax(1)]
        split[longest[bulging]] = True
        if not split.any():
            break
        while True:
            needed = longest[split[face_edge].any(1)]
            if split[needed].all():
                break
            split[needed] = True
        if len(faces) + 2 * int(split.sum()) > max_triangles:
            raise InputError(
                expected=f"a surface within {1e3 * tolerance_m:g} mm by {max_triangles} triangles",
                received=f"{len(faces) + 2 * int(split.sum())} so far",
                remedy="use a larger tolerance",
            )
        mean = normals[edges[split, 0]] + normals[edges[split, 1]]
        mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
        number = np.full(len(edges), -1)
        number[split] = len(vertices) + np.arange(len(mean))
        vertices = np.concatenate([vertices, middle[split]])
        faces, untested = _split_faces(faces, number[face_edge], vertices)
        # No point goes further than half its edge, or it would pass its neighbours. Points that are not on the zero set
        # yet, for a face would have turned over, try again beside smaller faces.
        reach = np.concatenate([reach, 0.5 * length[split]])
        limit = np.concatenate([limit, np.zeros(len(mean))])
        off = np.concatenate([off, np.arange(len(vertices) - len(mean), len(vertices))])
        flat = TriangleMesh(vertices, faces, np.concatenate([normals, mean]))
        vertices, normals = _settle(field, flat, off, reach[off], device)
        limit[off] = _limits(field, vertices[off], normals[off], tolerance_m, device)
        off = off[_far(field, vertices[off], limit[off], margin_m, device)]
        untested |= np.isin(faces, off).any(1)
    return TriangleMesh(vertices, faces, normals), int(np.isin(faces, off).all(1).sum())


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(E, 2) edges, low index first, and (F, 3) edge of each face's sides 01, 12, 20."""
    key, inverse = np.unique(edge_keys(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)), return_inverse=True)
    return np.stack([key >> 32, key & 0xFFFFFFFF], 1), inverse.reshape(-1, 3)


def _limits(field: HeadField, points: np.ndarray, normals: np.ndarray, tolerance_m: float, device: str) -> np.ndarray:
    """(N,) |f| that is allowed beside points of the zero set: half the tolerance times g."""
    slope = np.zeros(len(points))
    # Both ways: beside a crease the field is flat one way only.
    for step in (tolerance_m, -tolerance_m):
        value = _sdf(field, np.clip(points + step * normals, *BOUNDS_M), device)
        slope = np.maximum(slope, np.abs(value) / tolerance_m)
    return np.maximum(SHARE * tolerance_m * np.clip(slope, LEAST_SLOPE, 1.0), LEAST_LIMIT_M)


def _sdf(field: HeadField, points: np.ndarray, device: str) -> np.ndarray:
    return query(field, points, device=device, chunk=chunk_for(device)).sdf_m.astype(np.float64)


def _settle(
    field: HeadField,
    mesh: TriangleMesh,
    rows: np.ndarray,
    reach_m: np.ndarray,
    device: str,
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and normals with those of `rows` moved onto the zero set, where no face turns over by it."""
    steps = ProjectConfig(max_distance_m=float(reach_m.max()))
    moved = project_points(field, mesh.vertices[rows], steps, device=device)
    reached = np.abs(moved.residual_m) <= 10 * steps.tolerance_m
    reached &= np.linalg.norm(moved.points - mesh.vertices[rows], axis=1) <= reach_m
    vertices, normals = mesh.vertices.copy(), mesh.normals.copy()
    vertices[rows[reached]], normals[rows[reached]] = moved.points[reached], moved.normals[reached]
    mine = np.zeros(len(vertices), bool)
    mine[rows] = True
    touched = mesh.faces[mine[mesh.faces].any(1)]
    before = _facing(mesh.vertices, mesh.normals, touched)
    while True:
        # A face may turn as far as its field normals say, for it may have cut across a crease before.
        turned = _facing(vertices, normals, touched) < np.minimum(0.1, before)
        back = np.unique(touched[turned])
        back = back[(vertices[back] != mesh.vertices[back]).any(1)]
        if not len(back):
            break
        vertices[back], normals[back] = mesh.vertices[back], mesh.normals[back]
    return vertices, normals


def _far(field: HeadField, points: np.ndarray, limit_m: np.ndarray, margin_m: float, device: str) -> np.ndarray:
    """(N,) bool: |f| > limit (N,), away from the box."""
    far = np.zeros(len(points), bool)
    asked = np.flatnonzero(bounds_sdf(points) < -margin_m)
    if len(asked):
        far[asked] = np.abs(_sdf(field, points[asked], device)) > limit_m[asked]
    return far


def _facing(vertices: np.ndarray, normals: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F,) cosine between each face's own normal and the mean of its vertices'."""
    own, mean = face_cross_products(vertices, faces), normals[faces].mean(1)
    return (own * mean).sum(1) / np.maximum(np.linalg.norm(own, axis=1) * np.linalg.norm(mean, axis=1), 1e-30)


def _split_faces(faces: np.ndarray, middle: np.ndarray, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Faces cut at the midpoints (F, 3) of their sides 01, 12, 20 (-1: none); and which of them are new."""
    count = (middle >= 0).sum(1)
    out = [faces[count == 0]]
    for sides in ((0,), (1,), (2,), (0, 1), (1, 2), (2, 0), (0, 1, 2)):
        rows = (count == len(sides)) & (middle[:, sides] >= 0).all(1)
        if not rows.any():
            continue
        # Turned so that the first cut side comes first: a, b, c with midpoints d on ab, e on bc, f on ca.
        a, b, c = (faces[rows][:, (sides[0] + k) % 3] for k in range(3))
        d, e, f = (middle[rows][:, (sides[0] + k) % 3] for k in range(3))
        if len(sides) == 1:
            parts = [(a, d, c), (d, b, c)]
        elif len(sides) == 2:
            # The four-sided rest a d e c is cut by its shorter diagonal.
            short = np.linalg.norm(vertices[a] - vertices[e], axis=1) < np.linalg.norm(
                vertices[d] - vertices[c], axis=1
            )
            parts = [(d, b, e), (a, d, np.where(short, e, c)), (np.where(short, a, d), e, c)]
        else:
            parts = [(a, d, f), (d, b, e), (f, e, c), (d, e, f)]
        out += [np.stack(part, 1) for part in parts]
    new = np.ones(sum(len(part) for part in out), bool)
    new[: len(out[0])] = False
    return np.concatenate(out), new

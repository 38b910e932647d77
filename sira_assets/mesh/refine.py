"""Splitting triangles where the zero set leaves them by more than a tolerance.

Notation: t the tolerance; f the field's signed distance; an edge or face is tested by |f| in its middle. A split face gets
one, two or three of its edges' midpoints, each on the zero set, so that the mesh stays conforming. Whenever an edge of a
face is split, its longest one is as well: angles then stay bounded however often it happens (Rivara 1984, DOI
10.1002/nme.1620200412).
"""

import numpy as np

from sira_assets.errors import InputError
from sira_assets.fields.head_field import HeadField, query
from sira_assets.mesh.lattice import bounds_sdf, chunk_for
from sira_assets.mesh.project import ProjectConfig, project_points, turned_faces
from sira_assets.mesh.topology import edge_keys
from sira_assets.mesh.triangle_mesh import TriangleMesh

# |f| is a distance times the field's slope. Trained fields have slopes of 0.7 to 1.3 near the surface, and the middle of
# a triangle is not quite its worst point, so half the tolerance is asked of the tested points.
SHARE = 0.5
MAX_PASSES = 8  # edges 256 times shorter: beyond that the zero set is a fold that float32 does not resolve


def refine_mesh(
    field: HeadField,
    mesh: TriangleMesh,
    tolerance_m: float,
    *,
    max_triangles: int = 20_000_000,
    margin_m: float = 0.0,
    device: str = "cpu",
) -> TriangleMesh:
    """Split triangles of a mesh on the zero set until their middles stand within `tolerance_m` of it.

    Parameters
    ----------
    mesh : canonical metres, manifold, vertices on the zero set
    margin_m : edges within this of the head's box are left alone, for the box cuts the surface there

    Returns
    -------
    TriangleMesh : closed where `mesh` is, vertices of `mesh` first and unmoved, field normals at new ones.

    Raises
    ------
    InputError : more than `max_triangles` would be needed.
    """
    vertices, faces, normals = mesh.vertices, mesh.faces, mesh.normals
    tested = np.empty(0, np.int64)  # keys of edges that need no split
    todo = np.ones(len(faces), bool)
    for _ in range(MAX_PASSES):
        edges, face_edge = _edges(faces)
        keys = edge_keys(edges)
        fresh = np.zeros(len(edges), bool)
        fresh[face_edge[todo].reshape(-1)] = True
        fresh &= ~np.isin(keys, tested)
        middle = 0.5 * (vertices[edges[:, 0]] + vertices[edges[:, 1]])
        split = np.zeros(len(edges), bool)
        split[fresh] = _far(field, middle[fresh], SHARE * tolerance_m, margin_m, device)
        tested = np.union1d(tested, keys[fresh & ~split])
        # A face whose edges are all good may still bulge between them.
        whole = np.flatnonzero(todo & ~split[face_edge].any(1))
        bulging = whole[_far(field, vertices[faces[whole]].mean(1), SHARE * tolerance_m, margin_m, device)]
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
        steps = ProjectConfig(max_distance_m=float(0.5 * length[split].max()))
        moved = project_points(field, middle[split], steps, device=device)
        reached = np.abs(moved.residual_m) <= 10 * steps.tolerance_m
        # No point goes further than half its edge: it would pass its neighbours.
        reached &= np.linalg.norm(moved.points - middle[split], axis=1) <= 0.5 * length[split]
        mean = normals[edges[split, 0]] + normals[edges[split, 1]]
        reached &= (mean * moved.normals).sum(1) > 0.0
        mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
        added = np.where(reached[:, None], moved.points, middle[split])
        number = np.full(len(edges), -1)
        number[split] = len(vertices) + np.arange(len(added))
        faces, todo = _split_faces(faces, number[face_edge], np.concatenate([vertices, added]))
        added = _unturned(np.concatenate([vertices, middle[split]]), added, faces, todo)
        back = (added == middle[split]).all(1)
        normals = np.concatenate([normals, np.where((reached & ~back)[:, None], moved.normals, mean)])
        vertices = np.concatenate([vertices, added])
    return TriangleMesh(vertices, faces, normals)


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(E, 2) edges, low index first, and (F, 3) edge of each face's sides 01, 12, 20."""
    key, inverse = np.unique(edge_keys(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)), return_inverse=True)
    return np.stack([key >> 32, key & 0xFFFFFFFF], 1), inverse.reshape(-1, 3)


def _far(field: HeadField, points: np.ndarray, limit_m: float, margin_m: float, device: str) -> np.ndarray:
    """(N,) bool: |f| > limit, away from the box."""
    far = np.zeros(len(points), bool)
    asked = np.flatnonzero(bounds_sdf(points) < -margin_m)
    if len(asked):
        far[asked] = np.abs(query(field, points[asked], device=device, chunk=chunk_for(device)).sdf_m) > limit_m
    return far


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


def _unturned(flat: np.ndarray, added: np.ndarray, faces: np.ndarray, new: np.ndarray) -> np.ndarray:
    """The added vertices, those whose move turns a face over put back to where they stand in `flat`."""
    old = len(flat) - len(added)
    while True:
        turned = turned_faces(flat, np.concatenate([flat[:old], added]), faces[new])
        back = np.unique(faces[new][turned])
        back = back[back >= old] - old
        back = back[(added[back] != flat[old + back]).any(1)]
        if not len(back):
            return added
        added = added.copy()
        added[back] = flat[old + back]

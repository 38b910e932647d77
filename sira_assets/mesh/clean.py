"""From any triangles to one clean surface, closed where it can be, without small handles or faces of no area.

Notation: a piece is a set of faces connected through vertices; its signed volume is positive when its faces look out.
"""

from dataclasses import dataclass, replace

import numpy as np

from sira_assets.errors import InputError
from sira_assets.mesh.handles import close_handles
from sira_assets.mesh.lattice import bounds_sdf
from sira_assets.mesh.self_intersection import self_intersecting_faces
from sira_assets.mesh.topology import Topology, edge_keys, nonmanifold_vertices, topology, vertex_pieces
from sira_assets.mesh.triangle_mesh import TriangleMesh, face_cross_products


@dataclass(frozen=True)
class CleanConfig:
    """What is repaired.

    Parameters
    ----------
    min_area_m2 : faces below this are dropped; 1e-16 m^2 is a square of 10 nm, far below any lattice
    close_holes_of : holes of up to this many edges are closed (0: none)
    close_handles_of_m : tunnels and bridges are closed that a loop of at most this length goes around; 15 mm is that
        of a pencil, and nothing of a head is a ring so thin (0: none)
    open_bust : leave off the flat caps where the head's box cuts the shoulders, for use on another body
    """

    min_area_m2: float = 1e-16
    close_holes_of: int = 500
    close_handles_of_m: float = 0.015
    open_bust: bool = False


@dataclass(frozen=True)
class CleanReport:
    """What was done, and what came out.

    Parameters
    ----------
    self_intersecting_faces : faces of the result that pass through others; counted, not repaired
    """

    welded_vertices: int
    dropped_faces: int
    dropped_pieces: int
    dropped_piece_faces: int
    repaired_nonmanifold: bool
    closed_holes: bool
    closed_handles: int
    self_intersecting_faces: int
    result: Topology


def clean_mesh(mesh: TriangleMesh, config: CleanConfig = CleanConfig()) -> TriangleMesh:
    """`clean_with_report` without the report."""
    return _clean(mesh, config)[0]


def clean_with_report(mesh: TriangleMesh, config: CleanConfig = CleanConfig()) -> tuple[TriangleMesh, CleanReport]:
    """Weld, drop bad faces, keep the largest piece, repair what is not manifold, close small holes and handles.

    Normals are kept but along the cuts of closed handles, where they become their faces' mean; all do where repairing
    what was not manifold changes how many vertices there are.

    Parameters
    ----------
    mesh : canonical metres

    Returns
    -------
    TriangleMesh, CleanReport

    Raises
    ------
    InputError : nothing is left.
    """
    out, report = _clean(mesh, config)
    return out, replace(report, self_intersecting_faces=int(self_intersecting_faces(out).sum()))


def _clean(mesh: TriangleMesh, config: CleanConfig) -> tuple[TriangleMesh, CleanReport]:
    """All but the count of self-intersections, which takes as long as the rest."""
    welded, count = _weld(mesh)
    sound = _drop_bad_faces(welded, config)
    largest, pieces = _largest_piece(sound)
    out = _drop_unused(largest)
    before = topology(out)
    broken = before.nonmanifold_edges + before.nonmanifold_vertices + before.misoriented_edges > 0
    holes = before.boundary_edges > 0 and config.close_holes_of > 0
    if broken:
        out = _split_nonmanifold(out)
    if broken or holes:
        out = _drop_unused(_largest_piece(_meshlab_repair(out, config.close_holes_of if holes or broken else 0))[0])
    handles = 0
    if config.close_handles_of_m > 0:
        out, handles = close_handles(out, config.close_handles_of_m)
    if config.open_bust:
        on_cap = (bounds_sdf(out.vertices) > -1e-7)[out.faces].all(1)
        out = _drop_unused(TriangleMesh(out.vertices, out.faces[~on_cap], out.normals))
    if not len(out.faces):
        raise InputError(
            expected="a mesh with some area",
            received=f"{len(mesh.faces)} faces, none usable",
            remedy="check the fit: its surface has no extent",
        )
    return out, CleanReport(
        welded_vertices=count,
        dropped_faces=len(welded.faces) - len(sound.faces),
        dropped_pieces=pieces,
        dropped_piece_faces=len(sound.faces) - len(largest.faces),
        repaired_nonmanifold=broken,
        closed_holes=holes,
        closed_handles=handles,
        self_intersecting_faces=0,
        result=topology(out),
    )


def _weld(mesh: TriangleMesh) -> tuple[TriangleMesh, int]:
    """Join vertices at exactly the same place."""
    _, first, inverse = np.unique(mesh.vertices, axis=0, return_index=True, return_inverse=True)
    if len(first) == len(mesh.vertices):
        return mesh, 0
    welded = TriangleMesh(mesh.vertices[first], inverse.reshape(-1)[mesh.faces], mesh.normals[first])
    return welded, len(mesh.vertices) - len(first)


def _drop_bad_faces(mesh: TriangleMesh, config: CleanConfig) -> TriangleMesh:
    """Drop faces with a repeated vertex, faces of no area, and all but one of faces on the same three vertices."""
    faces = mesh.faces
    area = 0.5 * np.linalg.norm(face_cross_products(mesh.vertices, faces), axis=1)
    _, first = np.unique(np.sort(faces, 1), axis=0, return_index=True)
    keep = np.zeros(len(faces), bool)
    keep[first] = True
    keep &= area > config.min_area_m2
    return mesh if keep.all() else TriangleMesh(mesh.vertices, faces[keep], mesh.normals)


def _largest_piece(mesh: TriangleMesh) -> tuple[TriangleMesh, int]:
    """The piece of largest area among those whose faces look out (a cavity looks in); how many were dropped."""
    if not len(mesh.faces):
        return mesh, 0
    label = vertex_pieces(mesh)[mesh.faces[:, 0]]
    names, label = np.unique(label, return_inverse=True)
    if len(names) == 1:
        return mesh, 0
    cross = face_cross_products(mesh.vertices, mesh.faces)
    centred = mesh.vertices - mesh.vertices.mean(0)
    area = np.bincount(label, 0.5 * np.linalg.norm(cross, axis=1))
    volume = np.bincount(label, (centred[mesh.faces[:, 0]] * cross).sum(1))
    if (volume > 0).any():
        area = np.where(volume > 0, area, 0.0)
    return TriangleMesh(mesh.vertices, mesh.faces[label == area.argmax()], mesh.normals), len(names) - 1


def _drop_unused(mesh: TriangleMesh) -> TriangleMesh:
    """Drop vertices of no face."""
    used = np.unique(mesh.faces)
    if len(used) == len(mesh.vertices):
        return mesh
    renumber = np.full(len(mesh.vertices), -1)
    renumber[used] = np.arange(len(used))
    return TriangleMesh(mesh.vertices[used], renumber[mesh.faces], mesh.normals[used])


def _split_nonmanifold(mesh: TriangleMesh) -> TriangleMesh:
    """Drop the smallest faces of edges with more than two, then give each fan at a vertex its own copy of it."""
    faces = mesh.faces
    area = np.linalg.norm(face_cross_products(mesh.vertices, faces), axis=1)
    while True:
        key = edge_keys(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2))
        _, inverse, counts = np.unique(key, return_inverse=True, return_counts=True)
        crowded = (counts > 2)[inverse].reshape(-1, 3).any(1)
        if not crowded.any():
            break
        # One face at a time for each crowded edge: the smallest, which is most likely the spurious one.
        order = np.argsort(np.repeat(area, 3), kind="stable")
        first = {}
        for position in order[(counts > 2)[inverse[order]]]:
            first.setdefault(inverse[position], position // 3)
        drop = np.unique(list(first.values()))
        faces, area = np.delete(faces, drop, 0), np.delete(area, drop)
    vertices, normals, faces = mesh.vertices, mesh.normals, faces.copy()
    for vertex in nonmanifold_vertices(TriangleMesh(vertices, faces, normals)):
        around = np.flatnonzero((faces == vertex).any(1))
        for fan in _fans(faces[around], vertex)[1:]:
            rows = faces[around[fan]]
            rows[rows == vertex] = len(vertices)
            faces[around[fan]] = rows
            vertices, normals = np.vstack([vertices, vertices[vertex]]), np.vstack([normals, normals[vertex]])
    return TriangleMesh(vertices, faces, normals)


def _fans(faces: np.ndarray, vertex: int) -> list[np.ndarray]:
    """Groups of these faces, all at `vertex`, that are linked through edges at it."""
    groups: list[tuple[set[int], list[int]]] = []
    for number, face in enumerate(faces):
        ring, members = {int(v) for v in face if v != vertex}, [number]
        for other in [group for group in groups if group[0] & ring]:
            groups.remove(other)
            ring, members = ring | other[0], members + other[1]
        groups.append((ring, members))
    return [np.array(members) for _, members in sorted(groups, key=lambda group: -len(group[1]))]


def _meshlab_repair(mesh: TriangleMesh, close_holes_of: int) -> TriangleMesh:
    """pymeshlab's orientation and hole closing; a hole it refuses stays."""
    import pymeshlab

    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.faces, v_normals_matrix=mesh.normals))
    if topology(mesh).misoriented_edges:
        meshes.meshing_re_orient_faces_coherently()
    if close_holes_of:
        try:
            meshes.meshing_close_holes(maxholesize=close_holes_of, selfintersection=False)
        except pymeshlab.PyMeshLabException:
            return mesh  # it will not touch a mesh that is still not manifold; the report says what is left
    result = meshes.current_mesh()
    # Copies: the matrices are views that die with the MeshSet.
    vertices, faces = np.array(result.vertex_matrix()), np.array(result.face_matrix(), np.int64)
    return TriangleMesh(vertices, faces, mesh.normals if len(vertices) == len(mesh.vertices) else None)

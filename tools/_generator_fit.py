"""Fit the generator's shape parameters to a scan of known geometry: what it can represent, as a distance.

Notation: ``theta`` the parameters (identity, named, relief, the expression a scan may have), each in units of its
prior standard deviation; ``q`` samples of the scan's outer surface in the canonical frame; ``x`` the nearest point of
the generated surface, on a triangle of the warped template, with normal ``n``. Gauss-Newton on
``sum w (n . (q - x(theta)))^2 / s^2 + sum |nine landmarks|^2 / s_l^2 + |theta|^2`` within the parameters' bounds; ``w``
are Huber weights. The generated head stands in the canonical frame by its own landmarks, as `build_head` leaves it; the
fit has no pose or scale of its own.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from data_synth.head.bells import Bells, sum_bells
from data_synth.head.expression import expression_mm
from data_synth.head.identity import landmark_coefficients, landmark_field, landmark_maps, make_warp, warp_points
from data_synth.head.named import NAMES, SCALED, named_bells, scaled_displacement_mm
from data_synth.head.params import HeadParams, sample_params
from data_synth.head.population import IDENTITY_SIZE, load_population
from data_synth.head.relief import relief_basis, windows
from data_synth.head.relief_params import REGIONS, RELIEF_NAMES, RELIEF_SIZE
from data_synth.head.shape_params import AMOUNTS, SIGMA_NAMES, NamedShape, bounds, neutral
from data_synth.head.surface import bald_surface
from data_synth.head.traits import trait_loadings
from data_synth.scan_landmarks import check_on_surface
from sira_assets.errors import InputError
from sira_assets.mesh.triangle_mesh import TriangleMesh, face_cross_products
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M, IBUG68_OF_CANONICAL, canonical_from_landmarks, similarity

FACE_RADIUS_M = 0.095
CANONICAL_ORDER = tuple(IBUG68_OF_CANONICAL)
# A scan may smile or raise its brows a little; the traits are left out: they are directions over the others.
FITTED_EXPRESSION = ("smile", "brow_raise")
NAMED = (*SIGMA_NAMES, *AMOUNTS, *FITTED_EXPRESSION)
PARAMETER_NAMES = (*(f"identity_{k}" for k in range(IDENTITY_SIZE)), *NAMED, *RELIEF_NAMES)
# Amounts and expression lie about evenly in [0, 1]: their root mean square.
AMOUNT_SIGMA = 0.55


@dataclass(frozen=True)
class FitConfig:
    """Options of `fit_scan`.

    Attributes
    ----------
    points : samples of the scan used
    sigma_mm : standard deviation of one independent residual
    independent : how many of the residuals count as independent: neighbours share their error
    landmark_sigma_mm : of the nine landmarks
    huber_mm, reject_mm : residuals count less beyond the first and not at all beyond the second
    reach_m : the part of the template within this distance of the nose tip takes part
    """

    points: int = 4000
    iterations: int = 8
    sigma_mm: float = 0.5
    independent: int = 1200
    landmark_sigma_mm: float = 1.5
    huber_mm: float = 1.5
    reject_mm: float = 10.0
    reach_m: float = 0.14


@dataclass(frozen=True)
class Fit:
    """Fitted parameters, theta (P,) in prior standard deviations, and the surface in the canonical frame (metres)."""

    params: HeadParams
    theta: np.ndarray
    mesh: TriangleMesh
    landmarks_m: np.ndarray


@dataclass(frozen=True)
class Head:
    """A scan in the canonical frame: mesh and nine landmarks (metres), and millimetres of the scan per metre there."""

    name: str
    mesh: TriangleMesh
    nine: np.ndarray
    mm: float

    @property
    def nose_tip(self) -> np.ndarray:
        """(3,)"""
        return self.nine[CANONICAL_ORDER.index("nose_tip")]


def read_head(folder: Path) -> Head:
    """Read a folder's mesh.ply and landmarks.json and bring both to the canonical frame.

    Raises
    ------
    InputError : no mesh, not all of the nine landmarks, or landmarks off the mesh.
    """
    from sira_assets.measure.truth import read_mesh
    from sira_assets.scene.landmarks import read_landmarks

    mesh = read_mesh(folder / "mesh.ply")
    landmarks = read_landmarks(folder / "landmarks.json").points_world
    missing = [name for name in CANONICAL_ORDER if name not in landmarks]
    if missing:
        raise InputError(
            expected=f"the canonical nine landmarks in {folder / 'landmarks.json'}",
            received="none of " + ", ".join(missing),
            remedy="complete landmarks_m",
        )
    matrix = canonical_from_landmarks(landmarks)
    to = lambda x: x @ matrix[:3, :3].T + matrix[:3, 3]  # noqa: E731
    nine = to(np.stack([landmarks[name] for name in CANONICAL_ORDER]))
    mm = 1e3 / float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    placed = TriangleMesh(to(mesh.vertices), mesh.faces)
    check_on_surface(nine, placed, folder / "mesh.ply")
    return Head(folder.resolve().name, placed, nine, mm)


def scales() -> np.ndarray:
    """What one unit of theta is in each parameter's own unit (P,)."""
    return np.array([1.0 if name not in (*AMOUNTS, *FITTED_EXPRESSION) else AMOUNT_SIGMA for name in PARAMETER_NAMES])


def limits() -> np.ndarray:
    """Lowest and highest theta (P, 2): three standard deviations, and the parameters' own range."""
    own = np.array([bounds(name) if name in NAMED else (-3.0, 3.0) for name in PARAMETER_NAMES]) / scales()[:, None]
    return np.clip(own, -3.0, 3.0)


def head_params(theta: np.ndarray) -> HeadParams:
    """The head of theta, bald and bare-shouldered."""
    value = theta * scales()
    named = dict(zip(NAMED, value[IDENTITY_SIZE:-RELIEF_SIZE].tolist(), strict=True))
    return HeadParams(0, value[:IDENTITY_SIZE], NamedShape(**named), relief=value[-RELIEF_SIZE:])


def place(params: HeadParams, x_template_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Template points (N, 3) and the 68 landmarks on the head, canonical frame, metres."""
    template_landmarks = bald_surface().landmarks_m
    warp = make_warp(params, template_landmarks)
    both = warp_points(warp, np.vstack([template_landmarks, x_template_m]))
    nine = both[list(IBUG68_OF_CANONICAL.values())]
    matrix = similarity(nine, np.array([CANONICAL_LANDMARKS_M[name] for name in IBUG68_OF_CANONICAL]))
    both = both @ matrix[:3, :3].T + matrix[:3, 3]
    return both[68:], both[:68]


def nearest_template(vertices: np.ndarray, faces: np.ndarray, template: np.ndarray, q: np.ndarray):
    """For points (N, 3): nearest surface points' template positions (N, 3), unit normals (N, 3), distances (N,)."""
    from sira_assets.measure.surface import Surface

    found = Surface(TriangleMesh(vertices, faces, np.zeros_like(vertices))).nearest(q)
    face = faces[found.face]
    a, b, c = (vertices[face[:, k]] for k in range(3))
    p = found.points
    area = [np.linalg.norm(np.cross(u - p, v - p), axis=1) for u, v in ((b, c), (c, a), (a, b))]
    weight = np.stack(area, 1) / np.maximum(sum(area), 1e-30)[:, None]
    normal = face_cross_products(vertices, face)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    return (template[face] * weight[..., None]).sum(1), normal, found.distance


def fit_scan(points_m: np.ndarray, nine_m: np.ndarray, config: FitConfig = FitConfig()) -> Fit:
    """Fit to surface samples (N, 3) and the canonical nine (9, 3), canonical frame, metres."""
    base = bald_surface()
    centre = np.array(CANONICAL_LANDMARKS_M["nose_tip"])
    near = np.linalg.norm(base.vertices_m - centre, axis=1) < config.reach_m
    faces = base.faces[near[base.faces].all(1)]
    used, index = np.unique(faces, return_inverse=True)
    faces, template = index.reshape(-1, 3), base.vertices_m[used]
    pick = np.linspace(0, len(points_m) - 1, min(config.points, len(points_m))).astype(int)
    q = points_m[pick]
    nine = list(IBUG68_OF_CANONICAL.values())
    theta, bound = np.zeros(len(PARAMETER_NAMES)), limits()
    for _ in range(config.iterations):
        vertices, _ = place(head_params(theta), template)
        at, normal, distance = nearest_template(vertices, faces, template, q)
        x, landmarks = place(head_params(theta), at)
        r = ((q - x) * normal).sum(1)
        weight = 1.0 / np.maximum(1.0, np.abs(r) / (1e-3 * config.huber_mm)) * (distance < 1e-3 * config.reject_mm)
        weight *= config.independent / len(q) / (1e-3 * config.sigma_mm) ** 2
        j_all, j_landmarks = jacobian(theta, at)
        j = np.einsum("nk,nkp->np", normal, j_all)
        j_nine = j_landmarks[nine].reshape(27, -1)
        certain = (1e-3 * config.landmark_sigma_mm) ** -2
        hessian = (j * weight[:, None]).T @ j + certain * j_nine.T @ j_nine + np.eye(len(theta))
        # the value that the linearised problem has at theta + step, as a quadratic in the new theta
        target = (j * weight[:, None]).T @ (r + j @ theta)
        target += certain * j_nine.T @ ((nine_m - landmarks[nine]).ravel() + j_nine @ theta)
        theta = bounded_minimum(hessian, target, bound)
    vertices, landmarks = place(head_params(theta), base.vertices_m)
    return Fit(head_params(theta), theta, TriangleMesh(vertices, base.faces), landmarks)


def displacement_basis(x_m: np.ndarray) -> np.ndarray:
    """Displacement of template points (N, 3) by one unit of each parameter in turn: (N, 3, P), metres.

    The warp is linear in identity, named parameters and relief; the expression's columns are zero.
    """
    landmarks = bald_surface().landmarks_m
    at = np.vstack([landmarks, x_m])
    count, first = len(NAMES), IDENTITY_SIZE
    fields = np.zeros((len(at), 3, len(PARAMETER_NAMES)))
    bells, owner = named_bells()
    columns = np.zeros((len(owner), 3, count))
    columns[np.arange(len(owner)), :, owner] = bells.vector
    own = sum_bells(replace(bells, vector=columns.reshape(len(owner), -1)), at * 1e3).reshape(-1, 3, count)
    for name in SCALED:
        own[..., NAMES.index(name)] += scaled_displacement_mm(at * 1e3, np.eye(count)[NAMES.index(name)])
    fields[..., first : first + count] = 1e-3 * own * np.sqrt(1.0 - (trait_loadings() ** 2).sum(1))
    r = relief_basis()
    columns = r.normal[:, :, None] * r.heights_mm[:, None]
    bells = Bells(r.sites_mm, np.repeat(r.width_mm[:, None], 3, 1), columns.reshape(len(columns), -1))
    fields[..., -RELIEF_SIZE:] = 1e-3 * sum_bells(bells, at * 1e3).reshape(-1, 3, RELIEF_SIZE)
    share, named = landmark_maps()
    modes = load_population().modes_m
    want = np.zeros((68, 3, len(PARAMETER_NAMES)))
    want[..., :first] = np.einsum("kij,kp->ijp", modes, share)
    want[..., first : first + len(SIGMA_NAMES)] = np.einsum("kij,kp->ijp", modes, named[:, : len(SIGMA_NAMES)])
    fields += landmark_field(landmarks, at, (want - fields[:68]).reshape(68, -1)).reshape(fields.shape)
    return fields[68:] * scales()


def jacobian(theta: np.ndarray, x_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives by theta of `place`: points (N, 3, P) and landmarks (68, 3, P).

    The change of the similarity that normalises the head is left out: landmark coefficients are of normalised heads, so
    it is of second order.
    """
    params, both = head_params(theta), np.vstack([bald_surface().landmarks_m, x_m])
    shown = both + 1e-3 * expression_mm(both * 1e3, params.shape)
    warped = warp_points(make_warp(params, bald_surface().landmarks_m), both)
    placed = np.vstack(place(params, x_m)[::-1])
    turn = similarity(warped, placed)[:3, :3]
    out = np.einsum("ab,nbp->nap", turn, displacement_basis(shown))
    for name in FITTED_EXPRESSION:
        k, step = PARAMETER_NAMES.index(name), 0.05
        other = theta.copy()
        # inward at a bound
        other[k] += step if theta[k] + step <= limits()[k, 1] else -step
        out[..., k] = (np.vstack(place(head_params(other), x_m)[::-1]) - placed) / (other[k] - theta[k])
    return out[68:], out[:68]


def bounded_minimum(hessian: np.ndarray, target: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """The x within bounds (P, 2) that minimises ``x'Hx/2 - target.x``; H positive definite.

    Coordinate descent from the clipped unbounded minimum: it converges for a strictly convex quadratic on a box
    (Luo and Tseng 1992, DOI 10.1007/BF00939948).
    """
    x = np.clip(np.linalg.solve(hessian, target), bound[:, 0], bound[:, 1])
    gradient = hessian @ x - target
    for _ in range(200):
        largest = 0.0
        for k in range(len(x)):
            new = np.clip(x[k] - gradient[k] / hessian[k, k], bound[k, 0], bound[k, 1])
            change = new - x[k]
            if change != 0.0:
                gradient += hessian[:, k] * change
                x[k] = new
                largest = max(largest, abs(change))
        if largest < 1e-6:
            break
    return x


def head_mesh(params: HeadParams) -> TriangleMesh:
    """The bald head's mesh in the canonical frame."""
    base = bald_surface()
    vertices, _ = place(params, base.vertices_m)
    return TriangleMesh(vertices, base.faces)


def template_normals() -> np.ndarray:
    """(V, 3) unit normals of the template's vertices."""
    base = bald_surface()
    return TriangleMesh(base.vertices_m, base.faces).normals


def between_landmarks(params: HeadParams) -> np.ndarray:
    """What a head's surface has beyond its landmarks' smooth warp: (V,) mm along the template's normal.

    The same landmarks are made once by the head itself and once by the identity alone; expression is left out.
    """
    base = bald_surface()
    params = replace(params, shape=neutral(params.shape))
    share, _ = landmark_maps()
    alone = HeadParams(0, np.linalg.solve(share, landmark_coefficients(params)))
    x, smooth = (warp_points(make_warp(p, base.landmarks_m), base.vertices_m) for p in (params, alone))
    return 1e3 * ((x - smooth) * template_normals()).sum(1)


def random_between(count: int, seed: int = 0) -> list[np.ndarray]:
    """`between_landmarks` of random heads."""
    rng = np.random.default_rng(seed)
    return [between_landmarks(sample_params(rng)) for _ in range(count)]


def region_table(random: list[np.ndarray], heads: list[np.ndarray]) -> dict[str, list[float]]:
    """Root mean square (mm) by region of the face, of random heads together and of each head; and odd over even."""
    base = bald_surface()
    x = base.vertices_m * 1e3
    face = np.linalg.norm(base.vertices_m - CANONICAL_LANDMARKS_M["nose_tip"], axis=1) < FACE_RADIUS_M
    share = windows(x) ** 2 * face[:, None]
    out = {}
    for k, region in enumerate(REGIONS):
        # a region with a fingertip's share of the face says nothing
        if share[:, k].sum() > 0.01 * face.sum():
            weight = share[:, k] / share[:, k].sum()
            out[region.name] = [_rms(random, weight)] + [_rms([h], weight) for h in heads]
    weight = face / face.sum()
    out["face"] = [_rms(random, weight)] + [_rms([h], weight) for h in heads]
    # the template is symmetric, its mesh to a fraction of a cell: the vertex nearest to the mirror image
    from scipy.spatial import cKDTree

    other = cKDTree(x).query(x * (-1.0, 1.0, 1.0))[1]
    ratio = [[_rms([h - h[other]], weight) / _rms([h + h[other]], weight) for h in group] for group in (random, heads)]
    out["odd/even"] = [float(np.sqrt(np.mean(np.square(ratio[0]))))] + ratio[1]
    return out


def _rms(fields: list[np.ndarray], weight: np.ndarray) -> float:
    return float(np.sqrt(np.mean([weight @ f**2 for f in fields])))

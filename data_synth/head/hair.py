"""Hair as geometry: a layer over the scalp and hanging volumes, united with the head's surface.

Notation (millimetres, template frame): ``D`` distance from the earless scalp, ``T`` thickness of the hair there,
``h = D - T`` the hair's field (negative inside), ``theta`` azimuth about the vertical axis through the skull from the
face (0) to the nape (180 degrees). Relief follows the strands: waves of integer frequency around the crown that run
down along it, so that they close on themselves.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from data_synth.head.grid import evaluate_template, graded_axis
from data_synth.head.params import HeadParams
from data_synth.head.template import Primitives, Template, load_template

EAR_NAMES = (
    "ear",
    "helix",
    "tragus",
    "concha",
    "cymba",
    "scapha",
    "antihelix",
    "crus",
    "antitragus",
    "intertragic",
)

# azimuth from the face (degrees) and height of an adult's hairline over it (mm): forehead, temple, sideburn, ear, nape
HAIRLINE_AZIMUTH = np.array([0, 18, 32, 42, 50, 58, 66, 73, 80, 86, 100, 112, 130, 150, 180.0])
HAIRLINE_HEIGHT = np.array([74, 76, 70, 52, 34, 18, 0, -16, -14, 4, 4, -22, -58, -74, -78.0])


@dataclass(frozen=True)
class HairStyle:
    """Shape of a style, millimetres.

    ``top``, ``side``, ``back``: thickness; ``relief`` and ``waves``: height and number of clumps around the crown;
    ``curl``: height of isotropic curls; ``recede``: how far the forehead's hairline climbs; ``part``: depth of a side
    parting; ``volumes``: ellipsoids (x, y, z, rx, ry, rz), mirrored; ``front``: how far forward hanging hair may come;
    ``edge``: softness of the hairline.
    """

    top: float = 0.0
    side: float = 0.0
    back: float = 0.0
    relief: float = 0.0
    waves: float = 40.0
    curl: float = 0.0
    recede: float = 0.0
    thin_crown: float = 0.0
    part: float = 0.0
    volumes: tuple[tuple[float, ...], ...] = ()
    front: float = -44.0
    edge: float = 9.0


STYLES = {
    "bald": HairStyle(),
    "buzz": HairStyle(top=2.2, side=1.6, back=1.8, relief=0.25, waves=90, edge=5),
    "short": HairStyle(top=13, side=5, back=7, relief=1.6, waves=46),
    "side_part": HairStyle(top=17, side=6, back=8, relief=1.5, waves=38, part=7),
    "receding": HairStyle(top=8, side=6, back=7, relief=1.0, waves=50, recede=24, thin_crown=0.8),
    "curly": HairStyle(top=30, side=20, back=24, relief=0.5, waves=20, curl=3.2, edge=12),
    "bob": HairStyle(
        top=15,
        side=15,
        back=17,
        relief=1.6,
        waves=48,
        part=5,
        volumes=((64, -36, -78, 32, 70, 46), (0, -34, -112, 78, 70, 60)),
    ),
    "long": HairStyle(
        top=13,
        side=12,
        back=15,
        relief=1.8,
        waves=52,
        part=4,
        volumes=((64, -62, -76, 31, 116, 40), (0, -80, -124, 80, 122, 50)),
    ),
    "bun": HairStyle(top=5, side=4, back=5, relief=0.7, waves=64, volumes=((0, 72, -178, 31, 29, 28),), front=300.0),
}


def _without_ears(t: Template) -> Template:
    def drop(p: Primitives) -> Primitives:
        keep = [i for i, n in enumerate(p.name) if not n.startswith(EAR_NAMES)]
        return Primitives(
            tuple(p.name[i] for i in keep),
            p.paired[keep],
            p.centre_mm[keep],
            p.log_size[keep],
            p.rotation[keep],
            p.weight[keep],
        )

    return Template(drop(t.masses), drop(t.strokes), t.eyeball, t.lids, t.floor_mm)


@dataclass(frozen=True)
class ScalpDistance:
    """Distance from the earless head (mm) on a coarse regular grid: axes in mm and values ``d[i, j, k]``."""

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    d: np.ndarray


@lru_cache(maxsize=1)
def scalp_distance(step_mm: float = 5.0) -> ScalpDistance:
    """Computed once per process; linear interpolation of it errs by about step^2 / (8 * 70 mm) on the skull."""
    import open3d as o3d
    from skimage.measure import marching_cubes

    half = graded_axis((0.0, 200.0), (step_mm,))
    x = np.concatenate([-half[:0:-1], half])
    y, z = graded_axis((-235.0, 165.0), (step_mm,)), graded_axis((-235.0, 70.0), (step_mm,))
    nodes = np.stack(np.meshgrid(x, y, z, indexing="ij"), -1)
    right = len(half) - 1
    bare = _without_ears(load_template())
    f_half = evaluate_template(nodes[right:].reshape(-1, 3) * 1e-3, bare).reshape(nodes[right:].shape[:3]) * 1e3
    f = np.concatenate([f_half[:0:-1], f_half])
    v, tri, _, _ = marching_cubes(np.where(np.abs(f) < 1e-4, 1e-4, f), 0.0)
    v = v * step_mm + [x[0], y[0], z[0]]
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor(v.astype(np.float32)), o3d.core.Tensor(tri.astype(np.uint32)))
    d_half = scene.compute_distance(o3d.core.Tensor(nodes[right:].astype(np.float32))).numpy()
    d = np.concatenate([d_half[:0:-1], d_half])
    return ScalpDistance(x, y, z, (np.sign(f) * d).astype(np.float32))


def interpolate_scalp(x_mm: np.ndarray) -> np.ndarray:
    """``D`` at points (N, 3) in mm."""
    from scipy.ndimage import map_coordinates

    s = scalp_distance()
    step = s.x[1] - s.x[0]
    index = [(x_mm[:, 0] - s.x[0]) / step, (x_mm[:, 1] - s.y[0]) / step, (x_mm[:, 2] - s.z[0]) / step]
    return map_coordinates(s.d, index, order=1, mode="nearest").astype(np.float64)


def smoothstep(x: np.ndarray, low: float, high: float) -> np.ndarray:
    """0 below ``low``, 1 above ``high``, a cubic between."""
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3 - 2 * t)


def strand_waves(x_mm: np.ndarray, waves: float, seed: int, count: int = 14, twist: float = 0.6) -> np.ndarray:
    """Waves of unit RMS, constant along strands that run down from the crown; (N,)."""
    rng = np.random.default_rng([seed, 17])
    x, y, z = x_mm[:, 0], x_mm[:, 1], x_mm[:, 2] + 96.0
    phi = np.arctan2(x, z)
    level = y / 75.0
    out = np.zeros(len(x_mm))
    for _ in range(count):
        k = int(rng.integers(max(int(waves * 0.35), 3), int(waves * 1.4)))
        slope, phase = rng.normal() * 2.2, rng.uniform(0, 2 * np.pi)
        out += np.cos(k * (phi + twist * 0.15 * np.sin(2.0 * level + phase)) + slope * level + phase)
    # strands meet at the crown, where waves would be infinitely fine
    return out * np.sqrt(2.0 / count) * smoothstep(np.hypot(x, z), 12.0, 40.0)


def curls(x_mm: np.ndarray, seed: int, count: int = 18, wavelength_mm: float = 17.0) -> np.ndarray:
    """Isotropic noise of unit RMS made of plane waves; (N,)."""
    rng = np.random.default_rng([seed, 29])
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    wave = 2 * np.pi / (wavelength_mm * rng.uniform(0.6, 1.8, (count, 1)))
    phase = rng.uniform(0, 2 * np.pi, count)
    return np.cos(x_mm @ (direction * wave).T + phase).sum(1) * np.sqrt(2.0 / count)


def hairline_height(x_mm: np.ndarray, recede_mm: float = 0.0) -> np.ndarray:
    """How far a point lies above the hairline (mm, measured along y); positive where hair grows. (N, 3) -> (N,)."""
    from scipy.interpolate import PchipInterpolator

    theta = np.degrees(np.arctan2(np.abs(x_mm[:, 0]), x_mm[:, 2] + 80.0))
    bald_front = np.exp(-0.5 * ((HAIRLINE_AZIMUTH - 30.0) / 14.0) ** 2) * 1.3 + (HAIRLINE_AZIMUTH < 10) * 0.7
    line = PchipInterpolator(HAIRLINE_AZIMUTH, HAIRLINE_HEIGHT + recede_mm * bald_front)(theta)
    # near the crown the azimuth has no meaning: hair grows there whatever the front does
    return np.maximum(x_mm[:, 1] - line, 4.0 * (x_mm[:, 1] - 93.0))


def _layer_thickness(x_mm: np.ndarray, style: HairStyle, seed: int) -> np.ndarray:
    """Thickness of the layer over the scalp (mm) where hair is fully grown."""
    y, z = x_mm[:, 1], x_mm[:, 2]
    upper = smoothstep(y, 20.0, 85.0)
    rear = smoothstep(-z, 90.0, 140.0)
    thick = (style.side * (1 - rear) + style.back * rear) * (1 - upper) + style.top * upper
    if style.thin_crown:
        crown = np.exp(-0.5 * (((x_mm - [0, 95, -95]) / [36, 40, 44]) ** 2).sum(-1))
        thick = thick * (1 - style.thin_crown * crown)
    if style.part:
        side = 26.0 if seed % 2 else -26.0
        line = np.exp(-0.5 * ((x_mm[:, 0] - side) / 4.0) ** 2) * smoothstep(z, -120.0, -80.0) * upper
        thick = thick - np.minimum(style.part, 0.8 * thick) * line
        thick = thick + 0.25 * style.top * upper * np.exp(-0.5 * ((x_mm[:, 0] + 0.6 * side) / 30.0) ** 2)
    return thick


def _hanging_mm(x_mm: np.ndarray, style: HairStyle, size: float) -> np.ndarray:
    """Union of the hanging volumes (mm), cut off in front so that the face stays free."""
    x, y, z = np.ascontiguousarray(x_mm.T)
    out = np.full(len(x_mm), np.inf)
    for cx, cy, cz, rx, ry, rz in style.volumes:
        length = size if ry > 50 else 1.0
        # longer hair hangs lower, its top stays
        squares = [
            ((a - c) / r) ** 2
            for a, c, r in ((np.abs(x), cx, rx), (y, cy + 40 * (1 - length), ry * length), (z, cz, rz))
        ]
        k0 = np.sqrt(squares[0] + squares[1] + squares[2]) + 1e-9
        k1 = np.sqrt(squares[0] / rx**2 + squares[1] / (ry * length) ** 2 + squares[2] / rz**2) + 1e-9
        volume = k0 * (k0 - 1) / k1
        gap = np.clip(10.0 - np.abs(out - volume), 0.0, None)
        out = np.minimum(out, volume) - gap * gap / 40.0
    return np.maximum(out, z - (style.front + 150.0 * smoothstep(y, 20.0, 70.0)))


def hair_field_mm(x_mm: np.ndarray, params: HeadParams, d_mm: np.ndarray | None = None) -> np.ndarray:
    """The hair's field ``h`` (mm, negative inside) at template points (N, 3) in mm; +inf where there is none.

    ``d_mm``: the scalp's distance there, if it is at hand. Relief is added within 9 mm of the hair's surface.
    """
    style = STYLES[params.hair_style]
    if style.top == 0.0:
        return np.full(len(x_mm), np.inf)
    size = params.hair_length
    d = interpolate_scalp(x_mm) if d_mm is None else d_mm.astype(np.float64)
    reach = 1.3 * size * max(style.top, style.side, style.back) + 10.0
    # away from the scalp only the sign and a lower bound matter; nothing grows below the neck
    h = np.where(x_mm[:, 1] > -110.0, d - reach + 4.0, d + 3.0)
    near = np.flatnonzero((np.abs(d) < reach) & (x_mm[:, 1] > -110.0))
    x = x_mm[near]
    grown = np.zeros(len(x_mm))
    above = hairline_height(x, style.recede) + 1.5 * curls(x, params.seed + 5, 8, 14.0)
    thick = size * _layer_thickness(x, style, params.seed)
    # in front the layer rises slowly from the forehead; elsewhere it ends in a cut
    front = smoothstep(x[:, 2], -75.0, -30.0)
    grown[near] = smoothstep(above / (style.edge + (0.4 + 1.1 * front) * thick), 0.0, 1.0)
    h[near] = d[near] - ((thick + 3.0) * grown[near] - 3.0)
    waves_of = np.flatnonzero((np.abs(h) < 9.0) & (grown > 0))
    if style.relief:
        ripple = style.relief * np.clip(strand_waves(x_mm[waves_of], style.waves, params.seed), -2.2, 2.2)
        h[waves_of] -= ripple * grown[waves_of]
    if style.curl:
        ripple = style.curl * np.clip(curls(x_mm[waves_of], params.seed), -2.2, 2.2)
        h[waves_of] -= ripple * grown[waves_of]
    if style.volumes:
        volume = _hanging_mm(x_mm, style, size)
        own = np.flatnonzero(np.abs(volume) < 9.0)
        ripple = style.relief * np.clip(strand_waves(x_mm[own], style.waves, params.seed), -2.2, 2.2)
        volume[own] -= ripple
        gap = np.clip(8.0 - np.abs(h - volume), 0.0, None)
        h = np.minimum(h, volume) - gap * gap / 32.0
    return h

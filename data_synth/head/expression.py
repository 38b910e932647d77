"""Expression: a displacement of the template before the identity warp, so that it follows the template's own features.

Notation: template points in millimetres; folded means ``|x|``, as the template is symmetric. Lids close by
``y' = y + d(x, y)`` and ``z' = z + k(x, y) (h(x, y') - h(x, y))`` with ``h`` the eyeball's front and ``k`` 1 at the
lids' edges: what lies on the eyeball slides over it. Where the window in depth is 1 the determinant of that map is
``1 + dd/dy``, which ``d`` keeps at or above ``1 - eyes_closed (1 - SLIT)``; the window begins behind the lids.
"""

from __future__ import annotations

import numpy as np

from data_synth.head.named import smooth_step
from data_synth.head.shape_params import NamedShape
from data_synth.head.template import load_template

# What is left of the opening between closed lids, as a part of it: half a millimetre, the line of the lashes.
SLIT = 0.06
# Where the lids meet, from the lower margin, as a part of the opening: the upper lid does most of the way.
MEETING = 0.15


def _bump(x: np.ndarray, centre: tuple[float, float, float], width: tuple[float, float, float]) -> np.ndarray:
    return np.exp(-0.5 * (((x - centre) / width) ** 2).sum(-1))


def expression_mm(x_mm: np.ndarray, s: NamedShape) -> np.ndarray:
    """Displacement (N, 3) of the expression at template points (N, 3), millimetres."""
    u = np.zeros_like(x_mm)
    x, y, z = x_mm.T
    folded = np.stack([np.abs(x), y, z], -1)
    side = np.tanh(x / 8.0)
    if s.smile:
        corner = s.smile * _bump(folded, (26, -70, 14), (9, 9, 14))
        cheek = s.smile * _bump(folded, (36, -42, 8), (15, 13, 18))
        lower = s.smile * _bump(folded, (30, -13, 8), (11, 4.5, 10))
        u[:, 0] += side * (4.0 * corner + 1.0 * cheek)
        u[:, 1] += 3.3 * corner + 2.2 * cheek + 0.5 * lower
        u[:, 2] += -2.4 * corner + 1.9 * cheek + 0.4 * lower
    if s.mouth_open:
        # the jaw drops about the ears; the split is where the lips meet, and closes toward the corners
        between = smooth_step(-(y + 70.0 - 0.02 * folded[:, 0]), -0.6, 2.6)
        lips = between * np.exp(-((folded[:, 0] / 24.0) ** 4)) * _bump(x_mm, (0, -80, 18), (60, 20, 24))
        jaw = smooth_step(-y, 84.0, 16.0) * (1 - smooth_step(-y, 128.0, 26.0)) * smooth_step(z, -10.0, 30.0)
        u[:, 1] += -3.5 * s.mouth_open * np.maximum(lips, jaw * np.exp(-((folded[:, 0] / 55.0) ** 4)))
    if s.brow_raise:
        u[:, 1] += 3.0 * s.brow_raise * _bump(folded, (28, 25, 10), (24, 11, 22))
    if s.eyes_closed:
        near = (np.abs(folded[:, 0] - 31.0) < 30.0) & (np.abs(y) < 30.0) & (z > -20.0)
        u[near] += s.eyes_closed * _closing_mm(folded[near])
    return u


def _closing_mm(folded: np.ndarray) -> np.ndarray:
    t = load_template()
    e = t.lids.double().numpy()
    x, y, z = folded.T
    a = (2.0 * x - (e[0] + e[3])) / (e[3] - e[0])
    arch = np.clip(1.0 - a * a, 0.0, None)
    line = e[1] + (e[4] - e[1]) * 0.5 * (a + 1.0)
    upper, lower = line + e[6] * arch * (1.0 + e[7] * a), line - e[8] * arch * (1.0 + e[9] * a)
    opening = np.maximum(upper - lower, 0.0)
    meet = lower + MEETING * opening
    up, down = upper - meet, meet - lower
    # inside the opening compress towards the meeting line; outside fade over the lid
    d = -(1.0 - SLIT) * np.clip(y - meet, -down, up)
    d *= 1.0 - smooth_step(y - upper, 7.0, 7.0)
    d *= 1.0 - smooth_step(lower - y, 4.0, 4.0)
    depth = smooth_step(z, -4.0, 6.0)
    d = d * depth
    # the lid's edge slides on the eyeball; the fold above it is thick already and only follows
    forward = (_eye_front(t, x, y + d) - _eye_front(t, x, y)) * (1.0 - smooth_step(y - upper, 4.5, 4.5))
    forward = forward * (1.0 - smooth_step(lower - y, 2.0, 2.0))
    return np.stack([np.zeros_like(d), d, forward], 1)


def _eye_front(t, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height z (mm) of the eyeball's front at folded (x, y), levelling out before its outline."""
    e = t.eyeball.double().numpy()
    radius = np.exp(e[3:])
    q = 1.0 - ((x - e[0]) / radius[0]) ** 2 - ((y - e[1]) / radius[1]) ** 2
    # a smooth maximum of q and 0.1
    level = 0.5 * (q + 0.1 + np.sqrt((q - 0.1) ** 2 + 0.05**2))
    return e[2] + radius[2] * np.sqrt(level)

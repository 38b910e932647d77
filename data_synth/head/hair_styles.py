"""Hair styles and the hairline.

Notation: template frame, millimetres. ``theta`` is the azimuth about the vertical axis through the skull from the face
(0) to the nape (180 degrees).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_synth.head.cover_params import Groom
from data_synth.head.hair_flow import Flow
from data_synth.head.noise import smoothstep

# azimuth from the face (degrees) and height of an adult's hairline over it (mm): forehead, temple, sideburn, ear, nape
HAIRLINE_AZIMUTH = np.array([0, 18, 32, 42, 50, 58, 66, 73, 80, 86, 100, 112, 130, 150, 180.0])
HAIRLINE_HEIGHT = np.array([72, 73, 68, 52, 36, 20, 2, -16, -15, 3, 4, -22, -58, -74, -78.0])


@dataclass(frozen=True)
class Fringe:
    """Locks over the forehead: height of their tips at the middle, its rise outwards (mm at 45 degrees), its slope
    (mm per mm towards the parting), thickness, and depth of the notches between locks."""

    tip_mm: float
    arch: float = -8.0
    slope: float = 0.0
    thick: float = 6.0
    notch: float = 7.0
    locks: float = 15.0


@dataclass(frozen=True)
class Curtain:
    """Hair that hangs: height of its end, widths (half, mm) at the ears, the jaw and the end, the same to the back."""

    end_mm: float
    half_mm: tuple[float, float, float]
    back_mm: tuple[float, float, float]
    front_mm: float = -34.0


@dataclass(frozen=True)
class HairStyle:
    """Shape of a style, millimetres.

    ``top``, ``side``, ``back``: thickness; ``quiff``: added at the front; ``relief`` and ``locks``: height and number
    of clumps around the head; ``curl``: height of isotropic curls and ``curl_mm`` their size; ``recede``: recession
    beyond the person's own; ``thin_crown``: 0 to 1; ``part``: depth of a parting; ``ball``: centre and radii of an
    ellipsoid that the layer is cut to; ``knots``: chains of balls (x, y, z, radius), later ones joined to earlier ones;
    ``edge``: softness of the hairline; ``sway_mm``: how far waves carry hanging hair; ``density``: 1 is opaque.
    """

    top: float = 0.0
    side: float = 0.0
    back: float = 0.0
    quiff: float = 0.0
    relief: float = 0.0
    locks: int = 30
    curl: float = 0.0
    curl_mm: float = 17.0
    recede: float = 0.0
    thin_crown: float = 0.0
    part: float = 0.0
    flow: Flow = Flow()
    fringe: Fringe | None = None
    curtain: Curtain | None = None
    ball: tuple[float, float, float, float, float, float] | None = None
    knots: tuple[tuple[float, float, float, float], ...] = ()
    edge: float = 8.0
    sway_mm: float = 3.5
    density: float = 1.0


SWEPT = Flow(pole=(0.0, 0.25, 0.97))
SIDEWAYS = Flow(pole=(0.0, 0.80, 0.45), side=0.75)
PARTED = Flow(pole=None)
TIED = Flow(pole=(0.0, 0.1, -1.0))

STYLES = {
    "bald": HairStyle(),
    "buzz": HairStyle(top=1.4, side=0.7, back=0.9, relief=0.0, locks=120, edge=7, density=0.8),
    "crop": HairStyle(
        top=8, side=2.2, back=3, relief=1.6, locks=40, edge=5, fringe=Fringe(58, arch=4, thick=4.5, notch=6, locks=10)
    ),
    "short": HairStyle(top=14, side=5, back=7, quiff=3, relief=2.4, locks=30, flow=Flow(pole=(0.0, 0.75, -0.66))),
    "side_part": HairStyle(top=15, side=5.5, back=7, quiff=4, relief=2.2, locks=26, part=6, flow=SIDEWAYS),
    "swept_back": HairStyle(top=14, side=5, back=10, quiff=8, relief=2.6, locks=34, flow=SWEPT, edge=4),
    "undercut": HairStyle(top=19, side=0.8, back=1.0, quiff=6, relief=2.8, locks=30, flow=SIDEWAYS, density=0.9),
    "receding": HairStyle(top=5, side=4.5, back=6, relief=1.2, locks=44, recede=22, thin_crown=0.9, density=0.9),
    "curly": HairStyle(top=28, side=15, back=22, relief=0.4, locks=20, curl=3.4, curl_mm=16, edge=9),
    "afro": HairStyle(
        top=62, side=48, back=52, relief=0.0, curl=1.3, curl_mm=8, edge=3, ball=(0, 34, -96, 112, 108, 118)
    ),
    "fringe": HairStyle(
        top=15, side=9, back=11, relief=2.2, locks=34, fringe=Fringe(36, arch=-14, slope=0.1, thick=7.5), edge=9
    ),
    "bob": HairStyle(
        top=14,
        side=13,
        back=16,
        relief=2.2,
        locks=40,
        flow=PARTED,
        part=3.5,
        fringe=Fringe(38, arch=-12, thick=8, notch=6, locks=12),
        curtain=Curtain(-98, (102, 93, 84), (104, 96, 78), front_mm=-26),
    ),
    "long": HairStyle(
        top=12,
        side=11,
        back=14,
        relief=2.2,
        locks=40,
        flow=PARTED,
        part=5,
        curtain=Curtain(-196, (101, 90, 88), (102, 92, 92)),
    ),
    "wavy": HairStyle(
        top=15,
        side=13,
        back=16,
        relief=2.8,
        locks=26,
        curl=0.8,
        curl_mm=26,
        sway_mm=9.0,
        flow=PARTED,
        part=4,
        curtain=Curtain(-170, (103, 97, 99), (104, 100, 98)),
    ),
    "ponytail": HairStyle(
        top=6,
        side=4.5,
        back=6,
        relief=1.4,
        locks=50,
        flow=TIED,
        edge=4,
        knots=(
            (0, 34, -150, 14),
            (0, 36, -178, 18),
            (0, 30, -196, 20),
            (0, 0, -203, 22),
            (0, -40, -202, 22),
            (0, -85, -196, 18),
            (0, -120, -190, 11),
        ),
    ),
    "bun": HairStyle(
        top=5.5,
        side=4.5,
        back=5.5,
        relief=1.2,
        locks=50,
        flow=Flow(pole=(0.0, 0.55, -0.85)),
        edge=4,
        knots=((0, 66, -140, 20), (0, 80, -164, 22), (0, 86, -172, 27)),
    ),
}


def hairline_height(x_mm: np.ndarray, groom: Groom, recede_mm: float = 0.0) -> np.ndarray:
    """How far a point lies above the hairline (mm, measured along y); positive where hair grows. (N, 3) -> (N,)."""
    from scipy.interpolate import PchipInterpolator

    a = HAIRLINE_AZIMUTH
    corner = np.exp(-0.5 * ((a - 31.0) / 11.0) ** 2)
    line = HAIRLINE_HEIGHT + groom.front_mm * np.clip(1.4 - a / 40.0, 0, 1) + groom.recede_mm * corner
    line = line + recede_mm * (1.3 * np.exp(-0.5 * ((a - 30.0) / 14.0) ** 2) + 0.7 * (a < 10))
    line = line - groom.sideburn_mm * np.exp(-0.5 * ((a - 73.0) / 5.0) ** 2)
    line = line - groom.nape_mm * np.clip((a - 125.0) / 30.0, 0, 1)
    theta = np.degrees(np.arctan2(np.abs(x_mm[:, 0]), x_mm[:, 2] + 80.0))
    height = PchipInterpolator(a, line)(theta) - groom.peak_mm * np.exp(-0.5 * (theta / 6.5) ** 2)
    # over the forehead's curve the way along the skin is longer than its rise
    over = 0.6 * np.clip(-8.0 - x_mm[:, 2], 0.0, 80.0) * smoothstep(x_mm[:, 1], 50.0, 85.0)
    # near the crown the azimuth has no meaning: hair grows there whatever the front does
    return np.maximum(x_mm[:, 1] - height + over, 2.5 * (x_mm[:, 1] - 97.0))

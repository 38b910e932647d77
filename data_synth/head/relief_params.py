"""Relief coefficients by name: what of a surface neither landmarks nor named parameters say, region by region.

``RELIEF_NAMES[k]`` is ``region_even_i`` (the same left and right) or ``region_odd_i`` (opposite); sigma units, -3 to 3.
Within a region lower numbers carry more variance. `data_synth.head.relief` makes displacements of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ReliefRegion:
    """A region of relief.

    Attributes
    ----------
    name : str
    centre_mm : tuple of float
        On the left side, or on the midline.
    width_mm : float
        Spread of the region's share of the surface.
    amplitude_mm : float
        Standard deviation along the surface normal far from landmarks; calibrated against the surface variation of
        real heads between their landmarks (``tools/fit_generator.py`` prints both).
    even, odd : int
        Number of coefficients.
    scale : float
        The kernel's lengths over those of the face: crania and necks vary more slowly.
    """

    name: str
    centre_mm: tuple[float, float, float]
    width_mm: float
    amplitude_mm: float
    even: int
    odd: int
    scale: float = 1.0


REGIONS = (
    ReliefRegion("forehead", (0.0, 62.0, 12.0), 26.0, 1.4, 8, 4),
    ReliefRegion("temple", (62.0, 22.0, -32.0), 20.0, 1.3, 5, 3),
    ReliefRegion("orbit", (32.0, 4.0, 8.0), 14.0, 2.0, 10, 4),
    ReliefRegion("nose", (0.0, -24.0, 34.0), 15.0, 1.8, 10, 4),
    ReliefRegion("cheek", (45.0, -38.0, 0.0), 18.0, 0.8, 10, 4),
    ReliefRegion("mouth", (0.0, -68.0, 26.0), 17.0, 1.7, 10, 4),
    ReliefRegion("chin", (0.0, -102.0, 14.0), 17.0, 1.5, 7, 3),
    ReliefRegion("jaw", (56.0, -78.0, -30.0), 19.0, 0.8, 6, 3),
    ReliefRegion("ear", (82.0, -28.0, -82.0), 16.0, 1.5, 8, 4),
    ReliefRegion("cranium", (0.0, 85.0, -90.0), 45.0, 2.0, 7, 3, 1.8),
    ReliefRegion("occiput", (0.0, -10.0, -165.0), 40.0, 2.0, 5, 3, 1.8),
    ReliefRegion("neck", (0.0, -145.0, -70.0), 40.0, 2.5, 6, 3, 1.8),
)
RELIEF_NAMES = tuple(
    f"{r.name}_{part}_{i}" for r in REGIONS for part, n in (("even", r.even), ("odd", r.odd)) for i in range(n)
)
RELIEF_SIZE = len(RELIEF_NAMES)


def sample_relief(rng: np.random.Generator) -> np.ndarray:
    """Draw relief coefficients (RELIEF_SIZE,) in sigma units."""
    return np.clip(rng.normal(size=RELIEF_SIZE), -3.0, 3.0)

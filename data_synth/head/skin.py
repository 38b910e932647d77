"""Skin colour from two pigments: melanin in the epidermis, haemoglobin in the dermis.

Notation, at three wavelengths standing for R, G, B (620, 540, 460 nm): ``mu_a``, ``mu_s'`` absorption and reduced
scattering (1/cm). The epidermis only absorbs, ``exp(-2 f_mel mu_mel d)``; the dermis is a semi-infinite diffuser whose
reflectance is the diffusion approximation. Absorption of melanosomes ``6.6e11 lambda^-3.33`` and of the baseline, and
scattering, from S. L. Jacques, "Optical properties of biological tissues: a review" (2013), DOI
10.1088/0031-9155/58/11/R37, and his "Skin optics" (OMLC 1998); haemoglobin from S. Prahl's tables (OMLC); reflectance
from Jensen et al., "A practical model for subsurface light transport" (2001), DOI 10.1145/383259.383319.
"""

from __future__ import annotations

import numpy as np

WAVELENGTH_NM = np.array([620.0, 540.0, 460.0])
MELANIN_PER_CM = 6.6e11 * WAVELENGTH_NM**-3.33
# Whole blood, 150 g/l haemoglobin, 75 % oxygenated, averaged over the bands of a camera (590-640, 510-575, 435-490 nm):
# its lines are far narrower than those, and single wavelengths on the 540 nm peak make light skin purple.
BLOOD_PER_CM = np.array([20.0, 205.0, 340.0])
# the last term is carotene and bilirubin, which absorb blue only; fitted so that fair skin has the blue of real albedos
BASELINE_PER_CM = 0.244 + 85.3 * np.exp(-(WAVELENGTH_NM - 154.0) / 66.2) + np.array([0.0, 0.0, 2.0])
SCATTERING_PER_CM = 68.7 * (WAVELENGTH_NM / 500.0) ** -1.161
EPIDERMIS_CM = 0.006
REFRACTIVE_INDEX = 1.4


def skin_albedo(melanin: np.ndarray, haemoglobin: np.ndarray) -> np.ndarray:
    """Diffuse albedo, linear Rec. 709.

    Parameters
    ----------
    melanin : (N,) array
        Volume fraction of melanosomes in the epidermis, about 0.013 to 0.43.
    haemoglobin : (N,) array
        Volume fraction of blood in the dermis, about 0.002 to 0.03.

    Returns
    -------
    (N, 3) array in (0, 1).
    """
    melanin, haemoglobin = np.asarray(melanin, float)[..., None], np.asarray(haemoglobin, float)[..., None]
    through = np.exp(-2.0 * melanin * MELANIN_PER_CM * EPIDERMIS_CM)
    absorption = haemoglobin * BLOOD_PER_CM + BASELINE_PER_CM
    albedo = SCATTERING_PER_CM / (SCATTERING_PER_CM + absorption)
    n = REFRACTIVE_INDEX
    inner = -1.440 / n**2 + 0.710 / n + 0.668 + 0.0636 * n
    boundary = (1 + inner) / (1 - inner)
    root = np.sqrt(3.0 * (1.0 - albedo))
    dermis = 0.5 * albedo * (1.0 + np.exp(-4.0 / 3.0 * boundary * root)) * np.exp(-root)
    return dermis * through

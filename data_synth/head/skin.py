"""Skin colour from its pigments: melanin over a dermis with blood, spectrally, then in linear Rec. 709.

Notation: wavelength ``lambda`` in nm; ``mu_a``, ``mu_s'`` absorption and reduced scattering in 1/cm. The epidermis only
absorbs, ``exp(-2 mu_a d)`` for the way in and out; the dermis is a semi-infinite diffuser whose reflectance is the
diffusion approximation (layered skin as in Donner and Jensen 2006, DOI 10.2312/EGWR/EGSR06/409-417, without their
exchange between layers). Melanosomes ``6.6e11 lambda^-3.33``, bloodless tissue ``0.244 + 85.3 exp(-(lambda - 154) /
66.2)`` and ``mu_s'`` from S. L. Jacques (1998, "Skin optics", OMLC; 2013, DOI 10.1088/0031-9155/58/11/R37). Molar
extinction of haemoglobin from S. Prahl's tables (OMLC), 150 g/l at 64,500 g/mol, lowered for blood being in vessels
(van Veen et al. 2002, DOI 10.1364/OL.27.000246). Reflectance from Jensen et al. 2001, DOI 10.1145/383259.383319.
Colour: CIE 1931 observer by Wyman et al. 2013 (JCGT 2(2), their multi-lobe fit), illuminant D65.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

WAVELENGTH_NM = np.arange(400.0, 701.0, 10.0)
# 1/cm per mol/l
OXYHAEMOGLOBIN = np.array(
    [266232, 466840, 480360, 246072, 102580, 62816, 44480, 33209, 26629, 23684, 20933, 20035, 24202, 39957, 53236,
     43016, 32613, 44496, 50104, 14401, 3200, 1506, 942, 610, 442, 368, 320, 294, 278, 276, 290.0]
)  # fmt: skip
DEOXYHAEMOGLOBIN = np.array(
    [223296, 303956, 407560, 528600, 413280, 103292, 23389, 16156, 14550, 16684, 20862, 25774, 31590, 39036, 46592,
     53412, 53788, 45072, 37020, 28324, 14677, 9444, 6510, 5149, 4345, 3750, 3227, 2795, 2408, 2052, 1794.0]
)  # fmt: skip
D65 = np.array(
    [82.75, 91.49, 93.43, 86.68, 104.86, 117.01, 117.81, 114.86, 115.92, 108.81, 109.35, 107.80, 104.79, 107.69,
     104.41, 104.05, 100.0, 96.33, 95.79, 88.69, 90.01, 89.60, 87.70, 83.29, 83.70, 80.03, 80.21, 82.28, 78.28, 69.72,
     71.61]
)  # fmt: skip
RGB_FROM_XYZ = np.array(
    [[3.2404542, -1.5371385, -0.4985314], [-0.9692660, 1.8760108, 0.0415560], [0.0556434, -0.2040259, 1.0572252]]
)
OXYGENATION = 0.75
VESSEL_RADIUS_CM = 0.0010  # 10 um: the mean of capillaries (3) and the upper plexus' venules (25), by volume
EPIDERMIS_CM = 0.006
REFRACTIVE_INDEX = 1.4
THIN_LAYER = 0.45  # fitted so that fair and very dark skin have the a* and b* that are measured on both
# carotene in dermis and fat, which absorbs blue only (band after Anderson and Parrish 1981, J. Invest. Dermatol. 77)
CAROTENE_PER_CM = 1.6
MELANIN_RANGE = (0.004, 0.55)
BLOOD_RANGE = (0.0005, 0.12)
TABLE = 96


def _blood_per_cm() -> np.ndarray:
    mu = 2.303 * (OXYGENATION * OXYHAEMOGLOBIN + (1 - OXYGENATION) * DEOXYHAEMOGLOBIN) * 150.0 / 64500.0
    # light does not reach the middle of a vessel that absorbs strongly
    depth = 2.0 * mu * VESSEL_RADIUS_CM
    return mu * (1.0 - np.exp(-depth)) / depth


def skin_reflectance(melanin: np.ndarray, haemoglobin: np.ndarray, scattering: float = 1.0) -> np.ndarray:
    """Spectral diffuse reflectance (..., 31) at `WAVELENGTH_NM` for pigment fractions of equal shape (...)."""
    w = WAVELENGTH_NM
    melanin, blood = np.asarray(melanin, float)[..., None], np.asarray(haemoglobin, float)[..., None]
    tissue = 0.244 + 85.3 * np.exp(-(w - 154.0) / 66.2)
    epidermis = melanin * 6.6e11 * w**-3.33 + (1 - melanin) * tissue
    carotene = CAROTENE_PER_CM * np.exp(-0.5 * ((w - 460.0) / 28.0) ** 2)
    absorption = blood * _blood_per_cm() + (1 - blood) * tissue + carotene
    turbid = 68.7 * (w / 500.0) ** -1.161
    albedo = scattering * turbid / (scattering * turbid + absorption)
    n = REFRACTIVE_INDEX
    inner = -1.440 / n**2 + 0.710 / n + 0.668 + 0.0636 * n
    boundary = (1 + inner) / (1 - inner)
    root = np.sqrt(3.0 * (1.0 - albedo))
    dermis = 0.5 * albedo * (1.0 + np.exp(-4.0 / 3.0 * boundary * root)) * np.exp(-root)
    # Kubelka and Munk's layer in diffuse light: K = 2 mu_a, S = 3/4 mu_s', of which a layer thinner than the mean free
    # path throws back a part
    k, s = 2.0 * epidermis, 0.75 * THIN_LAYER * turbid
    a = 1.0 + k / s
    b = np.sqrt(a * a - 1.0)
    t = np.tanh(b * s * EPIDERMIS_CM)
    layer = t / (a * t + b)
    through = b * np.sqrt(1.0 - t * t) / (a * t + b)
    return layer + through**2 * dermis / (1.0 - layer * dermis)


def _lobe(w: np.ndarray, mean: float, left: float, right: float) -> np.ndarray:
    return np.exp(-0.5 * ((w - mean) * np.where(w < mean, left, right)) ** 2)


@lru_cache(maxsize=1)
def _rgb_from_spectrum() -> np.ndarray:
    """(31, 3): linear Rec. 709 of a reflectance under D65; a white reflector is (1, 1, 1)."""
    w = WAVELENGTH_NM
    x = 0.362 * _lobe(w, 442.0, 0.0624, 0.0374) + 1.056 * _lobe(w, 599.8, 0.0264, 0.0323)
    x -= 0.065 * _lobe(w, 501.1, 0.0490, 0.0382)
    y = 0.821 * _lobe(w, 568.8, 0.0213, 0.0247) + 0.286 * _lobe(w, 530.9, 0.0613, 0.0322)
    z = 1.217 * _lobe(w, 437.0, 0.0845, 0.0278) + 0.681 * _lobe(w, 459.0, 0.0385, 0.0725)
    rgb = (np.stack([x, y, z], -1) * D65[:, None]) @ RGB_FROM_XYZ.T
    return rgb / rgb.sum(0)


def spectral_albedo(melanin: np.ndarray, haemoglobin: np.ndarray, scattering: float = 1.0) -> np.ndarray:
    """Linear Rec. 709 (..., 3) by summing the spectrum; what `skin_albedo` tabulates."""
    return skin_reflectance(melanin, haemoglobin, scattering) @ _rgb_from_spectrum()


@lru_cache(maxsize=8)
def _table(scattering: float) -> np.ndarray:
    """Logarithm of the albedo over the logarithms of both pigments, (TABLE, TABLE, 3)."""
    melanin = np.exp(np.linspace(*np.log(MELANIN_RANGE), TABLE))
    blood = np.exp(np.linspace(*np.log(BLOOD_RANGE), TABLE))
    return np.log(spectral_albedo(*np.meshgrid(melanin, blood, indexing="ij"), scattering))


def skin_albedo(melanin: np.ndarray, haemoglobin: np.ndarray, scattering: float = 1.0) -> np.ndarray:
    """Diffuse albedo, linear Rec. 709.

    Parameters
    ----------
    melanin : (N,) array
        Volume fraction of melanosomes in the epidermis: 0.013 (pale) to 0.43 (very dark); clipped to 0.004 to 0.55.
    haemoglobin : (N,) array
        Volume fraction of blood in the dermis, 0.002 to 0.07; clipped to 0.0005 to 0.12.
    scattering : float
        The dermis' scattering over the published mean, 0.7 to 1.6: people differ by that much.

    Returns
    -------
    (N, 3) array in (0, 1): bilinear in a logarithmic table of the spectral model, within 0.1 % of it.
    """
    table = _table(float(scattering))
    where = []
    for value, (low, high) in ((melanin, MELANIN_RANGE), (haemoglobin, BLOOD_RANGE)):
        value = np.clip(np.asarray(value, float), low, high)
        position = (np.log(value) - np.log(low)) / (np.log(high) - np.log(low)) * (TABLE - 1)
        index = np.minimum(position.astype(np.int64), TABLE - 2)
        where.append((index, (position - index)[..., None]))
    (i, a), (j, b) = where
    low = table[i, j] * (1 - b) + table[i, j + 1] * b
    high = table[i + 1, j] * (1 - b) + table[i + 1, j + 1] * b
    return np.exp(low * (1 - a) + high * a)

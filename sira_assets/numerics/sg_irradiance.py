"""Irradiance of one spherical gaussian: E(lambda, c) = int exp(lambda (w . xi - 1)) max(n . w, 0) dw.

Notation: lambda >= 0 sharpness, c = n . xi in [-1, 1], both of any broadcastable shapes; unit amplitude.
"""

import math

import torch
from torch import Tensor

from sira_assets.numerics.exponential import phi1

# Clamped cosine as SG(n, 0.0315, 32.7080) - 31.7003: Meder and Bruederlin, Hemispherical Gaussians for Accurate
# Light Integration, ICCVG 2018, doi:10.1007/978-3-030-00692-1_1.
COSINE_SHARPNESS = 0.0315
COSINE_AMPLITUDE = 32.7080
COSINE_OFFSET = 31.7003

# t below this makes tanh(t c / 2) / tanh(t / 2) = c to 1e-9 of its value; the floor keeps its gradient from 0/0.
_T_FLOOR = 1e-4


def hemisphere_integral(cosine: Tensor, sharpness: Tensor) -> Tensor:
    """int over n . w > 0 of exp(lambda (w . xi - 1)) dw, as fitted by Meder and Bruederlin (2018), eq. 12 and on.

    Their step s(c) = (1 - e^{-t(1+c)}) / ((1 - e^{-t}) (1 + e^{-tc})) is (1 + tanh(tc/2) / tanh(t/2)) / 2 exactly,
    which is odd about 1/2, needs no case distinction, and holds for every sharpness >= 0.

    Returns
    -------
    Tensor : shape of cosine and sharpness broadcast, >= 0.
    """
    numerator = 1.6988 * sharpness + 10.8438
    denominator = sharpness * sharpness + 6.2201 * sharpness + 10.2415
    # The gradient of sqrt at 0 is infinite but is multiplied by lambda: the tiny term keeps inf * 0 away.
    t = sharpness * torch.sqrt(sharpness + 1e-12) * (numerator / denominator) + _T_FLOOR
    step = 0.5 + 0.5 * torch.tanh(0.5 * t * cosine) / torch.tanh(0.5 * t)
    upper = 2.0 * math.pi * phi1(sharpness)
    return upper * (step + (1.0 - step) * torch.exp(-sharpness))


def irradiance_fast(cosine: Tensor, sharpness: Tensor) -> Tensor:
    """E(lambda, c) by the published route: product with the cosine lobe, then the hemisphere integral.

    Within 1.3 % of the head-on value for every sharpness >= 0; clamped at 0.
    """
    summed = sharpness + COSINE_SHARPNESS
    crossed = 2.0 * COSINE_SHARPNESS * sharpness * (cosine - 1.0)
    product = torch.sqrt(summed * summed + crossed)  # >= |lambda - 0.0315|
    exponent = crossed / (product + summed)
    product_cosine = ((sharpness * cosine + COSINE_SHARPNESS) / product).clamp(-1.0, 1.0)
    lobe = COSINE_AMPLITUDE * torch.exp(exponent) * hemisphere_integral(product_cosine, product)
    return (lobe - COSINE_OFFSET * hemisphere_integral(cosine, sharpness)).clamp_min(0.0)

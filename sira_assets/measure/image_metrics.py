"""How far one picture is from another: PSNR and SSIM, masked, in linear and in sRGB, raw and scale-invariant.

Notation: p the prediction, t the truth, both linear (H, W) or (H, W, C); m the mask (H, W); MSE the mean over the
masked pixels and all channels; PSNR = -10 log10(MSE), the data range being 1 whatever the values (a fixed range is
what makes figures of two pictures comparable; radiance above 1 counts with its full error in linear and is clipped in
sRGB). All arithmetic is float64: float32 loses SSIM's variances at large offsets.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sira_assets.errors import InputError

Encoding = Literal["linear", "srgb"]

# scikit-image's uniform window; pictures smaller than it have no SSIM.
SSIM_WINDOW = 7


@dataclass(frozen=True)
class ImageScore:
    """One comparison of two pictures.

    Parameters
    ----------
    encoding : "linear" or "srgb", the values that were compared
    gain : factor on the linear prediction before comparing; 1 is raw, else the least-squares one over the mask
    mse : mean squared error over masked pixels and channels; 0 for equal pictures
    psnr_db : decibels, data range 1; inf for equal pictures, so never average it: pool with `pooled_psnr`
    ssim : mean SSIM over the masked pixels, or None for pictures smaller than the 7 x 7 window
    values : masked pixels times channels, the weight of `mse` when pooling
    """

    encoding: Encoding
    gain: float
    mse: float
    psnr_db: float
    ssim: float | None
    values: int


def score_image(
    prediction: np.ndarray,
    truth: np.ndarray,
    mask: np.ndarray,
    *,
    encoding: Encoding = "srgb",
    scale_invariant: bool = False,
) -> ImageScore:
    """Compare two linear pictures inside a mask.

    Parameters
    ----------
    prediction, truth : (H, W) or (H, W, C) linear arrays, finite inside the mask
    mask : (H, W) bool; outside it both pictures count as black (this matters to SSIM windows that cross its edge)
    encoding : compare linear values, or values clipped to [0, 1] and sRGB-encoded
    scale_invariant : first multiply the prediction by the one gain that minimises the linear MSE

    Raises
    ------
    InputError : sizes differ, the mask is empty, or masked values are not finite.
    """
    p, t, m = _prepared(prediction, truth, mask)
    gain = best_gain(p, t, m) if scale_invariant else 1.0
    p, t = _encoded(gain * p, encoding), _encoded(t, encoding)
    p, t = np.where(m[..., None], p, 0.0), np.where(m[..., None], t, 0.0)
    mse = float(((p - t)[m] ** 2).mean())
    values = int(m.sum()) * t.shape[2]
    return ImageScore(encoding, gain, mse, psnr_from_mse(mse), masked_ssim(p, t, m), values)


def best_gain(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """The factor g that minimises sum (g p - t)^2 over the mask and all channels; 1 for a black prediction."""
    p, t = np.asarray(prediction, np.float64)[mask], np.asarray(truth, np.float64)[mask]
    power = float((p**2).sum())
    return float((p * t).sum()) / power if power > 0.0 else 1.0


def psnr_from_mse(mse: float) -> float:
    """Decibels at data range 1; inf for 0."""
    return math.inf if mse == 0.0 else -10.0 * math.log10(mse)


def pooled_psnr(scores: Iterable[ImageScore]) -> float:
    """One PSNR of many pictures: of the MSE over all their values, in which an equal picture is no infinity.

    Raises
    ------
    ValueError : no score, or scores of different encodings.
    """
    scores = list(scores)
    if not scores or len({score.encoding for score in scores}) != 1:
        raise ValueError("pooling needs at least one score, and one encoding")
    return psnr_from_mse(sum(s.mse * s.values for s in scores) / sum(s.values for s in scores))


def masked_ssim(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float | None:
    """Mean SSIM over the mask: (H, W, C) pictures, uniform 7 x 7 window, data range 1; None below 7 pixels.

    References
    ----------
    Wang et al. 2004, DOI 10.1109/TIP.2003.819861, K1 = 0.01, K2 = 0.03.
    """
    if min(truth.shape[:2]) < SSIM_WINDOW:
        return None
    from skimage.metrics import structural_similarity

    _, local = structural_similarity(
        np.asarray(prediction, np.float64),
        np.asarray(truth, np.float64),
        win_size=SSIM_WINDOW,
        data_range=1.0,
        channel_axis=2,
        full=True,
    )
    return float(local.mean(-1)[mask].mean())


def correlation(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """Pearson's correlation of two (H, W) maps inside the mask; 0 when either is constant there."""
    p, t = np.asarray(prediction, np.float64)[mask], np.asarray(truth, np.float64)[mask]
    if p.size == 0 or min(p.std(), t.std()) < 1e-9:
        return 0.0
    return float(np.corrcoef(p, t)[0, 1])


def _encoded(linear: np.ndarray, encoding: Encoding) -> np.ndarray:
    from sira_assets.numerics.colour import srgb_from_linear

    return linear if encoding == "linear" else srgb_from_linear(np.clip(linear, 0.0, 1.0))


def _prepared(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    p, t = np.asarray(prediction, np.float64), np.asarray(truth, np.float64)
    m = np.asarray(mask, bool)
    if p.shape != t.shape or m.shape != t.shape[:2]:
        raise InputError(
            expected="two pictures and a mask of one size",
            received=f"prediction {p.shape}, truth {t.shape}, mask {m.shape}",
            remedy="compare pictures rendered by the same camera",
        )
    if not m.any():
        raise InputError(
            expected="a mask that marks the head", received="an empty mask", remedy="check the mask of the scene"
        )
    p, t = (x if x.ndim == 3 else x[..., None] for x in (p, t))
    for name, x in (("prediction", p), ("truth", t)):
        if not np.isfinite(x[m]).all():
            raise InputError(
                expected="finite pixels inside the mask",
                received=f"{int((~np.isfinite(x)).any(-1)[m].sum())} pixel(s) of the {name} with NaN or inf",
                remedy="repair the picture",
            )
    return p, t, m

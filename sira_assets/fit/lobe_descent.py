"""Lobes that reproduce given irradiance and blurred radiance: kernels, amplitudes, descent.

Notation: rows are measurements, in unit directions d: irradiance E(d) of a surface with that normal, or radiance R(d)
blurred by a normalised gaussian of sharpness b. One lobe of unit amplitude gives each row a kernel k(c, lambda),
c = d . xi; so a row's residual is k mu - target, linear in the amplitudes mu (N, 3) >= 0, of which the descent is rid:
it moves axes and log sharpnesses, with the amplitudes at their best for each (variable projection; Golub and Pereyra
2003, doi:10.1088/0266-5611/19/2/201).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import nnls
from torch import Tensor

from sira_assets.numerics.exponential import phi1
from sira_assets.numerics.sg import product_scalars
from sira_assets.numerics.sg_irradiance import irradiance_accurate

# Sharpness of lobes, as a logarithm: from constant to 0.1 per cent to a source 0.06 degrees wide.
LOG_SHARPNESS = (math.log(1e-3), math.log(1e6))
# A step turns an axis by at most this share of its lobe's width, and a sharpness by this in its logarithm.
_TRUST = 1.0
# Rows blurred by b show the sharpness of a lobe by a slope of b / lambda only: this weak pull on its logarithm, against
# residuals of 1e-2, times sqrt(lambda / b) beyond b, keeps a sharp source where its own spread put it.
_PULL = 1e-3


@dataclass(frozen=True)
class Rows:
    """What lobes are to reproduce.

    Parameters
    ----------
    direction : (n, 3) unit
    target : (n, 3)
    weight : (n,), > 0; the sum of (weight residual)^2 is what is made least
    irradiances : the first so many rows are irradiance, the others blurred radiance
    blur : sharpness b of the blur
    """

    direction: np.ndarray
    target: np.ndarray
    weight: np.ndarray
    irradiances: int
    blur: float


@dataclass(frozen=True)
class Lobes:
    """N lobes under way: axis (N, 3) unit, log_sharpness (N,), amplitude (N, 3) >= 0, start (N,) log sharpness."""

    axis: np.ndarray
    log_sharpness: np.ndarray
    amplitude: np.ndarray
    start: np.ndarray

    def __len__(self) -> int:
        return len(self.log_sharpness)

    def take(self, index: np.ndarray) -> "Lobes":
        """The lobes of an index or mask."""
        return Lobes(self.axis[index], self.log_sharpness[index], self.amplitude[index], self.start[index])

    def joined(self, axis: np.ndarray, sharpness: np.ndarray) -> "Lobes":
        """These lobes and new ones, of amplitude 0."""
        start = np.clip(np.log(sharpness), *LOG_SHARPNESS)
        return Lobes(
            np.concatenate([self.axis, axis]),
            np.concatenate([self.log_sharpness, start]),
            np.concatenate([self.amplitude, np.zeros((len(axis), 3))]),
            np.concatenate([self.start, start]),
        )


def blurred_lobe(cosine: Tensor, sharpness: Tensor, blur: float) -> Tensor:
    """A unit lobe blurred by a normalised gaussian: the integral of their product, exact for all sharpnesses > 0."""
    kernel = torch.full_like(sharpness, blur)
    product, exponent = product_scalars(sharpness, kernel, 2.0 * (1.0 - cosine))
    return torch.exp(exponent) * phi1(2.0 * product) / phi1(2.0 * kernel)


def kernel(rows: Rows, axis: np.ndarray, sharpness: np.ndarray) -> np.ndarray:
    """(n, N) weighted rows of lobes with unit amplitude."""
    cosine = torch.from_numpy(np.clip(rows.direction @ axis.T, -1.0, 1.0))
    lam = torch.from_numpy(np.ascontiguousarray(sharpness)).expand_as(cosine)
    return _weighted(rows, cosine, lam).numpy()


def _weighted(rows: Rows, cosine: Tensor, sharpness: Tensor) -> Tensor:
    split = rows.irradiances
    values = [
        irradiance_accurate(cosine[:split], sharpness[:split]),
        blurred_lobe(cosine[split:], sharpness[split:], rows.blur),
    ]
    return torch.cat(values) * torch.from_numpy(rows.weight)[:, None]


def _kernel_with_slopes(rows: Rows, lobes: Lobes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n, N) kernel and its derivatives by cosine and by log sharpness."""
    cosine = torch.from_numpy(np.clip(rows.direction @ lobes.axis.T, -1.0, 1.0)).requires_grad_()
    log_sharpness = torch.from_numpy(lobes.log_sharpness).expand_as(cosine).clone().requires_grad_()
    value = _weighted(rows, cosine, log_sharpness.exp())
    # Each entry depends on its own cosine and sharpness alone, so the gradient of the sum is entry by entry.
    by_cosine, by_log = torch.autograd.grad(value.sum(), (cosine, log_sharpness))
    return value.detach().numpy(), by_cosine.numpy(), by_log.numpy()


def best_amplitudes(matrix: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(N, 3) amplitudes >= 0 that make |matrix mu - target|^2 least, by channel."""
    # A triangle of N rows has the same least squares as all rows.
    q, r = np.linalg.qr(matrix)
    scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    projected = q.T @ target
    out = [nnls(r / scale, projected[:, c], maxiter=100 * (matrix.shape[1] + 1))[0] / scale for c in range(3)]
    return np.stack(out, -1)


def _pull(rows: Rows, lobes: Lobes) -> np.ndarray:
    """(N,) weight of each lobe's log sharpness against its start."""
    return _PULL * np.sqrt(np.maximum(np.exp(lobes.start) / rows.blur, 1.0))


def solved(rows: Rows, lobes: Lobes) -> tuple[Lobes, float]:
    """The lobes with the best amplitudes, and the cost with them."""
    target = rows.target * rows.weight[:, None]
    if not len(lobes):
        return lobes, float((target**2).sum())
    matrix = kernel(rows, lobes.axis, np.exp(lobes.log_sharpness))
    amplitude = best_amplitudes(matrix, target)
    cost = float(((matrix @ amplitude - target) ** 2).sum())
    cost += float(((_pull(rows, lobes) * (lobes.log_sharpness - lobes.start)) ** 2).sum())
    return Lobes(lobes.axis, lobes.log_sharpness, amplitude, lobes.start), cost


def _tangents(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (N, 3) square to each axis (Duff et al. 2017, JCGT 6(1))."""
    x, y, z = axis.T
    sign = np.where(z >= 0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], -1), np.stack([b, sign + y * y * a, -y], -1)


def _normal_equations(rows: Rows, lobes: Lobes) -> tuple[np.ndarray, np.ndarray]:
    """J^T J (3N, 3N) and J^T r (3N,) by tangent 1, tangent 2 and log sharpness, with the amplitudes projected out."""
    value, by_cosine, by_log = _kernel_with_slopes(rows, lobes)
    first, second = _tangents(lobes.axis)
    slopes = [by_cosine * (rows.direction @ first.T), by_cosine * (rows.direction @ second.T), by_log]
    count = len(lobes)
    hessian, gradient = np.zeros((3 * count, 3 * count)), np.zeros(3 * count)
    residual = value @ lobes.amplitude - rows.target * rows.weight[:, None]
    for channel in range(3):
        mu = lobes.amplitude[:, channel]
        jacobian = np.concatenate([slope * mu for slope in slopes], 1)
        free = value[:, mu > 0]
        if free.shape[1]:
            q, _ = np.linalg.qr(free)
            jacobian -= q @ (q.T @ jacobian)
        hessian += jacobian.T @ jacobian
        gradient += jacobian.T @ residual[:, channel]
    logs = np.arange(2 * count, 3 * count)
    pull = _pull(rows, lobes) ** 2
    hessian[logs, logs] += pull
    gradient[logs] += pull * (lobes.log_sharpness - lobes.start)
    return hessian, gradient


def _moved(lobes: Lobes, step: np.ndarray) -> Lobes:
    count = len(lobes)
    first, second = _tangents(lobes.axis)
    width = np.minimum(np.exp(-0.5 * lobes.log_sharpness), 1.0)
    turn = np.stack([step[:count], step[count : 2 * count]], -1)
    length = np.maximum(np.linalg.norm(turn, axis=-1), 1e-300)
    turn *= (np.minimum(length, _TRUST * width) / length)[:, None]
    axis = lobes.axis + turn[:, :1] * first + turn[:, 1:] * second
    log_sharpness = lobes.log_sharpness + np.clip(step[2 * count :], -_TRUST, _TRUST)
    return Lobes(
        axis / np.linalg.norm(axis, axis=-1, keepdims=True),
        np.clip(log_sharpness, *LOG_SHARPNESS),
        lobes.amplitude,
        lobes.start,
    )


def descended(
    rows: Rows, lobes: Lobes, *, steps: int, gain: float, enough: Callable[[Lobes], bool] | None = None
) -> Lobes:
    """Lobes after at most `steps` steps of Levenberg and Marquardt; lobes that come out dark are dropped.

    Parameters
    ----------
    gain : stop when a step lowers the cost by less than this share
    enough : asked after each step; True stops early
    """
    lobes, cost = solved(rows, lobes)
    damping = 1e-2
    for _ in range(steps):
        lobes = lobes.take((lobes.amplitude > 0).any(-1))
        if not len(lobes):
            break
        hessian, gradient = _normal_equations(rows, lobes)
        diagonal = np.diagonal(hessian).copy()
        floor = 1e-12 * diagonal.max() + 1e-300
        better = None
        while better is None and damping < 1e6:
            step = np.linalg.solve(hessian + np.diag(damping * diagonal + floor), -gradient)
            tried, tried_cost = solved(rows, _moved(lobes, step))
            if tried_cost < cost:
                better = tried
                damping = max(damping / 5.0, 1e-6)
            else:
                damping *= 4.0
        if better is None:
            break
        lobes, fell, cost = better, cost - tried_cost, tried_cost
        if fell < gain * cost or (enough is not None and enough(lobes)):
            break
    return lobes.take((lobes.amplitude > 0).any(-1))

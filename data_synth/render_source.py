"""What shines: a light as a few components with fixed patterns and RGB weights, and how to draw directions from it.

Notation: a light is L(w) = sum_k g_k(w) c_k with K patterns g_k >= 0 over unit directions w and colours c_k (K, 3).
E_k(n) is the irradiance of pattern k on a surface with normal n that nothing shadows. A source also has S proposals,
densities p_s(w) over the sphere to draw directions from. Directions are planes of float32: x, y and z apart, any shape.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from data_synth.render_irradiance import irradiance_per_lobe
from sira_assets.scene.sg_light import SGLight

# ITU-R BT.709-6, item 3.3
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
# A lobe broader than this spends more than a quarter of its samples below the horizon: the cosine serves it better.
BROAD_SHARPNESS = 4.0
# Up to here 1 - w . xi in float32 costs the lobe less than 5e-5 of its value; beyond, the chord is taken instead.
COSINE_SHARPNESS = 400.0


class LightSource(Protocol):
    """A light that `direct_light` can integrate.

    colour is (K, 3) linear; proposals S is how many densities `draw` knows.
    """

    colour: np.ndarray
    proposals: int

    def irradiance(self, normals: np.ndarray) -> np.ndarray:
        """E_k, (P, K), at unit normals (P, 3)."""

    def proposal_energy(self, irradiance: np.ndarray) -> np.ndarray:
        """Luminance that each proposal is good for, (P, S), from `irradiance` (P, K); 0 where it shall not be used."""

    def draw(self, proposal: int, u1: np.ndarray, u2: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Unit directions by one proposal from uniform numbers in [0, 1)."""

    def evaluate(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """g (K, ...) and proposal densities (S, ...) per steradian at unit directions."""


@dataclass(frozen=True)
class SGSource:
    """Spherical gaussians: one pattern and one proposal (von Mises-Fisher) a lobe."""

    light: SGLight

    @property
    def colour(self) -> np.ndarray:
        """(K, 3) amplitudes."""
        return self.light.amplitude

    @property
    def proposals(self) -> int:
        """One a lobe."""
        return len(self.light)

    def irradiance(self, normals: np.ndarray) -> np.ndarray:
        """(P, K) by quadrature."""
        return irradiance_per_lobe(normals, self.light.axis, self.light.sharpness)

    def proposal_energy(self, irradiance: np.ndarray) -> np.ndarray:
        """(P, K); broad lobes are left to the cosine."""
        energy = irradiance * (self.light.amplitude @ LUMINANCE)
        return np.where(self.light.sharpness < BROAD_SHARPNESS, 0.0, energy)

    def draw(self, proposal: int, u1: np.ndarray, u2: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Inverse distribution of a von Mises-Fisher lobe in 1 - cos of the polar angle."""
        lam = np.float32(self.light.sharpness[proposal])
        low = np.float32(np.exp(-2.0 * self.light.sharpness[proposal]))
        # u1 is kept off 0 so that the logarithm stays finite.
        t = np.log(np.maximum(u1, np.float32(1e-7)) * (1 - low) + low) / -lam
        radius, phi = np.sqrt(np.maximum(t * (2 - t), 0)), np.float32(2 * np.pi) * u2
        return from_local(self.light.axis[proposal], radius * np.cos(phi), radius * np.sin(phi), 1 - t)

    def evaluate(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """exp(lambda (w . xi - 1)), and the same normalised."""
        g = np.empty((len(self.light), *x.shape), np.float32)
        for out, axis, lam in zip(g, self.light.axis.astype(np.float32), self.light.sharpness, strict=True):
            if lam <= COSINE_SHARPNESS:
                np.multiply(x, axis[0], out=out)
                out += y * axis[1]
                out += z * axis[2]
                out -= 1
                out *= np.float32(lam)
            else:
                # |w - xi|^2 / 2 = 1 - w . xi, without cancellation
                np.square(x - axis[0], out=out)
                out += np.square(y - axis[1])
                out += np.square(z - axis[2])
                out *= np.float32(-0.5 * lam)
            np.exp(out, out=out)
        lam = self.light.sharpness
        norm = (lam / (2.0 * np.pi * -np.expm1(-2.0 * lam))).astype(np.float32)
        return g, g * norm.reshape(-1, *(1,) * x.ndim)


def from_local(axis, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x t + y b + z axis as planes, axis given as three; (t, b, axis) is orthonormal (Duff et al. 2017, JCGT 6(1))."""
    ax, ay, az = (np.asarray(a, np.float32) for a in axis)
    sign = np.copysign(np.float32(1.0), az)
    a = -1 / (sign + az)
    b = ax * ay * a
    return (
        x * (1 + sign * ax * ax * a) + y * b + z * ax,
        x * (sign * b) + y * (sign + ay * ay * a) + z * ay,
        x * (-sign * ax) - y * ay + z * az,
    )

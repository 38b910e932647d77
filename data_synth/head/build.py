"""From parameters to a head: hair and cloth united with the template, meshed, warped, brought to the canonical frame.

Notation: ``x_template`` a point of the template, ``x_head = S(x_template + u(x_template))`` with ``u`` the identity
warp and ``S`` the least-squares similarity of the head's nine landmarks onto the canonical nine. Metres throughout.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_synth.head.cover import composed_field
from data_synth.head.grid import extract
from data_synth.head.identity import Warp, make_warp, warp_points
from data_synth.head.material import evaluate_material, region_of
from data_synth.head.params import HeadParams
from data_synth.head.surface import bald_surface
from data_synth.one_thread import one_thread
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M, IBUG68_OF_CANONICAL, similarity


@dataclass(frozen=True)
class SynthHead:
    """A procedural head in the canonical frame.

    Attributes
    ----------
    params : HeadParams
    vertices_m : (V, 3) float64
    faces : (F, 3) int64
        Outward; the mesh is watertight.
    template_positions_m : (V, 3) float64
        Each vertex before the warp: dense correspondence with every other head.
    landmarks_m, landmarks_template_m : (68, 3)
        iBUG 68 on this head and on the template.
    anchors_m, anchors_template_m : (A, 3)
        Corresponding points on the skin, in the same order in every head.
    region : (V,) int64
        `data_synth.head.material.Region` of each vertex.
    warp : Warp
    canonical_from_warped : (4, 4)
        The similarity ``S``.
    """

    params: HeadParams
    vertices_m: np.ndarray
    faces: np.ndarray
    template_positions_m: np.ndarray
    landmarks_m: np.ndarray
    landmarks_template_m: np.ndarray
    anchors_m: np.ndarray
    anchors_template_m: np.ndarray
    region: np.ndarray
    warp: Warp
    canonical_from_warped: np.ndarray

    @property
    def landmarks9(self) -> dict[str, np.ndarray]:
        """The canonical nine by name, each (3,)."""
        return {name: self.landmarks_m[i] for name, i in IBUG68_OF_CANONICAL.items()}

    def material(self, template_positions_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Diffuse albedo (N, 3), linear Rec. 709, and specular F0 (N,) at template points (N, 3) in metres."""
        return evaluate_material(template_positions_m, self.params)

    def from_template(self, x_template_m: np.ndarray) -> np.ndarray:
        """Where template points (N, 3) lie on this head, metres, canonical frame."""
        return _apply(self.canonical_from_warped, warp_points(self.warp, x_template_m))


def _apply(matrix: np.ndarray, x: np.ndarray) -> np.ndarray:
    return x @ matrix[:3, :3].T + matrix[:3, 3]


@one_thread
def build_head(params: HeadParams) -> SynthHead:
    """Build a head; the same parameters give the same arrays.

    The first call in a process computes the template's grid (seconds); later ones take one to two seconds.
    """
    base = bald_surface()
    x_template, faces = extract(*composed_field(params))
    warp = make_warp(params, base.landmarks_m)
    landmarks = warp_points(warp, base.landmarks_m)
    nine = np.array([landmarks[i] for i in IBUG68_OF_CANONICAL.values()])
    to_canonical = similarity(nine, np.array([CANONICAL_LANDMARKS_M[n] for n in IBUG68_OF_CANONICAL]))
    return SynthHead(
        params=params,
        vertices_m=_apply(to_canonical, warp_points(warp, x_template)),
        faces=faces,
        template_positions_m=x_template,
        landmarks_m=_apply(to_canonical, landmarks),
        landmarks_template_m=base.landmarks_m,
        anchors_m=_apply(to_canonical, warp_points(warp, base.anchors_m)),
        anchors_template_m=base.anchors_m,
        region=region_of(x_template, params),
        warp=warp,
        canonical_from_warped=to_canonical,
    )

"""What stands before the cameras: a procedural head or a scan, in the canonical frame.

Notation: metres, canonical head frame; V vertices of the welded mesh, U of the one that is rendered.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from data_synth.render import Material
from sira_assets.mesh.triangle_mesh import TriangleMesh

if TYPE_CHECKING:
    from data_synth.head.params import HeadParams


@dataclass(frozen=True)
class Subject:
    """A head ready to be placed.

    Parameters
    ----------
    mesh : welded, outward; what gt/mesh.ply holds
    vertex_albedo : (V, 3) linear Rec. 709
    rendered : the same surface as the renderer takes it; a scan's vertices are split where its texture is cut
    material_coordinates : (U, K), interpolated over triangles and handed to `material`
    material : function of (N, K) coordinates -> diffuse albedo (N, 3) linear, specular F0 (N,)
    landmarks : the nine canonical names -> (3,)
    landmarks68 : (68, 3) iBUG, or None where a scan came without
    anchors : (A, 3) points that correspond between procedural heads; (0, 3) for a scan
    regions : function of (N, K) coordinates -> (N,) region numbers, or None
    region_names : number -> name
    closed : watertight mesh for signed distances, its first faces those of `mesh`; `mesh` itself where that is closed
    scale : world metres per canonical metre, or None where it is drawn
    around_yaw_deg : cameras turn no farther, or None for as far as cameras go
    metered_albedo : (V, 3) that the light is exposed for, or None for `vertex_albedo`
    provenance : for gt/provenance.json
    """

    mesh: TriangleMesh
    vertex_albedo: np.ndarray
    rendered: TriangleMesh
    material_coordinates: np.ndarray
    material: Material
    landmarks: Mapping[str, np.ndarray]
    landmarks68: np.ndarray | None
    anchors: np.ndarray
    regions: Callable[[np.ndarray], np.ndarray] | None
    region_names: Mapping[int, str]
    closed: TriangleMesh
    scale: float | None
    around_yaw_deg: float | None
    provenance: Mapping[str, object]
    metered_albedo: np.ndarray | None = None


@dataclass(frozen=True)
class SkinTone:
    """Melanin of the skin in place of the drawn one, and the melanin that the light is exposed for: scenes that differ
    in `melanin` alone show one person, otherwise the same, under one light."""

    melanin: float
    metered: float


def procedural_subject(rng: np.random.Generator, tone: SkinTone | None = None) -> Subject:
    """Draw a head from the generator's population; `tone` changes its skin afterwards, and nothing else."""
    from data_synth.head.build import build_head
    from data_synth.head.material import Region, evaluate_material, region_of
    from data_synth.head.params import sample_params

    params, metered = sample_params(rng), None
    if tone is not None:
        params = with_melanin(params, tone.melanin)
    head = build_head(params)
    if tone is not None:
        metered, _ = evaluate_material(head.template_positions_m, with_melanin(params, tone.metered))
    mesh = TriangleMesh(head.vertices_m, head.faces)
    albedo, _ = head.material(head.template_positions_m)
    return Subject(
        mesh=mesh,
        vertex_albedo=albedo,
        rendered=mesh,
        material_coordinates=head.template_positions_m,
        material=head.material,
        landmarks=head.landmarks9,
        landmarks68=head.landmarks_m,
        anchors=head.anchors_m,
        regions=lambda coordinates: region_of(coordinates, head.params),
        region_names={int(region): region.name.lower() for region in Region},
        closed=mesh,
        scale=None,
        around_yaw_deg=None,
        provenance={"head": plain(asdict(head.params))},
        metered_albedo=metered,
    )


def with_melanin(params: HeadParams, melanin: float) -> HeadParams:
    """The same head with other skin; hair and eyes keep their colour."""
    return replace(params, pigment=replace(params.pigment, melanin=melanin))


def plain(value: object) -> object:
    """Arrays and tuples as lists, for JSON."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return value

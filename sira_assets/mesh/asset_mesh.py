"""From the full surface to the mesh that is exported, and what is known of it.

Notation: t the tolerance that was asked for, in canonical millimetres (eye centres 63 mm apart).
"""

from dataclasses import dataclass

from sira_assets.mesh.clean import CleanReport
from sira_assets.mesh.extract import ExtractReport
from sira_assets.mesh.field_distance import SurfaceGap
from sira_assets.mesh.importance import head_importance
from sira_assets.mesh.simplify import simplify_mesh, simplify_to_tolerance
from sira_assets.mesh.triangle_mesh import TriangleMesh

# Shares of t: the full surface stands off the zero set by the first at most, the exported mesh off the full surface by
# the second; the rest is for what lies between the points where distances are measured.
EXTRACT_SHARE, SIMPLIFY_SHARE = 0.25, 0.65
# Each level of detail has a quarter of the triangles and half the texels a side of the one before.
LEVEL_FACTOR = 4
FEWEST_TRIANGLES = 100


@dataclass(frozen=True)
class MeshFacts:
    """What extraction and cleaning took, and the exported mesh's distance from the zero set in metres."""

    extract: ExtractReport
    clean: CleanReport
    gap: SurfaceGap


def asset_mesh(surface: TriangleMesh, max_triangles: int, tolerance_mm: float | None = None) -> TriangleMesh:
    """The surface in fewer triangles, most of them where a head is looked at.

    Parameters
    ----------
    surface : canonical metres
    max_triangles : the budget, where there is no tolerance
    tolerance_mm : t; as many triangles then as it takes

    Returns
    -------
    TriangleMesh : canonical metres
    """
    importance = head_importance(surface)
    if tolerance_mm is None:
        return simplify_mesh(surface, max_triangles, importance=importance)
    return simplify_to_tolerance(surface, SIMPLIFY_SHARE * 1e-3 * tolerance_mm, importance=importance)[0]


def level_of_detail(surface: TriangleMesh, full: TriangleMesh, level: int) -> TriangleMesh:
    """Level 1, 2, ... of the exported mesh `full`, made from the surface itself."""
    count = max(len(full.faces) // LEVEL_FACTOR**level, FEWEST_TRIANGLES)
    return simplify_mesh(surface, count, importance=head_importance(surface))

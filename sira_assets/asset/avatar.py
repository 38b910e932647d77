"""The finished avatar: what the bake made, ready for the writers.

Notation: world is the scene's own frame, in its own unit; one world unit is `metres_per_unit` metres. F0 is the
specular albedo at normal incidence.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.errors import InputError
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.camera import Camera
from sira_assets.scene.sg_light import SGLight
from sira_assets.texture.atlas import Atlas
from sira_assets.texture.texture_set import TextureSet


@dataclass(frozen=True)
class Avatar:
    """A textured head under the light that was found in its photo.

    Parameters
    ----------
    mesh : welded triangles in the scene's world coordinates, untouched
    atlas : one row of `faces_uv` for every face of `mesh`
    textures : the baked maps over that atlas
    light : spherical gaussians, world frame
    roughness : in (0, 1], glTF's roughnessFactor (GGX alpha is its square)
    canonical_from_world : (4, 4) similarity into the canonical head frame
    metres_per_unit : length of one world unit, metres
    name : one line, names the node, the mesh and the material
    camera : the portrait's, in the scene's world; None where there is none

    Raises
    ------
    InputError : no triangles, an atlas of another mesh, roughness or unit out of range.
    """

    mesh: TriangleMesh
    atlas: Atlas
    textures: TextureSet
    light: SGLight
    roughness: float
    canonical_from_world: np.ndarray
    metres_per_unit: float = 1.0
    name: str = "avatar"
    camera: Camera | None = None

    def __post_init__(self):
        faces, faces_uv = self.mesh.faces, self.atlas.faces_uv
        if not len(faces):
            raise InputError(expected="a mesh with triangles", received="none", remedy="extract the surface again")
        if faces.shape != faces_uv.shape:
            raise InputError(
                expected=f"an atlas of the mesh's {len(faces)} faces",
                received=f"{len(faces_uv)} faces",
                remedy="unwrap the mesh that is exported",
            )
        if not 0.0 < self.roughness <= 1.0:
            raise InputError(expected="a roughness in (0, 1]", received=f"{self.roughness}", remedy="correct it")
        if not (np.isfinite(self.metres_per_unit) and self.metres_per_unit > 0):
            raise InputError(
                expected="metres_per_unit > 0", received=f"{self.metres_per_unit}", remedy="correct it in the scene"
            )

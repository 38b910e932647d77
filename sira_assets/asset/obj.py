"""Write an avatar as Wavefront OBJ and MTL, with its maps where `write_textures` puts them."""

from pathlib import Path

import numpy as np

from sira_assets.asset.avatar import Avatar
from sira_assets.atomic import write_text

# Of the two normal-map keywords, `norm` is read by three.js and PBR tools, `map_Bump` (as a normal map) by Blender;
# three.js prefers `norm` where both stand. Blender reads Ks as its Specular IOR Level, with F0 = 0.08 Ks: exactly
# specular.png's scale.
MTL = """# sira_assets: diffuse.png is sRGB; specular.png is linear, F0 = 0.08 value/255; normal.png is linear, +Y up
newmtl {name}
illum 2
Ka 0 0 0
Kd 1 1 1
Ks 1 1 1
Ns {exponent:.6g}
Ni 1.5
d 1
Pr {roughness:.6g}
Pm 0
map_Kd {folder}/diffuse.png
map_Ks {folder}/specular.png
norm {folder}/normal.png
map_Bump -bm 1 {folder}/normal.png
"""


def write_obj(avatar: Avatar, path: str | Path, *, textures: str = "textures") -> None:
    """Write `path` and, beside it, the .mtl of the same name.

    Positions and normals keep the mesh's own indices (seams do not split them); UV origin is the bottom left.

    Parameters
    ----------
    path : where the .obj goes; any other suffix is replaced
    textures : folder of the maps, relative to the .mtl, forward slashes
    """
    path = Path(path).with_suffix(".obj")
    # OBJ names end at white space.
    name = "_".join(avatar.name.split()) or "avatar"
    # Phong's exponent of the same width as GGX alpha = roughness^2: 2 / alpha^2 - 2 (Walter et al. 2007, section 5.2).
    exponent = float(np.clip(2.0 / avatar.roughness**4 - 2.0, 0.0, 1000.0))
    material = MTL.format(name=name, folder=textures, exponent=exponent, roughness=avatar.roughness)
    write_text(path.with_suffix(".mtl"), material)
    write_text(path, _obj_text(avatar, name, path.with_suffix(".mtl").name))


def _obj_text(avatar: Avatar, name: str, mtl: str) -> str:
    mesh, atlas = avatar.mesh, avatar.atlas
    corners = np.stack([mesh.faces, atlas.faces_uv, mesh.faces], -1).reshape(-1, 9) + 1
    length = np.linalg.norm(mesh.normals, axis=1, keepdims=True)
    normals = np.where(length > 1e-12, mesh.normals / np.maximum(length, 1e-12), np.array([0.0, 0.0, 1.0]))
    lines = [
        f"# sira_assets avatar, scene world coordinates; one unit is {avatar.metres_per_unit!r} m",
        f"mtllib {mtl}",
        f"o {name}",
        # Nine digits hold a float32 exactly, so OBJ and GLB carry the same positions.
        _rows("v %.9g %.9g %.9g", mesh.vertices.astype(np.float32)),
        _rows("vt %.9g %.9g", atlas.uv.astype(np.float32)),
        _rows("vn %.6g %.6g %.6g", normals),
        f"usemtl {name}",
        "s 1",
        _rows("f %d/%d/%d %d/%d/%d %d/%d/%d", corners),
    ]
    return "\n".join(lines) + "\n"


def _rows(template: str, array: np.ndarray) -> str:
    """One line for each row, by one formatting call: a loop over a million numbers would take seconds."""
    return "\n".join([template] * len(array)) % tuple(array.reshape(-1).tolist())

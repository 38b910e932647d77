"""Write everything an avatar is, in the folder layout that docs/formats.md describes."""

from pathlib import Path

from sira_assets.asset.avatar import Avatar
from sira_assets.asset.gltf import write_glb
from sira_assets.asset.lights import write_lights
from sira_assets.asset.obj import write_obj
from sira_assets.asset.textures import write_textures


def write_avatar(avatar: Avatar, folder: str | Path) -> None:
    """Write avatar.glb, avatar.obj, avatar.mtl, textures/, lights.json and envmap.exr into `folder`."""
    folder = Path(folder)
    write_textures(avatar.textures, folder / "textures")
    write_lights(avatar.light, folder)
    write_obj(avatar, folder / "avatar.obj")
    write_glb(avatar, folder / "avatar.glb")

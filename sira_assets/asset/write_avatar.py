"""Write everything an avatar is, in the folder layout that docs/formats.md describes."""

from pathlib import Path

from sira_assets.asset.avatar import Avatar
from sira_assets.asset.export_config import ExportConfig
from sira_assets.asset.gltf import write_glb
from sira_assets.asset.lights import write_lights
from sira_assets.asset.obj import write_obj
from sira_assets.asset.textures import write_textures
from sira_assets.asset.usd import check_usd, write_usd


def write_avatar(
    avatar: Avatar,
    folder: str | Path,
    config: ExportConfig = ExportConfig(),
    *,
    levels: tuple[Avatar, ...] = (),
) -> None:
    """Write avatar.glb, avatar.obj, avatar.mtl, textures/, the light and, if asked, USD into `folder`.

    Parameters
    ----------
    levels : coarser avatars, written beside it as avatar_lod1.glb, avatar_lod2.glb ...

    Raises
    ------
    MissingExtraError : USD was asked for and usd-core is not installed; nothing is written then.
    """
    folder = Path(folder)
    if config.usd:
        check_usd()
    write_textures(avatar.textures, folder / "textures")
    write_lights(avatar.light, folder)
    write_obj(avatar, folder / "avatar.obj")
    write_glb(avatar, folder / "avatar.glb", config)
    for number, level in enumerate(levels, 1):
        write_glb(level, folder / f"avatar_lod{number}.glb", config)
    if config.usd:
        write_usd(avatar, folder / "avatar.usdc")

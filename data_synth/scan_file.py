"""A scan's file as trimesh reads it, but with all colours that are in it."""

from pathlib import Path

from sira_assets.errors import InputError


def is_gltf(path: Path) -> bool:
    """Whether the file is glTF: its colours are linear, but for its pictures'."""
    return path.suffix.lower() in (".glb", ".gltf")


def load_parts(path: Path, *, pictured: bool) -> list:
    """The file's triangle meshes in their place, each of one material.

    Parameters
    ----------
    pictured : a picture of the user's own is laid on texture coordinates

    Raises
    ------
    InputError : missing, unreadable, or no triangles.
    """
    if not path.is_file():
        raise InputError(expected=f"a mesh file {path}", received="no such file", remedy="check the path")
    try:
        parts = _meshes(path)
        bare = any(uv_of(part) is not None and picture_of(part) is None for part in parts)
        if path.suffix.lower() == ".ply" and bare and not pictured:
            # Where its texture is cut trimesh splits a PLY's vertices, but not their colours.
            parts = _meshes(path, fix_texture=False)
    except Exception as error:  # trimesh's readers raise whatever their parsers do
        raise InputError(
            expected=f"a mesh that trimesh reads at {path}",
            received=f"{type(error).__name__}: {error}"[:200],
            remedy="export it as PLY, OBJ or GLB",
        ) from None
    if not parts:
        raise InputError(
            expected=f"triangles in {path}", received="none (points?)", remedy="export a surface, not a point cloud"
        )
    return parts


def uv_of(part):
    """A part's texture coordinates (U, 2), or None."""
    uv = getattr(part.visual, "uv", None)
    return uv if uv is not None and len(uv) == len(part.vertices) else None


def picture_of(part):
    """The Pillow picture that a part's material names, or None."""
    material = getattr(part.visual, "material", None)
    if (picture := getattr(material, "baseColorTexture", None)) is not None:
        return picture
    picture = getattr(material, "image", None)
    # trimesh gives texture coordinates without a material four grey pixels that come from no file.
    return None if picture is None or (picture.format is None and picture.size == (2, 2)) else picture


def _meshes(path: Path, **options) -> list:
    import trimesh

    loaded = _load_gltf(path) if is_gltf(path) else trimesh.load(path, process=False, **options)
    scene = loaded if isinstance(loaded, trimesh.Scene) else trimesh.Scene(loaded)
    return [part for part in scene.dump() if isinstance(part, trimesh.Trimesh) and len(part.faces)]


def _load_gltf(path: Path):
    """The scene with COLOR_0 among the vertices' attributes; trimesh would round it to bytes, or leave it out."""
    import trimesh
    from trimesh.exchange.gltf import load_glb, load_gltf

    with path.open("rb") as file:
        read = load_glb if path.suffix.lower() == ".glb" else load_gltf
        content = read(file, resolver=trimesh.resolvers.FilePathResolver(str(path)), process=False)
    for part in content["geometry"].values():
        visual = part.get("visual")
        stored = part.pop("vertex_colors", None) if visual is None else visual.vertex_attributes.get("color")
        if "faces" in part and stored is not None:
            part.setdefault("vertex_attributes", {})["color"] = trimesh.visual.color.to_float(stored)
    return trimesh.load(content)

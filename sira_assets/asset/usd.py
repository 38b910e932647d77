"""Write an avatar as USD: a mesh with UsdPreviewSurface, beside the same textures/ as the OBJ.

UsdPreviewSurface's specular workflow takes F0 itself (specularColor) with F90 = 1, as the fitted model has it;
specular.png holds F0 = 0.08 c / 255, so a scale of 0.08 on the reader says it exactly. Programs that know the metallic
workflow only find metallic 0 and the index of refraction of the mean F0. UVs have their origin at the bottom left, as
here.

Needs usd-core (extra `usd`), imported when a file is written. Source: "UsdPreviewSurface Specification", version 2.6,
and "USDZ File Format Specification", both openusd.org.
"""

import io
import json
import re
import zipfile
from pathlib import Path

import numpy as np

from sira_assets.asset.avatar import Avatar
from sira_assets.asset.encoding import F0_OF_IOR_1_5, KS_RANGE
from sira_assets.asset.gltf import avatar_extras
from sira_assets.atomic import replacing, write_bytes
from sira_assets.errors import MissingExtraError

# A file's bytes start at a multiple of this in a USDZ, so that readers may map them (USDZ specification, "Layout").
USDZ_ALIGNMENT = 64
# MS-DOS time has no year before; any constant will do, so that the same avatar gives the same bytes.
ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)


def check_usd() -> None:
    """Raise MissingExtraError where usd-core is not installed."""
    try:
        from pxr import Usd  # noqa: F401
    except ImportError:
        raise MissingExtraError("usd-core", "usd") from None


def write_usd(avatar: Avatar, path: str | Path, *, textures: str = "textures") -> None:
    """Write `path` (.usdc) and, beside it, the .usdz of the same name, which holds the maps as well.

    Parameters
    ----------
    textures : folder of the maps as `write_textures` wrote them, relative to `path`, forward slashes

    Raises
    ------
    MissingExtraError : usd-core is not installed.
    OSError : the disk is full, or a map is not there.
    """
    check_usd()
    path = Path(path).with_suffix(".usdc")
    maps = [f"{textures}/{name}" for name in _maps(avatar)]
    with replacing(path) as temporary:
        layer = _layer(avatar, textures)
        if not layer.Export(str(temporary)):
            raise OSError(f"{path} could not be written")
    files = [(path.name, path.read_bytes()), *((name, (path.parent / name).read_bytes()) for name in maps)]
    write_bytes(path.with_suffix(".usdz"), usdz_bytes(files))


def usdz_bytes(files: list[tuple[str, bytes]]) -> bytes:
    """A USDZ package: a zip without compression whose files start at multiples of 64 bytes.

    Parameters
    ----------
    files : (name, bytes); the first is the layer that opens
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name, data in files:
            entry = zipfile.ZipInfo(name, ZIP_EPOCH)
            entry.create_system = 3  # Unix whatever the machine
            # The data follows 30 bytes, the name and the extra field; that field has a header of 4 bytes.
            start = buffer.tell() + 30 + len(name.encode()) + 4
            padding = -start % USDZ_ALIGNMENT
            entry.extra = b"\x86\x19" + padding.to_bytes(2, "little") + bytes(padding)
            archive.writestr(entry, data)
    return buffer.getvalue()


def _maps(avatar: Avatar) -> tuple[str, ...]:
    names = ("diffuse.png", "specular.png", "normal.png")
    return names if avatar.textures.occlusion is None else (*names, "occlusion.png")


def _layer(avatar: Avatar, textures: str):
    """The stage's only layer, in memory."""
    from pxr import Kind, Sdf, Usd, UsdGeom, UsdShade, Vt

    layer = Sdf.Layer.CreateAnonymous("avatar.usdc")
    stage = Usd.Stage.Open(layer)
    # The axes are the scene's own, as in the GLB, which calls them Y up.
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, float(avatar.metres_per_unit))
    layer.customLayerData = {"sira_assets": {"extras": json.dumps(avatar_extras(avatar), allow_nan=False)}}
    root = UsdGeom.Xform.Define(stage, f"/{_identifier(avatar.name)}")
    root.GetPrim().SetDisplayName(avatar.name)
    Usd.ModelAPI(root).SetKind(Kind.Tokens.component)
    stage.SetDefaultPrim(root.GetPrim())

    mesh = UsdGeom.Mesh.Define(stage, root.GetPath().AppendChild("mesh"))
    vertices = avatar.mesh.vertices.astype(np.float32)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(vertices))
    mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([vertices.min(0), vertices.max(0)])))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(avatar.mesh.faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(avatar.mesh.faces.astype(np.int32).reshape(-1)))
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(avatar.mesh.normals.astype(np.float32)))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    # Without this a reader subdivides.
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    uv = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying)
    uv.Set(Vt.Vec2fArray.FromNumpy(avatar.atlas.uv.astype(np.float32)))
    uv.SetIndices(Vt.IntArray.FromNumpy(avatar.atlas.faces_uv.astype(np.int32).reshape(-1)))

    material = UsdShade.Material.Define(stage, root.GetPath().AppendChild("material"))
    _preview_surface(stage, material, avatar, textures)
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    return layer


def _preview_surface(stage, material, avatar: Avatar, textures: str) -> None:
    from pxr import Gf, Sdf, UsdShade

    types = Sdf.ValueTypeNames

    def shader(name: str, kind: str):
        made = UsdShade.Shader.Define(stage, material.GetPath().AppendChild(name))
        made.CreateIdAttr(kind)
        return made

    uv = shader("uv", "UsdPrimvarReader_float2")
    uv.CreateInput("varname", types.String).Set("st")
    st = uv.CreateOutput("result", types.Float2)
    surface = shader("surface", "UsdPreviewSurface")
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", types.Token))
    surface.CreateInput("useSpecularWorkflow", types.Int).Set(1)
    surface.CreateInput("metallic", types.Float).Set(0.0)
    surface.CreateInput("roughness", types.Float).Set(float(avatar.roughness))
    surface.CreateInput("ior", types.Float).Set(_index_of_refraction(avatar))

    def texture(
        name: str, space: str, target: str, kind, scale: float = 1.0, bias: float = 0.0, channel: str = "rgb"
    ) -> None:
        reader = shader(name, "UsdUVTexture")
        reader.CreateInput("file", types.Asset).Set(Sdf.AssetPath(f"./{textures}/{name}.png"))
        reader.CreateInput("sourceColorSpace", types.Token).Set(space)
        for wrap in ("wrapS", "wrapT"):
            reader.CreateInput(wrap, types.Token).Set("clamp")
        reader.CreateInput("scale", types.Float4).Set(Gf.Vec4f(scale, scale, scale, 1.0))
        reader.CreateInput("bias", types.Float4).Set(Gf.Vec4f(bias, bias, bias, 0.0))
        reader.CreateInput("st", types.Float2).ConnectToSource(st)
        surface.CreateInput(target, kind).ConnectToSource(
            reader.CreateOutput(channel, types.Float3 if channel == "rgb" else types.Float)
        )

    texture("diffuse", "sRGB", "diffuseColor", types.Color3f)
    texture("specular", "raw", "specularColor", types.Color3f, F0_OF_IOR_1_5 * KS_RANGE)
    texture("normal", "raw", "normal", types.Normal3f, 2.0, -1.0)
    if avatar.textures.occlusion is not None:
        texture("occlusion", "raw", "occlusion", types.Float, channel="r")


def _index_of_refraction(avatar: Avatar) -> float:
    """Of the mean F0 on the atlas: F0 = ((n - 1) / (n + 1))^2."""
    maps = avatar.textures
    used = maps.specular_f0[maps.coverage] if maps.coverage.any() else maps.specular_f0
    root = float(np.sqrt(np.clip(used.mean(dtype=np.float64), 0.0, 0.9)))
    return (1.0 + root) / (1.0 - root)


def _identifier(name: str) -> str:
    """A USD prim name: letters, digits and underscores, not led by a digit."""
    out = re.sub(r"[^0-9A-Za-z_]", "_", name) or "avatar"
    return f"_{out}" if out[0].isdigit() else out

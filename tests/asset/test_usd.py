"""USD read back by usd-core, and checked by its own validators."""

import json
import sys
import zipfile

import numpy as np
import pytest
from sample_avatar import avatar_of, shaded_maps

from sira_assets.asset.encoding import decode_srgb
from sira_assets.asset.export_config import ExportConfig
from sira_assets.asset.usd import USDZ_ALIGNMENT, usdz_bytes
from sira_assets.asset.write_avatar import write_avatar
from sira_assets.errors import MissingExtraError

USD = ExportConfig(usd=True)


def test_without_usd_core_one_line_names_the_extra_and_nothing_is_written(avatar, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(MissingExtraError, match=r"sira-assets\[usd\]"):
        write_avatar(avatar, tmp_path / "out", USD)
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def avatar():
    return avatar_of(shaded_maps())


@pytest.fixture(scope="module")
def folder(avatar, tmp_path_factory):
    pytest.importorskip("pxr")
    folder = tmp_path_factory.mktemp("usd")
    write_avatar(avatar, folder, USD)
    return folder


@pytest.fixture(params=["avatar.usdc", "avatar.usdz"])
def stage(request, folder):
    from pxr import Usd

    return Usd.Stage.Open(str(folder / request.param))


def prim(stage, kind):
    (found,) = (p for p in stage.Traverse() if p.GetTypeName() == kind)
    return found


def test_geometry_is_the_mesh_with_its_seams_in_the_uv_alone(avatar, stage):
    from pxr import UsdGeom

    mesh = UsdGeom.Mesh(prim(stage, "Mesh"))
    assert (np.array(mesh.GetPointsAttr().Get()) == avatar.mesh.vertices.astype(np.float32)).all()
    assert (np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3) == avatar.mesh.faces).all()
    assert set(mesh.GetFaceVertexCountsAttr().Get()) == {3}
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"
    assert mesh.GetOrientationAttr().Get() == "rightHanded"
    assert np.array(mesh.GetNormalsAttr().Get()) == pytest.approx(avatar.mesh.normals, abs=1e-6)
    uv = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    flat = np.array(uv.ComputeFlattened()).reshape(-1, 3, 2)
    assert (flat == avatar.atlas.uv[avatar.atlas.faces_uv].astype(np.float32)).all()
    box = UsdGeom.BBoxCache(0, ["default"]).ComputeWorldBound(stage.GetDefaultPrim()).ComputeAlignedRange()
    assert np.array([box.GetMin(), box.GetMax()]) == pytest.approx(
        np.stack([avatar.mesh.vertices.min(0), avatar.mesh.vertices.max(0)]), abs=1e-6
    )


def test_unit_axis_and_extras(avatar, stage):
    from pxr import UsdGeom

    assert UsdGeom.GetStageMetersPerUnit(stage) == avatar.metres_per_unit
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    extras = json.loads(stage.GetRootLayer().customLayerData["sira_assets"]["extras"])
    assert np.array(extras["canonical_from_world"]) == pytest.approx(avatar.canonical_from_world, abs=0)


def read_texture(stage, folder, target):
    """What a renderer gets from an input's texture before filtering: scale * texel + bias, and its colour space."""
    import io

    from PIL import Image
    from pxr import Ar, UsdShade

    surface = next(
        UsdShade.Shader(p) for p in stage.Traverse() if UsdShade.Shader(p).GetShaderId() == "UsdPreviewSurface"
    )
    source = surface.GetInput(target).GetConnectedSources()[0][0].source
    reader = UsdShade.Shader(source.GetPrim())
    asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(reader.GetInput("file").Get().resolvedPath))
    with Image.open(io.BytesIO(bytes(asset.GetBuffer()))) as picture:
        texels = np.asarray(picture, np.float64) / 255
    if texels.ndim == 2:
        texels = np.repeat(texels[..., None], 3, -1)
    space = reader.GetInput("sourceColorSpace").Get()
    texels = decode_srgb(np.rint(255 * texels)) if space == "sRGB" else texels
    return texels * np.array(reader.GetInput("scale").Get())[:3] + np.array(reader.GetInput("bias").Get())[:3]


def test_the_material_reads_the_maps_as_they_are_meant(avatar, stage, folder):
    maps = avatar.textures
    # Half a step of sRGB at its steepest, of F0's range of 0.08, and of eight-bit normals (0.4 degrees).
    assert read_texture(stage, folder, "diffuseColor") == pytest.approx(maps.diffuse, abs=0.0045)
    f0 = read_texture(stage, folder, "specularColor")
    assert f0 == pytest.approx(np.repeat(maps.specular_f0[..., None], 3, -1), abs=0.04 / 255 + 1e-7)
    open_sky = read_texture(stage, folder, "occlusion")[..., 0]
    assert open_sky == pytest.approx(maps.occlusion, abs=0.5 / 255 + 1e-7)
    normal = read_texture(stage, folder, "normal")
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    assert (normal * maps.normal_tangent).sum(-1).min() > np.cos(np.radians(0.4))


def test_no_metal_and_the_fitted_roughness(avatar, stage):
    from pxr import UsdShade

    (surface,) = (
        UsdShade.Shader(p) for p in stage.Traverse() if UsdShade.Shader(p).GetShaderId() == "UsdPreviewSurface"
    )
    value = {i.GetBaseName(): i.Get() for i in surface.GetInputs()}
    assert value["metallic"] == 0
    assert value["useSpecularWorkflow"] == 1
    assert value["roughness"] == pytest.approx(avatar.roughness, rel=1e-6)
    f0 = ((value["ior"] - 1) / (value["ior"] + 1)) ** 2
    assert f0 == pytest.approx(avatar.textures.specular_f0.mean(), rel=1e-5)


def test_usds_own_validators_have_nothing_to_say(stage):
    from pxr import Usd, UsdValidation

    registry = UsdValidation.ValidationRegistry()
    names = [v.name for v in registry.GetAllValidatorMetadata()]
    assert len(names) > 10
    context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
    errors = context.Validate(stage)
    assert [f"{e.GetName()}: {e.GetMessage()}" for e in errors] == []
    # They do speak: a stage that says nothing of itself is found fault with.
    assert context.Validate(Usd.Stage.CreateInMemory())


def test_the_package_is_stored_aligned_and_opens_with_its_first_file(folder):
    path = folder / "avatar.usdz"
    raw = path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        entries = archive.infolist()
        assert archive.testzip() is None
        assert entries[0].filename == "avatar.usdc"
        for entry in entries:
            assert entry.compress_type == zipfile.ZIP_STORED
            data = archive.read(entry)
            start = raw.index(data)
            assert start % USDZ_ALIGNMENT == 0
            assert data == (folder / entry.filename).read_bytes()


@pytest.mark.parametrize("length", [1, 2, 31, 32, 33, 90])
def test_alignment_holds_whatever_the_names_and_sizes(length):
    raw = usdz_bytes([("a" * length, b"first" * length), ("b", b"second"), ("c" * 7, b"third")])
    assert [raw.index(word) % USDZ_ALIGNMENT for word in (b"first", b"second", b"third")] == [0, 0, 0]


def test_the_same_avatar_gives_the_same_bytes(folder, tmp_path):
    write_avatar(avatar_of(shaded_maps()), tmp_path, USD)
    for name in ("avatar.usdc", "avatar.usdz"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()

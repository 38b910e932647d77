"""The bake: scan conversion, tangent frames, and the round trip of a known material, normal and light."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from sira_assets.fields.analytic import EllipsoidHead, linear_material
from sira_assets.mesh.extract import ExtractConfig, extract_mesh
from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.simplify import simplify_mesh
from sira_assets.scene.sg_light import SGLight
from sira_assets.texture.atlas import Atlas, AtlasReport, vertex_of_uv
from sira_assets.texture.bake import BakeConfig, bake, fill_empty
from sira_assets.texture.raster import rasterise
from sira_assets.texture.tangents import from_tangent_space, tangents, to_tangent_space
from sira_assets.texture.unwrap import UnwrapConfig, unwrap

LIGHT = SGLight(
    np.array([[1.0, 1, 1], [-1, 0.5, 0.5]]), np.array([10.0, 3.0]), np.array([[3.0, 2.5, 2], [0.5, 0.7, 1]])
)
SIZE = 256


@dataclass(frozen=True)
class RippledHead:
    """An ellipsoid with ripples of 0.1 mm: finer than the triangles, coarser than the texels."""

    base: EllipsoidHead = EllipsoidHead()

    def sdf(self, x):
        return self.base.sdf(x) + 1e-4 * torch.sin(300 * x).sum(-1)

    def material(self, x):
        return linear_material(x)


@pytest.fixture(scope="module")
def baked():
    field = RippledHead()
    mesh = simplify_mesh(extract_mesh(field, ExtractConfig(cell_m=0.006)), 4000)
    atlas = unwrap(mesh, UnwrapConfig(methods=(), texture_size=SIZE))
    return field, mesh, atlas, bake(field, mesh, atlas, LIGHT, np.eye(4), BakeConfig(size=SIZE))


def random_atlas(seed, faces=60):
    rng = np.random.default_rng(seed)
    return rng.uniform(0, 1, (3 * faces, 2)), np.arange(3 * faces).reshape(-1, 3)


def look_up(texture, uv):
    """Bilinear reading at uv (origin bottom-left) of a picture whose row 0 is the top, as a viewer does."""
    size = len(texture)
    x, y = uv[:, 0] * size - 0.5, (1 - uv[:, 1]) * size - 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - i)[:, None], (y - j)[:, None]
    texture = texture.reshape(size, size, -1)
    at = lambda r, c: texture[np.clip(r, 0, size - 1), np.clip(c, 0, size - 1)]  # noqa: E731
    return (at(j, i) * (1 - fx) + at(j, i + 1) * fx) * (1 - fy) + (at(j + 1, i) * (1 - fx) + at(j + 1, i + 1) * fx) * fy


def surface_samples(mesh, atlas, count=4000):
    """Random points of the surface, their uv, and their corner weights and faces."""
    rng = np.random.default_rng(0)
    corners = mesh.vertices[mesh.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    face = rng.choice(len(area), count, p=area / area.sum())
    weights = rng.dirichlet(np.ones(3), count)
    point = (corners[face] * weights[..., None]).sum(1)
    return point, (atlas.uv[atlas.faces_uv[face]] * weights[..., None]).sum(1), weights, face


def test_samples_stand_where_their_texel_says():
    uv, faces = random_atlas(0)
    found = rasterise(uv, faces, 64, samples=4, first_row=0, last_row=64)
    point = (uv[faces[found.face]] * found.barycentric[..., None]).sum(1)
    centre = np.stack([(found.texel % 64 + 0.5) / 64, 1 - (found.texel // 64 + 0.5) / 64], 1)
    distance = np.linalg.norm(point - centre, axis=1) * 64
    # A sample is inside its texel; the nearest point of a face that touches a texel is at most half a diagonal away.
    assert distance.max() <= np.sqrt(0.5) + 1e-9


def test_two_triangles_of_a_square_fill_it_once():
    uv = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    found = rasterise(uv, np.array([[0, 1, 2], [0, 2, 3]]), 33, samples=3, first_row=0, last_row=33)
    assert len(found.face) == 33 * 33 * 9
    assert np.array_equal(np.bincount(found.texel), np.full(33 * 33, 9))


def test_every_touched_texel_is_covered_however_thin_the_face():
    rng = np.random.default_rng(1)
    for _ in range(20):
        ends = rng.uniform(0, 1, (2, 2))
        uv = np.vstack([ends, ends[:1] + 1e-7])
        found = rasterise(uv, np.array([[0, 1, 2]]), 40, samples=1, first_row=0, last_row=40)
        along = ends[0] + np.linspace(0, 1, 2000)[:, None] * (ends[1] - ends[0])
        walked = np.unique((np.floor((1 - along[:, 1]) * 40) * 40 + np.floor(along[:, 0] * 40)).astype(int))
        assert np.isin(walked, found.texel).all()


def test_faces_of_no_area_still_get_a_texel():
    uv = np.array([[0.31, 0.62]] * 3)
    found = rasterise(uv, np.array([[0, 1, 2]]), 10, samples=2, first_row=0, last_row=10)
    assert found.texel.tolist() == [3 * 10 + 3]


def test_bands_of_any_height_give_the_same_samples():
    uv, faces = random_atlas(2)
    whole = rasterise(uv, faces, 50, samples=2, first_row=0, last_row=50)
    for rows in (1, 7, 50):
        bands = [
            rasterise(uv, faces, 50, samples=2, first_row=r, last_row=min(r + rows, 50)) for r in range(0, 50, rows)
        ]
        key = np.lexsort((np.concatenate([b.face for b in bands]), np.concatenate([b.texel for b in bands])))
        order = np.lexsort((whole.face, whole.texel))
        assert np.array_equal(np.concatenate([b.texel for b in bands])[key], whole.texel[order])
        assert np.array_equal(np.concatenate([b.face for b in bands])[key], whole.face[order])


def test_tangents_are_unit_orthogonal_and_point_along_u(baked):
    _, mesh, atlas, _ = baked
    frame = tangents(mesh, atlas)
    normal = mesh.normals[vertex_of_uv(mesh, atlas)]
    assert np.abs(np.linalg.norm(frame[:, :3], axis=1) - 1).max() < 1e-9
    assert np.abs((frame[:, :3] * normal).sum(1)).max() < 1e-9
    assert set(frame[:, 3]) == {1.0}  # no chart is mirrored
    corner, uv = mesh.vertices[mesh.faces], atlas.uv[atlas.faces_uv]
    step = np.linalg.solve(
        np.stack([uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]], 1),
        np.stack([corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]], 1),
    )  # rows dp/du, dp/dv
    for row, vector in ((0, frame[:, :3]), (1, np.cross(normal, frame[:, :3]))):
        cosine = (step[:, row] * vector[atlas.faces_uv[:, 0]]).sum(1) / np.linalg.norm(step[:, row], axis=1)
        assert np.percentile(cosine, 2) > 0.8
    mirrored = Atlas(atlas.uv * [-1, 1] + [1, 0], atlas.faces_uv, atlas.report)
    assert set(tangents(mesh, mirrored)[:, 3]) == {-1.0}


def test_tangent_space_round_trip():
    rng = np.random.default_rng(3)
    normal, tangent, vector = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.standard_normal((3, 500, 3)))
    keep = np.abs((normal * tangent).sum(1)) < 0.9
    normal, tangent, vector = normal[keep], tangent[keep], vector[keep]
    hand = rng.choice([-1.0, 1.0], len(normal))
    back = from_tangent_space(to_tangent_space(vector, normal, tangent, hand), normal, tangent, hand)
    assert np.abs(back - vector).max() < 1e-9
    assert np.abs(to_tangent_space(normal, normal, tangent, hand) - [0, 0, 1]).max() < 1e-9


def test_a_linear_material_comes_back(baked):
    _, mesh, atlas, textures = baked
    point, uv, _, _ = surface_samples(mesh, atlas)
    diffuse, specular = linear_material(torch.tensor(point))
    # Bilinear reading is exact for a linear function inside a chart. What is left: 0.1 mm of ripple between mesh and
    # field, and at borders texels that average a part of themselves only, so up to half a texel (0.7 mm here) off.
    texel_m = np.sqrt(mesh_area(mesh) / atlas.report.utilisation) / SIZE
    error = np.abs(look_up(textures.diffuse, uv) - diffuse.numpy()).max(1)
    assert np.percentile(error, 50) < 0.15 * texel_m
    assert error.max() < 2.0 * texel_m
    specular_error = np.abs(look_up(textures.specular_f0, uv)[:, 0] - specular.numpy())
    assert specular_error.max() < 0.04 * 2.0 * texel_m  # its slope is 0.04 per metre


def mesh_area(mesh):
    corners = mesh.vertices[mesh.faces]
    return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()


def test_the_normal_map_carries_the_fields_detail(baked):
    field, mesh, atlas, textures = baked
    point, uv, weights, face = surface_samples(mesh, atlas)
    x = torch.tensor(point, dtype=torch.float32, requires_grad=True)
    (gradient,) = torch.autograd.grad(field.sdf(x).sum(), x)
    exact = torch.nn.functional.normalize(gradient, dim=-1).numpy()
    frame = tangents(mesh, atlas)[atlas.faces_uv[face]]
    normal, tangent = (
        (corner * weights[..., None]).sum(1) for corner in (mesh.normals[mesh.faces[face]], frame[..., :3])
    )
    shown = from_tangent_space(look_up(textures.normal_tangent, uv), normal, tangent, frame[:, 0, 3])
    degrees = np.degrees(np.arccos(np.clip((shown * exact).sum(1), -1, 1)))
    unit = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    without = np.degrees(np.arccos(np.clip((unit * exact).sum(1), -1, 1)))
    # Ripples turn the normal by up to 3 degrees and more; texels of 1.5 mm resolve their 21 mm waves to a few tenths.
    assert np.median(degrees) < 0.5 * np.median(without)
    assert np.median(degrees) < 0.5
    assert np.percentile(degrees, 95) < 2.5


def test_irradiance_is_the_lights_integral_over_the_hemisphere(baked):
    field, mesh, atlas, textures = baked
    point, uv, _, _ = surface_samples(mesh, atlas, 200)
    x = torch.tensor(point, dtype=torch.float32, requires_grad=True)
    (gradient,) = torch.autograd.grad(field.sdf(x).sum(), x)
    normal = torch.nn.functional.normalize(gradient, dim=-1).numpy()
    # Quadrature of our own: 40 000 directions of a Fibonacci sphere, error about 1e-3 for these broad lobes.
    k = np.arange(40000) + 0.5
    z, phi = 1 - 2 * k / 40000, np.pi * (1 + 5**0.5) * k
    direction = np.stack([np.sqrt(1 - z**2) * np.cos(phi), np.sqrt(1 - z**2) * np.sin(phi), z], 1)
    expected = (np.maximum(normal @ direction.T, 0) @ LIGHT.radiance(direction)) * (4 * np.pi / 40000)
    error = np.abs(look_up(textures.irradiance, uv) - expected) / expected.max()
    assert np.median(error) < 0.005
    # At borders a texel's normal is up to half a texel off: about 2 degrees on this curvature, 3 % of a lobe's peak.
    assert np.percentile(error, 95) < 0.03


def test_turning_the_world_turns_nothing_on_the_surface(baked):
    field, mesh, atlas, textures = baked
    turn = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    world_from_canonical = np.eye(4)
    world_from_canonical[:3, :3] = 1.3 * turn
    world_from_canonical[:3, 3] = (1.0, -2.0, 0.5)
    there = bake(field, mesh, atlas, LIGHT.rotated(turn), world_from_canonical, BakeConfig(size=SIZE))
    assert np.abs(there.irradiance - textures.irradiance).max() < 1e-4 * textures.irradiance.max()


@pytest.mark.parametrize("rows", [1000, 37])
def test_chunk_size_changes_nothing(baked, rows):
    field, mesh, atlas, _ = baked
    config = BakeConfig(size=96, samples=2)
    one, other = (bake(field, mesh, atlas, LIGHT, np.eye(4), replace(config, rows_per_chunk=r)) for r in (rows, 5))
    assert np.array_equal(one.coverage, other.coverage)
    # The same numbers in batches of another length: matrix products may round differently in the last bit.
    assert np.abs(one.diffuse - other.diffuse).max() < 1e-6
    assert np.abs(one.normal_tangent - other.normal_tangent).max() < 1e-4


def test_every_face_reaches_the_picture(baked):
    _, mesh, atlas, textures = baked
    centre = atlas.uv[atlas.faces_uv].mean(1)
    row, column = ((1 - centre[:, 1]) * SIZE).astype(int), (centre[:, 0] * SIZE).astype(int)
    assert len(row) == len(mesh.faces)
    assert textures.coverage[row, column].all()


def test_empty_texels_take_their_nearest_neighbours_value():
    coverage = np.zeros((9, 9), bool)
    coverage[2, 2] = coverage[6, 7] = True
    values = np.zeros((9, 9, 1))
    values[2, 2], values[6, 7] = 1.0, 2.0
    filled = fill_empty(values, coverage)[..., 0]
    assert filled[0, 0] == 1.0
    assert filled[8, 8] == 2.0
    assert set(np.unique(filled)) == {1.0, 2.0}


def test_points_that_cannot_reach_the_field_keep_the_meshs_normal():
    field = EllipsoidHead()
    mesh = extract_mesh(field, ExtractConfig(cell_m=0.01))
    away = mesh.transformed(np.diag([1.2, 1.2, 1.2, 1.0]))  # up to 20 mm off the zero set
    atlas = unwrap(away, UnwrapConfig(methods=(), texture_size=64))
    textures = bake(field, away, atlas, LIGHT, np.eye(4), BakeConfig(size=64))
    far = np.abs(field.sdf(torch.tensor(away.vertices)).numpy())
    assert far.min() > 0.004
    assert np.median(textures.normal_tangent[textures.coverage][:, 2]) > 0.9999
    assert Raycaster(away).closest(mesh.vertices).distance.min() > 0.003


def test_no_light_gives_a_black_irradiance_map(baked):
    field, mesh, atlas, _ = baked
    dark = SGLight(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))
    assert not bake(field, mesh, atlas, dark, np.eye(4), BakeConfig(size=32)).irradiance.any()


def test_an_atlas_of_another_mesh_is_refused(baked):
    field, mesh, atlas, _ = baked
    other = Atlas(atlas.uv, atlas.faces_uv[1:], AtlasReport("boxes", 1, 0.5, 0.0, 1.0))
    with pytest.raises(ValueError, match="unwrap this mesh"):
        bake(field, mesh, other, LIGHT, np.eye(4), BakeConfig(size=32))


def test_irradiance_is_shadowed_by_the_shares_given(baked):
    """Constant shares scale it; a share per lobe takes that lobe's light; the other maps are as without."""
    from sira_assets.render.visibility import SurfaceVisibility

    field, mesh, atlas, plain = baked
    half = SurfaceVisibility(mesh, np.full((len(mesh.vertices), 2), 0.5, np.float32))
    shadowed = bake(field, mesh, atlas, LIGHT, np.eye(4), BakeConfig(size=SIZE), shadows=half)
    np.testing.assert_allclose(shadowed.irradiance, 0.5 * plain.irradiance, rtol=1e-5)
    np.testing.assert_array_equal(shadowed.diffuse, plain.diffuse)
    first = SurfaceVisibility(mesh, np.tile(np.array([1.0, 0.0], np.float32), (len(mesh.vertices), 1)))
    one = bake(field, mesh, atlas, LIGHT, np.eye(4), BakeConfig(size=SIZE), shadows=first)
    alone = SGLight(LIGHT.axis[:1], LIGHT.sharpness[:1], LIGHT.amplitude[:1])
    expected = bake(field, mesh, atlas, alone, np.eye(4), BakeConfig(size=SIZE))
    np.testing.assert_allclose(one.irradiance, expected.irradiance, rtol=1e-5, atol=1e-6)

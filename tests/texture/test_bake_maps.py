"""The bake at borders and seams, and the maps that are made on request."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from sira_assets.errors import InputError
from sira_assets.fields.analytic import EllipsoidHead
from sira_assets.mesh.extract import ExtractConfig, extract_mesh
from sira_assets.mesh.simplify import simplify_mesh
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.numerics.sg import irradiance
from sira_assets.render.shading import shade
from sira_assets.render.visibility import SurfaceVisibility
from sira_assets.scene.canonical import transform_points
from sira_assets.scene.sg_light import SGLight
from sira_assets.texture.bake import BakeConfig, bake
from sira_assets.texture.raster import border_texels, rasterise
from sira_assets.texture.seams import find_seams
from sira_assets.texture.texture_set import MAPS, constant_map
from sira_assets.texture.unwrap import UnwrapConfig, unwrap

LIGHT = SGLight(np.array([[0, 0, 1.0], [1, 0, 0]]), np.array([8.0, 2.0]), np.array([[2.0, 2, 2], [0.3, 0.4, 0.5]]))
SIZE = 256
CUBE_M = 0.02
ROUGHNESS = 0.3


@dataclass(frozen=True)
class KnownHead:
    """An ellipsoid under a wave of 100 mm (red) and a checker of 20 mm cubes (green)."""

    base: EllipsoidHead = EllipsoidHead()

    def sdf(self, x):
        return self.base.sdf(x)

    def material(self, x):
        wave = 0.5 + 0.5 * torch.sin(2 * torch.pi / 0.1 * (x @ x.new_tensor([0.37, 0.74, -0.56])))
        checker = torch.remainder(torch.floor((x + 0.0013) / CUBE_M).sum(-1), 2.0)
        return torch.stack([wave, checker, 0.5 + x[:, 1]], -1), torch.full_like(wave, 0.04)


@pytest.fixture(scope="module")
def baked():
    field = KnownHead()
    mesh = simplify_mesh(extract_mesh(field, ExtractConfig(cell_m=0.008)), 2000)
    atlas = unwrap(mesh, UnwrapConfig(methods=(), texture_size=SIZE))
    world = np.array([[0, 0, 2.0, 1], [2, 0, 0, 2], [0, 2, 0, 3], [0, 0, 0, 1]])
    shadows = SurfaceVisibility(mesh, np.tile(np.array([0.5, 1.0], np.float32), (len(mesh.vertices), 1)))
    maps = bake(field, mesh, atlas, LIGHT, world, BakeConfig(SIZE, 3, MAPS), shadows=shadows, roughness=ROUGHNESS)
    return field, mesh, atlas, world, maps


def bilinear(texture, uv):
    size = len(texture)
    x, y = uv[:, 0] * size - 0.5, (1 - uv[:, 1]) * size - 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - i)[:, None], (y - j)[:, None]
    texture = texture.reshape(size, size, -1)
    at = lambda r, c: texture[np.clip(r, 0, size - 1), np.clip(c, 0, size - 1)]  # noqa: E731
    return (at(j, i) * (1 - fx) + at(j, i + 1) * fx) * (1 - fy) + (at(j + 1, i) * (1 - fx) + at(j + 1, i + 1) * fx) * fy


def both_sides(mesh, atlas):
    """uv of points on every seam, seen from both its charts."""
    sides = {}
    for face, face_uv in zip(mesh.faces.tolist(), atlas.faces_uv.tolist(), strict=True):
        for k in range(3):
            a, b = face[k], face[(k + 1) % 3]
            ends = (face_uv[k], face_uv[(k + 1) % 3])
            sides.setdefault((min(a, b), max(a, b)), []).append(ends if a < b else ends[::-1])
    pairs = np.array([ends for ends in sides.values() if len(ends) == 2 and ends[0] != ends[1]])
    t = np.array([0.1, 0.5, 0.9])[:, None, None]
    return [(atlas.uv[pairs[:, k, 0]] * (1 - t) + atlas.uv[pairs[:, k, 1]] * t).reshape(-1, 2) for k in (0, 1)]


def test_both_sides_of_a_seam_read_the_same(baked):
    _, mesh, atlas, _, maps = baked
    one, other = both_sides(mesh, atlas)
    assert len(one) > 300
    difference = np.abs(bilinear(maps.diffuse[..., :1], one) - bilinear(maps.diffuse[..., :1], other))
    # Bilinear reading itself is off by (2 pi / 100 mm)^2 / 2 / 8 of a texel squared: 2.4 mm texels, 0.003, either way.
    # Means over part of a texel, or copies of a neighbour, would be off by half the wave's slope: 0.04.
    assert np.percentile(difference, 99) < 0.006
    positions = bilinear(maps.position, one) - bilinear(maps.position, other)
    # Texels of 4.8 mm in this world's units: chord against arc of an ellipsoid of 0.2, 0.0048^2 / 8 / 0.15, twice.
    assert np.percentile(np.linalg.norm(positions, axis=1), 99) < 1e-4


def test_a_checker_is_right_but_for_the_texels_its_edges_cross(baked):
    field, mesh, atlas, world, maps = baked
    rng = np.random.default_rng(0)
    face = rng.integers(len(mesh.faces), size=20000)
    weights = rng.dirichlet(np.ones(3), len(face))[..., None]
    uv = (atlas.uv[atlas.faces_uv[face]] * weights).sum(1)
    row, column = ((1 - uv[:, 1]) * SIZE).astype(int), (uv[:, 0] * SIZE).astype(int)
    point = transform_points(np.linalg.inv(world), maps.position[row, column].astype(np.float64))
    wrong = np.abs(maps.diffuse[row, column, 1] - field.material(torch.tensor(point))[0][:, 1].numpy()) > 0.5
    to_edge = np.abs(np.mod((point + 0.0013) / CUBE_M + 0.5, 1.0) - 0.5).min(1) * CUBE_M
    corners = mesh.vertices[mesh.faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    texel_m = np.sqrt(area / atlas.report.utilisation) / SIZE
    assert (to_edge[wrong] <= texel_m).all()
    assert wrong.mean() < 0.1


def test_light_maps_are_the_shading_of_what_the_other_maps_say(baked):
    _, mesh, atlas, world, maps = baked
    rotation = world[:3, :3] / 2.0
    used = maps.coverage & (np.random.default_rng(0).random(maps.coverage.shape) < 0.05)
    # Along seams every map is evened on its own.
    seams = find_seams(mesh, atlas, SIZE)
    used[np.divmod(seams.texels[seams.weights != 0], SIZE)] = False
    assert used.sum() > 100
    np.testing.assert_allclose(maps.visibility, np.broadcast_to([0.5, 1.0], maps.visibility.shape), rtol=1e-6)
    point = transform_points(np.linalg.inv(world), maps.position[used].astype(np.float64))
    x = torch.tensor(point, requires_grad=True)
    (gradient,) = torch.autograd.grad(EllipsoidHead().sdf(x).sum(), x)
    normal = torch.nn.functional.normalize(gradient, dim=-1) @ torch.tensor(rotation.T)
    lobes = [torch.tensor(a) for a in (LIGHT.axis, LIGHT.sharpness, LIGHT.amplitude)]
    seen = torch.tensor(maps.visibility[used], dtype=torch.float64)
    expected = irradiance(normal, *lobes, visibility=seen).numpy()
    # Single precision along the way, and a position rounded to 1e-7 of it.
    np.testing.assert_allclose(maps.irradiance[used], expected, atol=2e-5 * expected.max())
    albedos = torch.tensor(maps.diffuse[used]).double(), torch.tensor(maps.specular_f0[used]).double()
    radiance = shade(normal, normal, *albedos, *lobes, roughness=ROUGHNESS, visibility=seen).radiance.numpy()
    np.testing.assert_allclose(maps.radiance[used], radiance, atol=2e-4 * radiance.max())


def test_a_convex_head_hides_nothing_from_itself_and_a_wall_half(baked):
    field, mesh, atlas, _, maps = baked
    # Facets of 8 mm hide slivers of the horizon from points just off them.
    assert maps.occlusion.min() > 0.97
    assert maps.occlusion[maps.coverage].mean() > 0.995
    wall = TriangleMesh(
        np.array([[-9, -9, 0.2], [9, -9, 0.2], [9, 9, 0.2], [-9, 9, 0.2]]), np.array([[0, 1, 2], [0, 2, 3]])
    )
    both = TriangleMesh(
        np.vstack([mesh.vertices, wall.vertices]), np.vstack([mesh.faces, wall.faces + len(mesh.vertices)])
    )
    config = BakeConfig(64, 1, ("occlusion", "position", "normal"))
    hidden = bake(field, mesh, atlas, LIGHT, np.eye(4), config, surface=both)
    # A wide wall before the face takes all of what the face looks at, (1 + n_z) / 2 of anyone's cosine-weighted sky.
    centre = np.array([0.0, -0.01, -0.07])
    outward = (hidden.position - centre) / np.array([0.075, 0.11, 0.095]) ** 2
    n_z = (outward / np.linalg.norm(outward, axis=-1, keepdims=True))[..., 2]
    error = np.abs(hidden.occlusion - (1 - n_z) / 2)[hidden.coverage]
    assert np.median(error) < 0.03  # 256 rays: 0.01; 8 mm facets
    assert hidden.diffuse is None
    assert hidden.irradiance is None


@pytest.mark.parametrize("shadowed", [True, False])
def test_a_light_without_lobes_has_maps_of_nothing(baked, shadowed):
    field, mesh, atlas, _, _ = baked
    dark = SGLight(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))
    shadows = SurfaceVisibility(mesh, np.ones((len(mesh.vertices), 0), np.float32)) if shadowed else None
    config = BakeConfig(64, 1, ("visibility", "radiance", "irradiance"))
    maps = bake(field, mesh, atlas, dark, np.eye(4), config, shadows=shadows)
    assert maps.visibility.shape == (64, 64, 0)
    assert not maps.radiance.any()
    assert not maps.irradiance.any()


def test_positions_lie_on_the_surface_in_the_world(baked):
    _, _, _, world, maps = baked
    point = transform_points(np.linalg.inv(world), maps.position.reshape(-1, 3).astype(np.float64))
    # 20 micrometres is the bake's own tolerance; ten times it where the last step falls short.
    assert np.abs(EllipsoidHead().sdf(torch.tensor(point)).numpy()).max() < 2e-4


@pytest.mark.parametrize("size", [63, 64, 65])
def test_no_row_is_dropped_around_the_chunk(baked, size):
    field, mesh, atlas, _, _ = baked
    config = BakeConfig(size, 2, ("diffuse", "position"))
    whole = bake(field, mesh, atlas, LIGHT, np.eye(4), replace(config, rows_per_chunk=size))
    parts = bake(field, mesh, atlas, LIGHT, np.eye(4), replace(config, rows_per_chunk=64))
    assert np.array_equal(whole.coverage, parts.coverage)
    assert whole.coverage[[0, -1]].any() == parts.coverage[[0, -1]].any()
    np.testing.assert_allclose(whole.position, parts.position, atol=1e-6)
    centre = atlas.uv[atlas.faces_uv].mean(1)
    row, column = ((1 - centre[:, 1]) * size).astype(int), (centre[:, 0] * size).astype(int)
    assert parts.coverage[row, column].all()  # every face touches its centre's texel


def test_border_texels_carry_the_plane_on():
    uv, faces = np.array([[0.31, 0.3], [0.7, 0.32], [0.5, 0.71]]), np.array([[0, 1, 2]])
    inner = np.zeros((32, 32), bool)
    found, nearest = border_texels(uv, faces, 32, samples=2, first_row=0, last_row=32, inner=inner, reach=1)
    at = found.barycentric @ uv
    centre = np.stack([(found.texel % 32 + 0.5) / 32, 1 - (found.texel // 32 + 0.5) / 32], 1)
    # Four samples a texel, a quarter of a texel from its centre along each axis: also where no face is.
    np.testing.assert_allclose(np.abs(at - centre), 0.25 / 32, atol=1e-12)
    assert found.barycentric.min() < 0
    assert nearest.min() >= 0
    touched = np.unique(rasterise(uv, faces, 32, samples=2, first_row=0, last_row=32).texel)
    assert np.isin(touched, found.texel).all()
    grown = np.zeros((34, 34), bool)
    for dr in (0, 1, 2):
        for dc in (0, 1, 2):
            grown[touched // 32 + dr, touched % 32 + dc] = True
    # All that bilinear reading anywhere on the face can meet; touched texels and their eight neighbours hold it.
    ring = np.zeros(32 * 32, bool)
    ring[found.texel] = True
    assert not (ring.reshape(32, 32) & ~grown[1:33, 1:33]).any()
    x, y = (at[(found.barycentric >= 0).all(1)] * 32 - 0.5).T
    for r, c in ((0, 0), (0, 1), (1, 0), (1, 1)):
        assert ring[(31 - (np.floor(y).astype(int) + r)) * 32 + np.floor(x).astype(int) + c].all()


def test_constant_maps_become_factors():
    covered = np.ones((4, 4), bool)
    covered[0, 0] = False
    flat = np.full((4, 4, 3), 0.4)
    flat[0, 0] = 9.0  # not on the atlas
    flat[1, 1, 0] += 1 / 255
    found = constant_map(flat, covered)
    np.testing.assert_allclose(found.value, [0.4 + 0.5 / 255, 0.4, 0.4], atol=1e-9)
    flat[2, 2, 0] -= 1 / 255
    assert constant_map(flat, covered) is None


def test_unknown_maps_are_refused():
    with pytest.raises(InputError, match="maps among diffuse"):
        BakeConfig(maps=("diffuse", "bump"))

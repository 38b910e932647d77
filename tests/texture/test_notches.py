"""Where a texel would show what is far apart: known answers, and none left in an atlas."""

import numpy as np
import pytest

from sira_assets.fields.fitted import FittedHead
from sira_assets.fields.prior import load_prior
from sira_assets.mesh.extract import ExtractConfig, extract_mesh
from sira_assets.texture.atlas import chart_labels, furthest_apart
from sira_assets.texture.notches import faces_at_notches, squeezed_faces
from sira_assets.texture.unwrap import UnwrapConfig, unwrap

LOWER_BANK, UPPER_BANK = 1, 2


def two_banks(gap, lift):
    """Two strips ten long and one wide that hang together on the left, `gap` apart; the upper's end lifted."""
    top = 1.0 + gap
    uv = np.array(
        [[-1, 0], [0, 0], [10, 0], [10, 1], [0, 1], [0, top], [10, top], [10, top + 1], [0, top + 1], [-1, top + 1]],
        float,
    )
    faces = np.array([[1, 2, 3], [1, 3, 4], [5, 6, 7], [5, 7, 8], [0, 1, 4], [0, 4, 5], [0, 5, 8], [0, 8, 9]], np.int64)
    vertices = np.column_stack([uv, np.zeros(len(uv))])
    vertices[[6, 7], 2] = lift
    return uv, vertices, faces


@pytest.mark.parametrize(
    ("gap", "lift", "texel", "notch"),
    [
        (0.5, 8.0, 1.0, True),
        (0.5, 0.0, 1.0, False),  # a slit: what is near in the picture is near on the surface
        (3.0, 8.0, 1.0, False),  # wide enough for a texel of its own on either bank
        (3.0, 8.0, 4.0, False),  # not for one of four, but within three of them a reading is wrong by less
        (0.5, 8.0, 0.1, False),
    ],
)
def test_a_gap_narrower_than_a_texel_between_distant_banks(gap, lift, texel, notch):
    uv, vertices, faces = two_banks(gap, lift)
    found = faces_at_notches(uv, faces, vertices, faces, texel)
    assert found.any() == notch
    if notch:
        assert set(np.flatnonzero(found)) <= {LOWER_BANK, UPPER_BANK}
        # Behind the bank that was taken lies a narrow triangle, which is the next; then the gap is wide open.
        for _ in range(2):
            faces = faces[~found]
            found = faces_at_notches(uv, faces, vertices, faces, texel)
        assert not found.any()


def test_charts_that_lie_over_each_other_are_not_compared():
    uv, vertices, faces = two_banks(0.5, 8.0)
    alone = faces[[UPPER_BANK, 3]]
    other = faces[[0, LOWER_BANK]]
    both = np.concatenate([alone, other])
    assert not faces_at_notches(uv, both, vertices, both, 1.0).any()


@pytest.mark.parametrize(("across", "squeezed"), [(0.5, False), (0.34, False), (0.33, True), (1e-9, True), (0.0, True)])
def test_a_face_squeezed_to_a_needle(across, squeezed):
    vertices = np.array([[0, 0, 0], [7.0, 0, 0], [7.0, 5.0, 0]])
    faces = np.array([[0, 1, 2]])
    assert squeezed_faces(vertices[:, :2] * [1.0, across], faces, vertices, faces).tolist() == [squeezed]


def test_how_far_a_unit_of_the_picture_reaches_is_the_greatest_of_all_directions():
    rng = np.random.default_rng(0)
    vertices, uv, faces = rng.normal(size=(60, 3)), rng.normal(size=(60, 2)), np.arange(60).reshape(-1, 3)
    turned = np.linspace(0, np.pi, 20001)
    directions = np.stack([np.cos(turned), np.sin(turned)])
    for face, found in zip(faces, furthest_apart(vertices, faces, uv, faces), strict=True):
        x, p = vertices[face], uv[face]
        jacobian = np.stack([x[1] - x[0], x[2] - x[0]], 1) @ np.linalg.inv(np.stack([p[1] - p[0], p[2] - p[0]], 1))
        reached = np.linalg.norm(jacobian @ directions, axis=0).max()
        # The nearest of 20000 directions is 8e-5 off the greatest one: less by 3e-9 at most.
        assert found == pytest.approx(reached, rel=1e-8)


def border_points(mesh, atlas):
    """Points four to a border edge, in uv and on the surface, and their charts: the slow way."""
    owners = {}
    for face, (a, b, c) in enumerate(atlas.faces_uv.tolist()):
        for corner, edge in enumerate(((a, b), (b, c), (c, a))):
            owners.setdefault(tuple(sorted(edge)), []).append((face, corner))
    alone = np.array([edges[0] for edges in owners.values() if len(edges) == 1])
    face, corner = alone.T
    after = (corner + 1) % 3
    t = np.linspace(0, 1, 5)[:, None, None]
    uv = [atlas.uv[atlas.faces_uv[face, k]] for k in (corner, after)]
    x = [mesh.vertices[mesh.faces[face, k]] for k in (corner, after)]
    chart = np.tile(chart_labels(atlas.faces_uv, len(atlas.uv))[atlas.faces_uv[face, 0]], 5)
    return *((a + t * (b - a)).reshape(-1, a.shape[1]) for a, b in (uv, x)), chart, np.tile(face, 5)


@pytest.mark.parametrize("method", ["uvatlas", "xatlas", "boxes"])
def test_an_atlas_has_none(method):
    prior = load_prior()
    head = FittedHead(prior.shape, prior.appearance, prior.z_sdf.mean, prior.z_a.mean, prior.z_s.mean)
    mesh = extract_mesh(head, ExtractConfig(cell_m=0.009))
    atlas = unwrap(mesh, UnwrapConfig(texture_size=512, methods=(method,)))
    uv, x, chart, face = border_points(mesh, atlas)
    corners = mesh.vertices[mesh.faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    texel = np.sqrt(area / atlas.report.utilisation) / 512
    apart = 0.0
    for k in range(len(uv)):
        near = (np.linalg.norm(uv - uv[k], axis=1) * 512 < 1.0) & (chart == chart[k]) & (face != face[k])
        apart = max(apart, np.linalg.norm(x[near] - x[k], axis=1).max(initial=0.0) / texel)
    assert furthest_apart(mesh.vertices, mesh.faces, atlas.uv, atlas.faces_uv).max() / 512 < 4.0 * texel
    # Three texels are allowed, of the size foreseen before packing; what UVAtlas and xatlas give alone has 5 and 8.
    assert apart < 4.0

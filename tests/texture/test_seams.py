"""Maps read the same on both sides of a seam."""

from dataclasses import replace

import numpy as np
import pytest

from sira_assets.fields.analytic import EllipsoidHead
from sira_assets.mesh.extract import ExtractConfig, extract_mesh
from sira_assets.texture.seams import even_seams, find_seams, seam_edges
from sira_assets.texture.unwrap import UnwrapConfig, unwrap

SIZE = 128


@pytest.fixture(scope="module")
def unwrapped():
    mesh = extract_mesh(EllipsoidHead(), ExtractConfig(cell_m=0.016))
    return mesh, unwrap(mesh, UnwrapConfig(texture_size=SIZE, methods=()))


def read(texture, uv):
    """Bilinear reading, one point at a time, by the definition."""
    out = []
    for u, v in uv:
        x, y = u * SIZE - 0.5, (1 - v) * SIZE - 0.5
        value = 0.0
        for row in range(SIZE):
            if abs(row - y) < 1:
                for column in range(SIZE):
                    if abs(column - x) < 1:
                        value = value + (1 - abs(row - y)) * (1 - abs(column - x)) * texture[row, column]
        out.append(value)
    return np.array(out)


def test_both_ends_of_a_seam_edge_are_the_same_points_of_the_surface(unwrapped):
    mesh, atlas = unwrapped
    one, other = seam_edges(mesh, atlas)
    place = {
        tuple(uv): mesh.vertices[v]
        for face, fuv in zip(mesh.faces, atlas.faces_uv, strict=True)
        for v, uv in zip(face, atlas.uv[fuv], strict=True)
    }
    assert len(one) > 10
    for a, b in zip(one.reshape(-1, 2), other.reshape(-1, 2), strict=True):
        np.testing.assert_array_equal(place[tuple(a)], place[tuple(b)])


def test_a_map_of_noise_reads_the_same_on_both_sides(unwrapped):
    mesh, atlas = unwrapped
    noise = np.random.default_rng(0).random((SIZE, SIZE, 2), np.float32)
    even = even_seams(noise, find_seams(mesh, atlas, SIZE))
    one, other = seam_edges(mesh, atlas)
    rng = np.random.default_rng(1)
    edges = rng.choice(len(one), 60)
    t = rng.random((60, 1))
    a, b = (side[edges, 0] + t * (side[edges, 1] - side[edges, 0]) for side in (one, other))
    before = np.abs(read(noise, a) - read(noise, b))
    after = np.abs(read(even, a) - read(even, b))
    assert before.mean() > 0.2
    # At the points themselves TOLERANCE is left; between two of them, half a texel apart, what the product of two
    # linear functions rises above its chord: (1/4)^2 of the noise's second difference, which evening has made small.
    assert after.mean() < before.mean() / 30
    assert np.percentile(after, 95) < 0.03
    assert even.min() >= noise.min()
    assert even.max() <= noise.max()


def test_texels_that_no_seam_reads_are_left_alone(unwrapped):
    mesh, atlas = unwrapped
    noise = np.random.default_rng(2).random((SIZE, SIZE, 3), np.float32)
    seams = find_seams(mesh, atlas, SIZE)
    even = even_seams(noise, seams)
    away = np.ones(SIZE * SIZE, bool)
    away[seams.texels[np.abs(seams.weights) > 0]] = False
    assert 0.1 < away.mean() < 0.95
    np.testing.assert_array_equal(even.reshape(-1, 3)[away], noise.reshape(-1, 3)[away])


@pytest.mark.parametrize("value", [0.0, 0.3, 40.0])
def test_a_map_that_agrees_already_is_the_very_same(unwrapped, value):
    mesh, atlas = unwrapped
    flat = np.full((SIZE, SIZE), value, np.float32)
    assert even_seams(flat, find_seams(mesh, atlas, SIZE)) is flat


def test_readings_are_weighted_means(unwrapped):
    mesh, atlas = unwrapped
    seams = find_seams(mesh, atlas, SIZE)
    np.testing.assert_allclose(seams.weights[:, :4].sum(1), 1.0, atol=1e-12)
    np.testing.assert_allclose(seams.weights[:, 4:].sum(1), -1.0, atol=1e-12)
    none = replace(seams, texels=seams.texels[:0], weights=seams.weights[:0])
    noise = np.random.default_rng(3).random((SIZE, SIZE), np.float32)
    assert even_seams(noise, none) is noise


def test_no_texel_leaves_what_its_seam_points_show(unwrapped):
    """A picture of edges: evening moves no edge further than the texels that one reading takes in."""
    mesh, atlas = unwrapped
    row, column = np.indices((SIZE, SIZE))
    checker = ((row // 7 + column // 7) % 2).astype(np.float32)
    seams = find_seams(mesh, atlas, SIZE)
    even = even_seams(checker, seams).reshape(-1)
    checker, read_by = checker.reshape(-1), np.abs(seams.weights) > 0
    alike = np.array([len(set(checker[t[w]])) == 1 for t, w in zip(seams.texels, read_by, strict=True)])
    # Texels all of whose readings, on both sides, are of one colour.
    mixed = np.zeros(SIZE * SIZE, bool)
    mixed[seams.texels[~alike][read_by[~alike]]] = True
    plain = np.setdiff1d(seams.texels[read_by], np.flatnonzero(mixed))
    assert len(plain) > 100
    assert (even != checker).sum() > 100
    # One tolerance either way, at most 0.5 / 255.
    np.testing.assert_allclose(even[plain], checker[plain], atol=0.5 / 255)

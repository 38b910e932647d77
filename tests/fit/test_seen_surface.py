"""Which surface the photo says nothing of."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from ball_prior import ball_prior
from small_portrait import portrait

from sira_assets.fit.geometry import GeometryFitConfig, fit_geometry
from sira_assets.fit.seen_surface import _unseen, hidden_surface
from sira_assets.scene.canonical import transform_points

TO_CAMERA = np.array([0.0, 0.0, 1.0])


def point_at(p, row, column, depth=1.0):
    """The canonical point that this pixel sees at this depth (the camera's unit)."""
    k = p.camera.intrinsics
    seen = np.array([(column + 0.5 - k[0, 2]) / k[0, 0], (row + 0.5 - k[1, 2]) / k[1, 1], 1.0]) * depth
    world = transform_points(p.camera.world_from_camera, seen[None])
    return transform_points(p.canonical_from_world, world)


def unseen(p, row, column, normal=TO_CAMERA, depth=1.0):
    away, beside = _unseen(p, point_at(p, row, column, depth), np.asarray(normal)[None])
    return bool(away[0]), bool(beside[0])


def test_a_pixel_of_the_mask_sees_what_faces_it():
    p = portrait()
    assert unseen(p, 45, 48) == (False, False)
    assert unseen(p, 45, 48, -TO_CAMERA) == (True, False)
    assert unseen(p, 45, 48, 0.0 * TO_CAMERA) == (False, False)  # no direction: nothing to doubt it by


@pytest.mark.parametrize(("row", "column"), [(45, 5), (3, 48), (200, 48), (45, -900)])
def test_beside_the_mask_and_beyond_the_picture_nothing_is_seen(row, column):
    assert unseen(portrait(), row, column) == (False, True)


def test_behind_the_camera_nothing_is_seen():
    assert unseen(portrait(), 45, 48, depth=-1.0)[1]


def test_a_hole_is_bridged_and_the_masks_edge_has_room():
    p = portrait()
    mask = p.mask.copy()
    mask[40:44, 46:50] = False
    assert unseen(replace(p, mask=mask), 42, 48) == (False, False)
    left = int(np.flatnonzero(p.mask[45])[0])
    assert [unseen(p, 45, left - k)[1] for k in (1, 2, 3, 4)] == [False, False, True, True]


def test_hidden_points_are_on_both_sides_of_the_head():
    p = portrait()
    fit = fit_geometry(
        p, ball_prior(), GeometryFitConfig(steps_appearance=1, steps_codes=1, steps_networks=1, steps_cover=0)
    )
    x_ref, gamma = hidden_surface(p, fit, torch.Generator().manual_seed(0), count=500)
    assert len(x_ref) == len(gamma) == 500
    # Most of the ball's back, and of its front what this mask, narrower than the ball, leaves out.
    behind = x_ref[:, 2] < 0
    assert 0.5 < float(behind.float().mean()) < 1.0

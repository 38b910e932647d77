"""A reduced portrait shows the same head through the same camera."""

from dataclasses import replace

import numpy as np
import pytest

from sira_assets.errors import InputError
from sira_assets.pipeline import run, settings_for
from sira_assets.scene.camera import Camera
from sira_assets.scene.portrait import Portrait
from sira_assets.scene.reduce import reduced


def portrait(width=130, height=101):
    k = np.array([[1.6 * width, 0.0, width / 2], [0.0, 1.6 * width, height / 2], [0.0, 0.0, 1.0]])
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 1.0
    rows, columns = np.mgrid[:height, :width]
    mask = (rows / height - 0.5) ** 2 + (columns / width - 0.5) ** 2 < 0.1
    ramp = np.stack([columns, rows, rows + columns], -1).astype(np.float32)
    return Portrait(ramp, mask, Camera(k, pose, width, height), np.eye(4), ramp[..., 0] == 64)


@pytest.mark.parametrize("side", [16, 33, 65, 100])
def test_rays_pictures_and_masks_stay_where_they_were(side):
    whole = portrait()
    small = reduced(whole, side)
    k = -(-130 // side)
    assert max(small.mask.shape) <= side
    # The middle of a block is seen along the same ray, and a ramp's mean is its value there.
    centres = np.array([[k * 2.5, k * 3.5]])
    _, expected = whole.camera.rays_world(centres)
    _, found = small.camera.rays_world(centres / k)
    assert found == pytest.approx(expected, abs=1e-12)
    block = small.image_linear[3, 2, :2]
    assert block == pytest.approx([2 * k + (k - 1) / 2, 3 * k + (k - 1) / 2], rel=1e-6)
    # A mask's area is kept but for its border, two pixels wide.
    assert small.mask.mean() == pytest.approx(
        whole.mask[: small.mask.shape[0] * k].mean(), abs=4 / min(small.mask.shape)
    )
    # A block with one clipped pixel is too dark for its mean to be used.
    assert small.saturated[:, 64 // k].all()
    assert small.saturated.sum() == small.mask.shape[0]


def test_a_small_portrait_is_left_alone_and_none_too_small_is_made():
    whole = portrait()
    assert reduced(whole, 130) is whole
    with pytest.raises(InputError, match="16"):
        reduced(whole, 15)


def test_what_was_read_is_said():
    assert reduced(portrait(), 65).warnings == ("the photo of 130 x 101 pixels was read at 65 x 50",)
    assert reduced(portrait(), 130).warnings == ()


def test_the_journey_reads_no_more_than_the_largest_photo():
    class Enough(Exception):
        pass

    def stop(name, function, *arguments, **options):
        if name == "load prior":
            return function(*arguments, **options)
        raise Enough(name, arguments[0])

    with pytest.raises(Enough) as found:
        run(portrait(), replace(settings_for("draft"), largest_photo=65), runner=stop)
    name, seen = found.value.args
    assert (name, seen.mask.shape) == ("fit geometry", (50, 65))
    assert len(seen.warnings) == 1

"""Cameras of an asset, turns, backgrounds, and movies on disk."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest
from assets import ball, camera, constant, material
from PIL import Image

from sira_assets.errors import InputError
from sira_assets.numerics.colour import linear_from_srgb, srgb_from_linear
from sira_assets.relight import movie
from sira_assets.relight.cameras import (
    framing_camera,
    head_axes,
    orbit_centre,
    orbited,
    portrait_camera,
    rotation_about,
    up_axis,
    with_longest_side,
)
from sira_assets.relight.frame import Backdrop, encode_frame, linear_rgba
from sira_assets.relight.render import render_asset
from sira_assets.relight.turntable import Frame, Quality, Turn, render_turn
from sira_assets.scene.envmap import EnvironmentMap, lat_long_directions
from sira_assets.scene.sg_light import SGLight

QUICK = Quality(1, 16)


def extras_of(c) -> dict:
    return {
        "camera": {
            "intrinsics": c.intrinsics.tolist(),
            "world_from_camera": c.world_from_camera.tolist(),
            "width": c.width,
            "height": c.height,
        }
    }


def test_the_portraits_camera_comes_out_of_the_extras():
    said = camera(40)
    found, own = portrait_camera(ball(extras=extras_of(said)))
    assert own
    assert np.array_equal(found.intrinsics, said.intrinsics)
    twice, _ = portrait_camera(ball(extras=extras_of(said)), size=80)
    assert (twice.width, twice.height) == (80, 80)
    assert twice.project(np.array([[0.02, 0.03, 0.0]]))[0] == pytest.approx(
        2 * said.project(np.array([[0.02, 0.03, 0.0]]))[0]
    )
    broken = extras_of(said)
    broken["camera"]["intrinsics"] = [[1, 2], [3, 4]]
    with pytest.raises(InputError):
        portrait_camera(ball(extras=broken))
    with pytest.raises(InputError, match=r"extras\.camera"):
        portrait_camera(ball(extras={"camera": {"width": 3}}))


@pytest.mark.parametrize("turn", [np.eye(3), rotation_about([1, 2, 0.5], 130.0)])
def test_framing_shows_all_of_the_asset_from_the_front(turn):
    """In whichever world the head stands: the canonical axes say where its front is."""
    canonical = np.eye(4)
    canonical[:3, :3] = 1.3 * turn.T
    model = ball(level=3, extras={"canonical_from_world": canonical.tolist()})
    model = replace(model, vertices=model.vertices * [1, 2, 1] @ turn.T)
    framed, own = portrait_camera(model, size=100)
    assert not own
    pixels, depth = framed.project(model.vertices)
    assert depth.min() > 0
    assert pixels.min() == pytest.approx(4.0, abs=0.1)  # 8 % of 100 pixels around, half on each side
    assert pixels.max() == pytest.approx(96.0, abs=0.1)
    top, _ = framed.project((turn @ [0, 0.2, 0])[None])
    front = turn @ [0, 0, 1]
    assert top[0, 1] < 10  # up is up
    assert framed.world_from_camera[:3, 2] @ front == pytest.approx(-1.0)
    assert head_axes(model) @ turn == pytest.approx(np.eye(3), abs=1e-12)


def test_up_is_the_worlds_axis_nearest_to_the_heads():
    tilted = np.eye(4)
    tilted[:3, :3] = rotation_about([1, 0, 0], 20.0)
    assert up_axis(ball(extras={"canonical_from_world": tilted.tolist()})).tolist() == [0, 1, 0]
    flipped = np.diag([1.0, -1, -1, 1])  # a world with OpenCV's axes
    assert up_axis(ball(extras={"canonical_from_world": flipped.tolist()})).tolist() == [0, -1, 0]
    with pytest.raises(InputError, match="similarity"):
        up_axis(ball(extras={"canonical_from_world": np.diag([1.0, 2, 1, 1]).tolist()}))


def test_an_orbit_keeps_its_distance_and_closes():
    centre, up = np.array([0.1, 0.2, 0.3]), np.array([0.0, 1.0, 0.0])
    start = camera()
    for degrees in (30.0, 180.0):
        there = orbited(start, centre, up, degrees)
        assert np.linalg.norm(there.centre_world - centre) == pytest.approx(np.linalg.norm(start.centre_world - centre))
        assert there.project(centre[None])[0] == pytest.approx(start.project(centre[None])[0], abs=1e-9)
    assert orbited(start, centre, up, 360.0).world_from_camera == pytest.approx(start.world_from_camera, abs=1e-12)
    # from +Z towards +X
    assert orbited(start, np.zeros(3), up, 90.0).centre_world == pytest.approx([1.0, 0.0, 0.0], abs=1e-12)
    assert orbit_centre(ball(level=3)) == pytest.approx(np.zeros(3), abs=1e-9)


def test_longest_side():
    wide = replace(camera(), width=96)
    assert (with_longest_side(wide, 48).width, with_longest_side(wide, 48).height) == (48, 24)
    assert with_longest_side(wide, None) is wide


def test_a_turning_light_is_the_light_turned():
    light = SGLight([[0.2, 0.1, 1.0]], [20.0], [[1.0, 0.8, 0.6]])
    frames = list(render_turn(ball(level=3), camera(24), light, Turn(4), QUICK, shadows=False))
    assert len(frames) == 4
    for i, frame in enumerate(frames):
        alone = render_asset(
            ball(level=3), camera(24), light.rotated(rotation_about([0, 1, 0], 90.0 * i)), shadows=False, supersample=1
        )
        assert np.array_equal(frame.render.radiance, alone.radiance)


def test_an_orbit_round_a_ball_sees_its_light_go_the_other_way():
    """Camera by +90 degrees is the light by -90 degrees, for a body of revolution."""
    light = SGLight([[0.0, 0.1, 1.0]], [20.0], [[1.0, 0.8, 0.6]])
    orbit = list(render_turn(ball(level=5), camera(24), light, Turn(4, "camera"), QUICK, shadows=False))
    turned = list(render_turn(ball(level=5), camera(24), light, Turn(4, "light"), QUICK, shadows=False))
    inside = (orbit[1].render.alpha == 1) & (turned[3].render.alpha == 1)
    # facets of the ball lie elsewhere in the two
    assert np.abs(orbit[1].render.radiance - turned[3].render.radiance)[inside].max() < 5e-3


def test_progress_ends_at_the_number_of_frames_and_never_falls():
    said = []
    list(render_turn(ball(level=3), camera(16), constant(), Turn(3), QUICK, shadows=True, report=said.append))
    assert said[-1] == 3
    assert (np.diff(said) >= 0).all()


def frame_of(made, at=None, rotation=None) -> Frame:
    return Frame(made, at or camera(), np.eye(3) if rotation is None else rotation)


def test_backgrounds_lie_behind():
    made = render_asset(ball(material(base=(0.2, 0.3, 0.4), weight=0.0)), camera(), constant(), shadows=False)
    inside, outside = made.alpha == 1, made.alpha == 0
    expected = np.round(255 * srgb_from_linear(np.array([0.2, 0.3, 0.4])))
    black, grey = (encode_frame(frame_of(made), Backdrop(c)) for c in (0.0, 0.5))
    assert (black[inside] == expected).all()
    assert (black[outside] == 0).all()
    assert (grey[outside] == round(255 * float(srgb_from_linear(np.array(0.5))))).all()
    brighter = encode_frame(frame_of(made), Backdrop(0.0), exposure=1.0)
    assert (brighter[inside] == np.round(255 * srgb_from_linear(np.array([0.4, 0.6, 0.8])))).all()
    clear = encode_frame(frame_of(made))
    assert clear.shape[2] == 4
    assert (clear[outside, 3] == 0).all()
    # straight colours: the rim is as bright as the inside
    rim = (made.alpha > 0.2) & (made.alpha < 1)
    assert rim.any()
    assert (clear[rim, :3] == expected).all()
    again = linear_rgba(made)
    assert np.array_equal(again[..., :3], made.radiance)


def test_a_panorama_behind_turns_with_its_light():
    height = 64
    directions = lat_long_directions(height)
    # radiance that is a smooth function of direction, so that bilinear sampling errs by a level at most
    panorama = EnvironmentMap((0.3 + 0.2 * directions).astype(np.float32))
    made = render_asset(ball(), camera(distance=1.0, focal=1.0), constant(0.0), shadows=False)
    away = made.alpha == 0
    for degrees in (0.0, 90.0):
        turn = rotation_about([0, 1, 0], degrees)
        shown = encode_frame(frame_of(made, camera(focal=1.0), turn), Backdrop(panorama=panorama))
        rays = camera(focal=1.0).rays_world()[1] @ turn  # where they looked before the turn
        expected = 255 * srgb_from_linear(0.3 + 0.2 * rays.reshape(48, 48, 3))
        assert np.abs(shown[away] - expected[away]).max() < 1.5


def test_webp_holds_every_frame(tmp_path):
    frames = [np.full((20, 30, 3), 40 * i, np.uint8) for i in range(5)]
    movie.write_movie(tmp_path / "turn.webp", frames, fps=10)
    with Image.open(tmp_path / "turn.webp") as read:
        assert read.n_frames == 5
        assert read.size == (30, 20)
        read.seek(3)
        # lossy, but of one colour
        assert np.abs(np.asarray(read.convert("RGB"), int) - 120).max() <= 3
        assert read.info["duration"] == 100
    assert [p.name for p in tmp_path.iterdir()] == ["turn.webp"]


def test_mp4_without_ffmpeg_says_what_is_missing(tmp_path, monkeypatch):
    monkeypatch.setattr(movie, "ffmpeg", lambda: None)
    with pytest.raises(InputError, match=r"ffmpeg.*\.webp"):
        movie.write_movie(tmp_path / "turn.mp4", [np.zeros((8, 8, 3), np.uint8)])
    with pytest.raises(InputError, match=r"\.webp or \.mp4"):
        movie.write_movie(tmp_path / "turn.gif", [np.zeros((8, 8, 3), np.uint8)])
    assert not list(tmp_path.iterdir())


def test_an_mp4_of_transparent_frames_lies_over_black(tmp_path, monkeypatch):
    given = []

    def take(command, *, stdin, **options):
        given.append(np.frombuffer(stdin.read(), np.uint8))
        return subprocess.CompletedProcess(command, 0, b"", b"")

    monkeypatch.setattr(movie, "ffmpeg", lambda: "ffmpeg")
    monkeypatch.setattr(movie.subprocess, "run", take)
    made = render_asset(ball(material(base=(0.2, 0.3, 0.4))), camera(), constant(), shadows=False)
    clear, black = (encode_frame(frame_of(made), backdrop) for backdrop in (Backdrop(), Backdrop(0.0)))
    movie.write_movie(tmp_path / "turn.mp4", [clear, black])
    over, plain = np.split(given[0].astype(int), 2)
    assert np.array_equal(plain, black.ravel())
    # Straight colour and alpha were rounded on their own.
    assert np.abs(over - plain).max() <= 1


def test_mp4_by_ffmpeg(tmp_path):
    if movie.ffmpeg() is None:
        pytest.skip("no ffmpeg on this machine")
    frames = [np.full((21, 30, 3), 40 * i, np.uint8) for i in range(5)]  # an odd height, which H.264 does not take
    for name in ("a", "b"):
        movie.write_movie(tmp_path / f"{name}.mp4", frames, fps=10)
    data = (tmp_path / "a.mp4").read_bytes()
    assert data[4:8] == b"ftyp"
    assert data == (tmp_path / "b.mp4").read_bytes()


def test_grey_is_half_of_srgb():
    from sira_assets.relight.frame import GREY

    assert float(linear_from_srgb(np.array(0.5))) == GREY
    assert framing_camera(ball(level=3), 64).width == 64

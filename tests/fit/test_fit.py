"""The two fits on a prior that is a ball, the fits kept on disk, and the whole journey in small."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from ball_prior import ball_prior
from small_portrait import portrait

from sira_assets import delivery, pipeline
from sira_assets.errors import InputError
from sira_assets.fields.fitted import RefinementConfig
from sira_assets.fields.head_field import BOUNDS_M
from sira_assets.fields.mlp import UNIT_M
from sira_assets.fit.appearance import fit_appearance, unlit_head
from sira_assets.fit.appearance_losses import AppearanceFitConfig
from sira_assets.fit.geometry import GeometryFitConfig, fit_geometry
from sira_assets.fit.pixels import mask_rays
from sira_assets.mesh.extract import ExtractConfig, extract_mesh
from sira_assets.render.tracing import sphere_trace
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M, transform_points
from sira_assets.texture.bake import BakeConfig
from sira_assets.texture.unwrap import UnwrapConfig

GEOMETRY = GeometryFitConfig(
    steps_appearance=4,
    steps_codes=6,
    steps_networks=4,
    steps_cover=2,
    pool=300,
    band_pool=100,
    rays=60,
    band_rays=40,
)
APPEARANCE_FIT = AppearanceFitConfig(
    steps_light=4,
    steps_albedo=4,
    steps_specular=4,
    steps_refinement=4,
    pixels=200,
    refinement=RefinementConfig(width=16, waves=8),
)
SETTINGS = pipeline.Settings(
    "tiny",
    GEOMETRY,
    APPEARANCE_FIT,
    ExtractConfig(cell_m=0.01),
    max_triangles=800,
    unwrap=UnwrapConfig(texture_size=64, methods=()),
    bake=BakeConfig(size=64, samples=1),
)


def test_the_reference_is_never_changed_and_a_given_pose_is_kept():
    prior, p = ball_prior(), portrait()
    fit = fit_geometry(p, prior, GEOMETRY)
    for a, b in zip(prior.shape.reference.parameters(), fit.shape.reference.parameters(), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)
    changed = [
        not torch.equal(a, b)
        for name in ("deformation", "renderer")
        for a, b in zip(getattr(prior.shape, name).parameters(), getattr(fit.shape, name).parameters(), strict=True)
    ]
    assert any(changed)  # phase B
    np.testing.assert_array_equal(fit.canonical_from_world, p.canonical_from_world)
    assert fit.pose_change_deg == 0.0
    assert all(np.isfinite(list(losses.values())).all() for _, losses in fit.history)


def test_an_estimated_pose_is_refined():
    given = portrait()
    places = transform_points(given.world_from_canonical, np.array(list(CANONICAL_LANDMARKS_M.values())))
    pixels, _ = given.camera.project(places)
    estimated = replace(given, landmarks_px=dict(zip(CANONICAL_LANDMARKS_M, pixels, strict=True)))
    fit = fit_geometry(estimated, ball_prior(), GEOMETRY)
    assert 0.0 < fit.pose_change_deg < 30.0


def test_the_refinement_moves_neither_codes_nor_roughness():
    prior, p = ball_prior(), portrait()
    geometry = fit_geometry(p, prior, GEOMETRY)
    surface = extract_mesh(unlit_head(geometry, prior), ExtractConfig(cell_m=0.01))

    def fitted(steps):
        # All lobes and highlights: what is decided after the refinement is not the question here.
        config = replace(APPEARANCE_FIT, steps_refinement=steps, everything=True)
        return fit_appearance(p, geometry, prior, surface, config)

    short, long = fitted(1), fitted(6)
    for name in ("z_a", "z_s"):
        torch.testing.assert_close(getattr(short.head, name), getattr(long.head, name), rtol=0, atol=0)
    assert short.roughness == long.roughness
    assert not torch.equal(short.head.refinement.net.out.weight, long.head.refinement.net.out.weight)


def test_the_same_seed_gives_the_same_fit():
    a, b = (fit_geometry(portrait(), ball_prior(), GEOMETRY) for _ in range(2))
    torch.testing.assert_close(a.z_sdf, b.z_sdf, rtol=0, atol=0)


def test_a_saturated_photo_is_refused_in_words():
    p = portrait()
    with pytest.raises(InputError, match="usable pixels"):
        pipeline.run(replace(p, saturated=np.ones_like(p.mask)), SETTINGS, prior=ball_prior())


@pytest.fixture(scope="module")
def journey(tmp_path_factory):
    work = tmp_path_factory.mktemp("work")
    return pipeline.run(portrait(), SETTINGS, prior=ball_prior(), work=work), work


def test_a_resumed_run_finds_its_fits_and_makes_the_same(journey, monkeypatch):
    first, work = journey

    def no_fit(*arguments, **options):
        raise AssertionError("fitted again")

    monkeypatch.setattr(pipeline, "fit_geometry", no_fit)
    monkeypatch.setattr(pipeline, "fit_appearance", no_fit)
    again = pipeline.run(portrait(), SETTINGS, prior=ball_prior(), work=work)
    np.testing.assert_array_equal(first.avatar.mesh.vertices, again.avatar.mesh.vertices)
    np.testing.assert_array_equal(first.avatar.textures.diffuse, again.avatar.textures.diffuse)
    np.testing.assert_array_equal(first.avatar.light.amplitude, again.avatar.light.amplitude)


def test_the_bake_is_told_the_fitted_roughness(journey):
    first, work = journey
    told = []

    def listen(stage, function, *arguments, **options):
        if stage == "bake":
            told.append(options["roughness"])
        return function(*arguments, **options)

    pipeline.run(portrait(), SETTINGS, prior=ball_prior(), work=work, runner=listen)
    assert told == [first.appearance.roughness]


def test_other_settings_do_not_find_those_fits(journey, monkeypatch):
    _, work = journey
    asked = []
    monkeypatch.setattr(
        pipeline,
        "fit_geometry",
        lambda *a, **o: asked.append(1) or (_ for _ in ()).throw(InputError(expected="x", received="y", remedy="z")),
    )
    with pytest.raises(InputError):
        pipeline.run(portrait(), replace(SETTINGS, geometry=replace(GEOMETRY, seed=1)), prior=ball_prior(), work=work)
    assert asked


def test_the_avatar_stands_in_the_world_of_the_scene(journey):
    first, _ = journey
    p = portrait()
    u, depth = p.camera.project(first.avatar.mesh.vertices)
    assert (depth > 0).all()
    # The ball of 10 cm before the camera: its picture is centred on the canonical origin's.
    centre, _ = p.camera.project(np.linalg.inv(p.canonical_from_world)[None, :3, 3])
    assert np.abs(u.mean(0) - centre[0]).max() < 5.0


def test_delivery_is_whole_or_leaves_the_old_one(journey, tmp_path, monkeypatch):
    first, _ = journey
    out = tmp_path / "avatar"
    report = delivery.deliver(first, SETTINGS, out)
    assert report.metrics
    before = (out / "avatar.glb").read_bytes()

    def full_disk(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(delivery, "write_report_html", full_disk)
    with pytest.raises(OSError, match="No space"):
        delivery.deliver(first, SETTINGS, out)
    assert (out / "avatar.glb").read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["avatar"]


def test_a_stranger_s_folder_is_not_overwritten(tmp_path):
    (tmp_path / "thesis.txt").write_text("years")
    for overwrite in (False, True):
        with pytest.raises(InputError):
            delivery.check_target(tmp_path, overwrite=overwrite)


def test_what_cannot_become_a_folder_is_refused_beforehand(tmp_path):
    (tmp_path / "file").write_text("mine")
    for folder, said in (
        (tmp_path / "file", "received a file"),
        (tmp_path / "file" / "avatar", "received a file"),
        (Path(tmp_path.anchor), "mount point; give a folder inside it"),
    ):
        with pytest.raises(InputError, match=said):
            delivery.check_target(folder, overwrite=True)
    delivery.check_target(tmp_path / "new" / "avatar", overwrite=False)


def test_shadows_off_is_another_fit_and_says_nothing_of_shadows(journey):
    first, _ = journey
    settings = replace(SETTINGS, appearance=replace(APPEARANCE_FIT, shadows=False))
    other = pipeline.run(portrait(), settings, prior=ball_prior())
    assert not other.appearance.shadowed
    assert "shadows" in [d.what for d in first.appearance.decisions]
    assert "shadows" not in [d.what for d in other.appearance.decisions]


def test_the_quality_presets_pass_shadows_on():
    for quality in ("draft", "standard", "high"):
        assert pipeline.settings_for(quality).appearance.shadows
        assert not pipeline.settings_for(quality, shadows=False).appearance.shadows


def test_a_killed_appearance_fit_goes_on_to_the_same(journey, tmp_path, monkeypatch):
    """Also when it was killed among rays that were aimed at the light of that time."""
    from sira_assets.fit import loop
    from sira_assets.fit.appearance import fit_appearance
    from sira_assets.fit.loop import Checkpoint

    first, _ = journey
    arguments = first.portrait, first.geometry, ball_prior(), first.surface
    config = replace(APPEARANCE_FIT, steps_refinement=6)
    whole, again = fit_appearance(*arguments, config), fit_appearance(*arguments, config)
    np.testing.assert_array_equal(whole.light.amplitude, again.light.amplitude)
    monkeypatch.setattr(loop, "SAVE_EVERY_SECONDS", 0.0)
    checkpoint = Checkpoint(tmp_path / "appearance.safetensors", "key")

    def kill(done, total):
        if done == total - 2:
            raise RuntimeError("killed")

    with pytest.raises(RuntimeError, match="killed"):
        fit_appearance(*arguments, config, checkpoint=checkpoint, report=kill)
    resumed = fit_appearance(*arguments, config, checkpoint=checkpoint)
    np.testing.assert_array_equal(whole.light.amplitude, resumed.light.amplitude)
    torch.testing.assert_close(whole.head.z_s, resumed.head.z_s, rtol=0, atol=0)


def test_levels_of_detail_and_a_tolerance_are_delivered(journey, tmp_path):
    _, work = journey
    settings = replace(SETTINGS, tolerance_mm=1.0, levels_of_detail=2)
    other = pipeline.run(portrait(), settings, prior=ball_prior(), work=work)
    assert 1e3 * other.facts.gap.greatest <= 1.0
    counts = [len(a.mesh.faces) for a in (other.avatar, *other.levels)]
    assert len(counts) == 3
    assert counts[0] > counts[1] >= counts[2]
    report = delivery.deliver(other, settings, tmp_path / "avatar")
    assert {"avatar_lod1.glb", "avatar_lod2.glb"} <= {p.name for p in (tmp_path / "avatar").iterdir()}
    assert [f for f, _ in report.files if "lod" in f] == ["avatar_lod1.glb", "avatar_lod2.glb"]
    assert {"mesh_gap_max_mm", "field_evaluations"} <= {m.key for m in report.metrics}


def test_everything_is_kept_where_that_is_asked_for():
    settings = replace(SETTINGS, appearance=replace(APPEARANCE_FIT, everything=True))
    found = pipeline.run(portrait(), settings, prior=ball_prior())
    assert len(found.appearance.light.sharpness) == 4
    assert found.appearance.decisions == ()
    assert found.appearance.shadowed
    assert found.appearance.head.specular_scale == 1.0


def test_the_last_phase_covers_the_mask_and_holds_what_is_seen():
    """A mask two pixels wider than the ball that is the prior's every head."""
    from scipy import ndimage

    every = replace(portrait(), mask=np.ones((96, 96), bool))
    none = {
        "steps_codes": 0,
        "steps_networks": 0,
        "band_pool": 400,
        "band_rays": 200,
        "rate_cover": 1e-3,
        "retrace": 10,
    }
    ball = traced(fit_geometry(every, ball_prior(), replace(GEOMETRY, **none)), mask_rays(every)).hit
    p = replace(every, mask=ndimage.binary_dilation(ball.numpy().reshape(96, 96), iterations=2))
    before, after = (
        traced(fit_geometry(p, ball_prior(), replace(GEOMETRY, **none, steps_cover=n)), mask_rays(p)) for n in (0, 150)
    )
    missing = [int((~h.hit).sum()) for h in (before, after)]
    assert missing[0] > 100
    assert missing[1] < 0.5 * missing[0]
    # Two pixels are ten millimetres there; the middle, where nothing is missing, gives way by a sixth of them at most.
    middle = before.hit & (before.t < before.t[before.hit].quantile(0.2))
    assert (after.t - before.t)[middle].abs().max() * UNIT_M < 1.7e-3


def traced(fit, rays):
    low, high = (torch.as_tensor(b / UNIT_M, dtype=torch.float32) for b in BOUNDS_M)
    with torch.no_grad():
        return sphere_trace(lambda x: fit.shape(x, fit.z_sdf)[0], rays.origins, rays.directions, low, high)

"""The journey, readable in one screen: portrait -> shape -> surface -> material, light -> mesh, atlas, maps -> avatar.

Each stage adds one immutable value and its wall-clock time.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sira_assets.asset.avatar import Avatar
from sira_assets.asset.export_config import ExportConfig
from sira_assets.errors import InputError
from sira_assets.fields.mlp import UNIT_M
from sira_assets.fields.prior import Prior, load_prior
from sira_assets.fit.appearance import AppearanceFit, fit_appearance, unlit_head
from sira_assets.fit.appearance_losses import AppearanceFitConfig
from sira_assets.fit.doubts import geometry_doubts, portrait_doubts
from sira_assets.fit.geometry import GeometryFit, GeometryFitConfig, fit_geometry
from sira_assets.fit.loop import Checkpoint
from sira_assets.fit.pace import Pace
from sira_assets.fit.shading import ShadingConfig
from sira_assets.fit.stored import fit_key, keep_appearance, keep_geometry, kept_appearance, kept_geometry
from sira_assets.mesh.asset_mesh import EXTRACT_SHARE, MeshFacts, asset_mesh, level_of_detail
from sira_assets.mesh.clean import CleanConfig, clean_with_report
from sira_assets.mesh.extract import ExtractConfig, extract_with_report
from sira_assets.mesh.field_distance import field_distance
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.render.view import ViewRender, render_view
from sira_assets.render.visibility_table import surface_visibility
from sira_assets.scene.camera import Camera
from sira_assets.scene.portrait import Portrait
from sira_assets.scene.reduce import reduced
from sira_assets.texture.bake import BakeConfig, bake
from sira_assets.texture.texture_set import DEFAULT_MAPS, check_maps
from sira_assets.texture.texture_size import photo_texture_size
from sira_assets.texture.unwrap import UnwrapConfig, unwrap


@dataclass(frozen=True)
class Settings:
    """Everything that decides an avatar, given the portrait and the prior; presets are `settings_for`'s.

    Parameters
    ----------
    quality : the preset's name, for those who read the report
    max_triangles : of the exported mesh, where `tolerance_mm` does not decide
    tolerance_mm : greatest distance of the exported mesh from the field's zero set, canonical mm; or None
    levels_of_detail : how many coarser avatars come beside the full one
    largest_photo : a photo of more pixels a side is brought down to so many for everything: a head's fields hold no
        finer detail, and what is drawn beside the photo would take longer than the fit
    photo_side : the fits read the photo at no more than so many pixels a side; None: as it is
    texels_per_pixel : where the photo decides the texture size; None: `bake.size` does
    largest_texture : where the photo decides, but no more than so many texels a side
    """

    quality: str = "default"
    geometry: GeometryFitConfig = GeometryFitConfig()
    appearance: AppearanceFitConfig = AppearanceFitConfig()
    extract: ExtractConfig = ExtractConfig()
    clean: CleanConfig = CleanConfig()
    max_triangles: int = 30000
    tolerance_mm: float | None = None
    levels_of_detail: int = 0
    unwrap: UnwrapConfig = UnwrapConfig()
    bake: BakeConfig = BakeConfig()
    export: ExportConfig = ExportConfig()
    texels_per_pixel: float | None = None
    largest_texture: int | None = None
    largest_photo: int = 2048
    photo_side: int | None = None
    seed: int = 0


@dataclass(frozen=True)
class Timetable:
    """When a run's fits are to be over, and what becomes of the maps where time is short.

    Parameters
    ----------
    appearance : called before that fit with what was planned for after it; what to do instead, and the fit's pace
    revised : called after that fit with what was to be done, for what to do instead
    """

    geometry: Pace
    appearance: Callable[[Settings], tuple[Settings, Pace]]
    revised: Callable[[Settings], Settings]


Call = Callable[..., object]


def call(name: str, function: Callable, *arguments, **options):
    """Run a stage: what `run` does where it is not told otherwise."""
    return function(*arguments, **options)


@dataclass(frozen=True)
class Journey:
    """All that a run made, stage by stage.

    Parameters
    ----------
    settings : as they were kept to
    """

    portrait: Portrait
    geometry: GeometryFit
    appearance: AppearanceFit
    surface: TriangleMesh  # canonical metres, full resolution
    avatar: Avatar  # the scene's world
    view: ViewRender
    doubts: tuple[str, ...]  # what about the portrait or its fit is not as it should be, one line each
    seconds: tuple[tuple[str, float], ...]
    levels: tuple[Avatar, ...]  # coarser ones, each with maps of its own
    facts: MeshFacts
    settings: Settings


def settings_for(
    quality: str,
    *,
    texture_size: int | None = None,
    maps: tuple[str, ...] = (),
    max_triangles: int | None = None,
    tolerance_mm: float | None = None,
    levels_of_detail: int = 0,
    open_bust: bool = False,
    shadows: bool = True,
    everything: bool = False,
    reproducible: bool = False,
    seed: int = 0,
) -> Settings:
    """The named presets: how accuracy is paid for with time.

    Parameters
    ----------
    texture_size : texels a side; None for what the photo's own pixels fill (draft half of it, high twice, a side)
    maps : baked beside the default ones, of `texture_set.MAPS`
    tolerance_mm : the exported mesh's greatest distance from the fitted surface, instead of a number of triangles
    levels_of_detail : further avatars, each with a quarter of the triangles and half the texels a side
    open_bust : leave off the caps where the head's box cuts the shoulders
    shadows : whether the head casts shadows on itself, in the fit, in the bake and in the render
    everything : see `modelling_everything`
    reproducible : the same bytes from the same seed and threads: charts by xatlas, for UVAtlas draws its own seed

    Raises
    ------
    InputError : another name.
    """
    largest = Settings.largest_photo
    g, a = GeometryFitConfig(seed=seed), AppearanceFitConfig(shadows=shadows, seed=seed)
    if quality == "draft":
        # No phase B: a few dozen steps of the networks leave the face worse than they found it, by 0.2 to 0.6 mm.
        g = replace(g, steps_appearance=50, steps_codes=120, steps_networks=0, steps_cover=40)
        g = replace(g, rays=600, band_rays=250, shading=ShadingConfig(pixels=1500, steps=5))
        a = replace(a, steps_light=80, steps_albedo=80, steps_specular=60, steps_refinement=150, pixels=2000)
        density, triangles, cell, samples = 1.0, 15000, 0.003, 1
    elif quality == "standard":
        # Half as many again as the fit's defaults, for photographed skin, of fewer rays (docs/measurements.md).
        g = replace(g, steps_appearance=120, steps_codes=300, steps_networks=480, steps_cover=300)
        g = replace(g, rays=600, band_rays=240, pool=3600, band_pool=1500)
        density, triangles, cell, samples = 2.0, 30000, 0.002, 2
    elif quality == "high":
        g = replace(g, steps_appearance=120, steps_codes=400, steps_networks=480, steps_cover=300)
        g = replace(g, rays=2000, band_rays=600)
        a = replace(a, steps_refinement=1500, pixels=6000, max_surface=400000)
        density, triangles, cell, samples, largest = 4.0, 60000, 0.0015, 3, 4096
    else:
        raise InputError(expected="draft, standard or high", received=quality, remedy="choose one of them")
    check_maps(maps)
    size = texture_size or BakeConfig.size
    finer = None if tolerance_mm is None else EXTRACT_SHARE * tolerance_mm
    settings = Settings(
        quality,
        g,
        a,
        ExtractConfig(cell_m=cell, tolerance_mm=finer),
        CleanConfig(open_bust=open_bust),
        max_triangles=max_triangles or triangles,
        tolerance_mm=tolerance_mm,
        levels_of_detail=levels_of_detail,
        unwrap=UnwrapConfig(texture_size=size, methods=("xatlas",) if reproducible else UnwrapConfig.methods),
        bake=BakeConfig(size=size, samples=samples, maps=tuple(dict.fromkeys((*DEFAULT_MAPS, *maps)))),
        texels_per_pixel=None if texture_size else density,
        largest_photo=largest,
        seed=seed,
    )
    return modelling_everything(settings) if everything else settings


def modelling_everything(settings: Settings) -> Settings:
    """The same, with lobes, highlights and shadows that the photo cannot tell from none, and `bake.size` texels a side
    whatever the photo shows."""
    return replace(settings, appearance=replace(settings.appearance, everything=True), texels_per_pixel=None)


def sized_for_photo(settings: Settings, mesh_world: TriangleMesh, camera: Camera, shortest_wave: float) -> Settings:
    """Settings with the texture size that the photo's pixels and the albedo's shortest wave (in the world's unit) ask
    for, unless a size was asked for."""
    if settings.texels_per_pixel is None:
        return settings
    density = settings.texels_per_pixel
    size = photo_texture_size(mesh_world, camera, texels_per_pixel=density, shortest_wave=shortest_wave)
    size = min(size, settings.largest_texture or size)
    return replace(settings, unwrap=replace(settings.unwrap, texture_size=size), bake=replace(settings.bake, size=size))


def run(
    portrait: Portrait,
    settings: Settings | None = None,
    *,
    prior: Prior | None = None,
    work: Path | None = None,
    device: str = "cpu",
    timetable: Timetable | None = None,
    runner: Call = call,
    report: Callable[[str, int, int], None] = lambda stage, done, steps: None,
) -> Journey:
    """Turn one portrait into an avatar, in memory.

    Parameters
    ----------
    settings : standard's if None
    prior : the trained models; the shipped ones if None
    work : folder in which the two fits are kept as they finish and found again by a later run of the same settings
    timetable : keep to it, steps and texture size as the clock allows; not together with `work`
    runner : called with (stage, function, arguments) instead of the function, for those who measure or keep stages
    report : called with (stage, steps done, steps in all)
    """
    seconds: list[tuple[str, float]] = []

    def stage(name, function, *args, **options):
        started = time.monotonic()
        report(name, 0, 1)
        if function in (fit_geometry, fit_appearance):
            options["report"] = lambda done, steps: report(name, done, steps)
        out = runner(name, function, *args, **options)
        report(name, 1, 1)
        seconds.append((name, time.monotonic() - started))
        return out

    settings = settings_for("standard") if settings is None else settings
    prior = stage("load prior", load_prior) if prior is None else prior
    prior = prior.to(device)
    if timetable is not None and work is not None:
        raise ValueError("a run against the clock cannot be gone on with: give either work or timetable")
    portrait = reduced(portrait, settings.largest_photo)
    seen = reduced(portrait, settings.photo_side) if settings.photo_side else portrait
    key = fit_key(seen, prior, repr(settings.geometry))
    geometry = kept_geometry(work, key, device=device) if work else None
    if geometry is not None:
        seconds.append(("fit geometry", geometry.seconds))
    else:
        partial = Checkpoint(work / "geometry-partial.safetensors", key) if work else None
        given = (seen, prior, settings.geometry)
        kept = {"checkpoint": partial, "pace": timetable.geometry if timetable else None}
        geometry = stage("fit geometry", fit_geometry, *given, device=device, **kept)
        if work:
            keep_geometry(geometry, work, key)
            partial.path.unlink(missing_ok=True)
    posed, seen = (replace(p, canonical_from_world=geometry.canonical_from_world) for p in (portrait, seen))
    shape = unlit_head(geometry, prior)
    surface, extracted = stage("extract", extract_with_report, shape, settings.extract, device=device)
    surface, cleaned = stage("clean", clean_with_report, surface, settings.clean)
    to_world = np.linalg.inv(geometry.canonical_from_world)
    wave = settings.appearance.refinement.shortest * UNIT_M * float(np.cbrt(np.linalg.det(to_world[:3, :3])))
    settings = sized_for_photo(settings, surface.transformed(to_world), portrait.camera, wave)
    settings, pace = timetable.appearance(settings) if timetable else (settings, None)
    key = fit_key(seen, prior, repr((settings.geometry, settings.extract, settings.clean, settings.appearance)))
    appearance = kept_appearance(work, key, device=device) if work else None
    if appearance is not None:
        seconds.append(("fit appearance", appearance.seconds))
    else:
        partial = Checkpoint(work / "appearance-partial.safetensors", key) if work else None
        given = (seen, geometry, prior, surface, settings.appearance)
        appearance = stage("fit appearance", fit_appearance, *given, checkpoint=partial, pace=pace)
        if work:
            keep_appearance(appearance, work, key)
            partial.path.unlink(missing_ok=True)
    settings = timetable.revised(settings) if timetable else settings
    head, light, pose = appearance.head, appearance.light, geometry.canonical_from_world
    shadows = None
    if appearance.shadowed:
        rays = settings.appearance.rays.aimed
        shadows = stage("shadows", surface_visibility, surface, light, pose, directions=rays)

    def dressed(mesh: TriangleMesh, level: int = 0) -> Avatar:
        name = f", level {level}" if level else ""
        unwrapping = replace(settings.unwrap, texture_size=max(settings.unwrap.texture_size >> level, 64))
        baking = replace(settings.bake, size=max(settings.bake.size >> level, 64))
        atlas = stage(f"unwrap{name}", unwrap, mesh, unwrapping)
        there = (head, mesh, atlas, light, to_world)
        lit = {"shadows": shadows, "surface": surface, "roughness": appearance.roughness}
        textures = stage(f"bake{name}", bake, *there, baking, **lit, device=device)
        return Avatar(
            mesh.transformed(to_world),
            atlas,
            textures,
            light,
            appearance.roughness,
            pose,
            portrait.metres_per_unit,
            portrait.name,
            portrait.camera,
        )

    mesh = stage("simplify", asset_mesh, surface, settings.max_triangles, settings.tolerance_mm)
    gap = stage("measure", field_distance, shape, mesh, samples=20_000, device=device)
    avatar = dressed(mesh)
    meshes = [
        stage(f"simplify, level {k}", level_of_detail, surface, mesh, k)
        for k in range(1, settings.levels_of_detail + 1)
    ]
    levels = tuple(dressed(coarser, k) for k, coarser in enumerate(meshes, 1))
    camera = portrait.camera
    lit = (light, appearance.roughness)
    view = stage("render", render_view, head, surface, camera, pose, *lit, shadows=shadows, device=device)
    doubts = portrait_doubts(portrait) + geometry_doubts(portrait, geometry, prior, view.hit) + appearance.warnings
    facts = MeshFacts(extracted, cleaned, gap)
    return Journey(posed, geometry, appearance, surface, avatar, view, doubts, tuple(seconds), levels, facts, settings)

"""Every setting that trades speed for accuracy, under one name each.

Notation: a factor is relative to the fit's default settings; "all" stands for no limit. A knob changes the cost of some
stages of the journey, by their names in `pipeline.run`, and is read from settings and put into them.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from sira_assets.fit.appearance_losses import AppearanceFitConfig
from sira_assets.fit.geometry_losses import GeometryFitConfig
from sira_assets.pipeline import Settings

Value = float | int | str
GEOMETRY, APPEARANCE = GeometryFitConfig(), AppearanceFitConfig()
# With fewer steps than this share of the default the networks are left as they are, and the codes get their steps: so
# few would leave the face worse than they found it.
NETWORKS_FROM = 0.45
# With fewer than this share, phase C holds what is seen less: it must cover the mask in what steps it has.
HELD_FULLY_FROM = 0.25
# Of a fit of few steps, how much of the photo's shading is read first: pixels and steps for each whole default, and the
# least of them that still say something.
READ_PIXELS, READ_STEPS, FEWEST_READ = 6000, 20, (600, 3)


@dataclass(frozen=True)
class Knob:
    """One setting.

    Parameters
    ----------
    values : those that are measured, cheapest first
    stages : those whose cost depends on it
    read, put : from settings, and into them
    steps : values between the measured ones are as good, on a logarithmic scale
    """

    name: str
    unit: str
    values: tuple[Value, ...]
    stages: tuple[str, ...]
    read: Callable[[Settings], Value]
    put: Callable[[Settings, Value], Settings]
    steps: bool = False


def _geometry_steps(settings: Settings) -> float:
    g = settings.geometry
    steps = lambda c: c.steps_appearance + c.steps_codes + c.steps_networks + c.steps_cover  # noqa: E731
    return steps(g) / steps(GEOMETRY)


def _put_geometry_steps(settings: Settings, factor: Value) -> Settings:
    steps = lambda name: max(1, round(factor * getattr(GEOMETRY, name)))  # noqa: E731
    settle, codes, networks = steps("steps_appearance"), steps("steps_codes"), steps("steps_networks")
    if factor < NETWORKS_FROM:
        settle, codes, networks = settle + networks // 4, codes + networks - networks // 4, 0
    reading = replace(
        GEOMETRY.shading,
        pixels=round(min(max(READ_PIXELS * factor, FEWEST_READ[0]), GEOMETRY.shading.pixels)),
        steps=round(min(max(READ_STEPS * factor, FEWEST_READ[1]), GEOMETRY.shading.steps)),
    )
    chosen = {"steps_appearance": settle, "steps_codes": codes, "steps_networks": networks}
    hold = GEOMETRY.hold * min(factor / HELD_FULLY_FROM, 1.0)
    chosen |= {"steps_cover": steps("steps_cover"), "hold": hold, "shading": reading}
    return replace(settings, geometry=replace(settings.geometry, **chosen))


def _put_rays(settings: Settings, factor: Value) -> Settings:
    rays = {n: max(16, round(factor * getattr(GEOMETRY, n))) for n in ("rays", "band_rays")}
    # As many are followed as before: six steps' worth of them.
    pools = {n: max(64, round(factor * getattr(GEOMETRY, n))) for n in ("pool", "band_pool")}
    return replace(settings, geometry=replace(settings.geometry, **rays, **pools))


def _appearance_steps(settings: Settings) -> float:
    steps = lambda c: c.steps_light + c.steps_albedo + c.steps_specular + c.steps_refinement  # noqa: E731
    return steps(settings.appearance) / steps(APPEARANCE)


def _put_appearance_steps(settings: Settings, factor: Value) -> Settings:
    names = ("steps_light", "steps_albedo", "steps_specular", "steps_refinement")
    steps = {n: max(1, round(factor * getattr(APPEARANCE, n))) for n in names}
    return replace(settings, appearance=replace(settings.appearance, **steps))


def _put_trace(settings: Settings, tolerance: Value) -> Settings:
    trace = replace(settings.geometry.trace, tolerance=float(tolerance))
    return replace(settings, geometry=replace(settings.geometry, trace=trace))


def _visibility(settings: Settings) -> int:
    return settings.appearance.rays.early if settings.appearance.shadows else 0


def _put_visibility(settings: Settings, rays: Value) -> Settings:
    a = settings.appearance
    if not rays:
        return replace(settings, appearance=replace(a, shadows=False))
    chosen = replace(a.rays, early=int(rays), aimed=int(rays))
    return replace(settings, appearance=replace(a, shadows=True, rays=chosen))


def _texture(settings: Settings) -> int:
    """Texels a side; where the photo decides, the most, or what it comes to for a head that fills 512 pixels."""
    if settings.largest_texture and settings.texels_per_pixel:
        return settings.largest_texture
    return round(settings.bake.size * (settings.texels_per_pixel or 2.0) / 2.0)


def _put_texture(settings: Settings, size: Value) -> Settings:
    unwrap, bake = replace(settings.unwrap, texture_size=int(size)), replace(settings.bake, size=int(size))
    return replace(settings, unwrap=unwrap, bake=bake, texels_per_pixel=None)


KNOBS = (
    Knob(
        "photo size",
        "pixels a side",
        (128, 256, "all"),
        ("fit geometry", "fit appearance"),
        lambda s: s.photo_side or "all",
        lambda s, v: replace(s, photo_side=None if v == "all" else int(v)),
    ),
    Knob(
        "geometry steps",
        "factor",
        (0.06, 0.125, 0.25, 0.5, 1.0, 2.0),
        ("fit geometry",),
        _geometry_steps,
        _put_geometry_steps,
        steps=True,
    ),
    Knob(
        "geometry rays",
        "factor",
        (0.25, 0.5, 1.0, 2.0),
        ("fit geometry",),
        lambda s: s.geometry.rays / GEOMETRY.rays,
        _put_rays,
    ),
    Knob(
        "tracing tolerance",
        "dm",
        (2e-3, 2e-4, 2e-5),
        ("fit geometry",),
        lambda s: s.geometry.trace.tolerance,
        _put_trace,
    ),
    Knob(
        "precision",
        "",
        ("bfloat16", "float32"),
        ("fit geometry",),
        lambda s: "bfloat16" if s.geometry.bfloat16 else "float32",
        lambda s, v: replace(s, geometry=replace(s.geometry, bfloat16=v == "bfloat16")),
    ),
    Knob(
        "appearance steps",
        "factor",
        (0.06, 0.125, 0.25, 0.5, 1.0, 2.0),
        ("fit appearance",),
        _appearance_steps,
        _put_appearance_steps,
        steps=True,
    ),
    Knob(
        "appearance pixels",
        "a step",
        (750, 1500, 3000, 6000),
        ("fit appearance",),
        lambda s: s.appearance.pixels,
        lambda s, v: replace(s, appearance=replace(s.appearance, pixels=int(v))),
    ),
    Knob(
        "lobes",
        "",
        (3, 6, "all"),
        ("fit appearance", "shadows", "bake", "render"),
        lambda s: s.appearance.lobes or "all",
        lambda s, v: replace(s, appearance=replace(s.appearance, lobes=None if v == "all" else int(v))),
    ),
    Knob(
        "shading grade",
        "",
        ("fast", "accurate"),
        ("fit appearance",),
        lambda s: s.appearance.grade,
        lambda s, v: replace(s, appearance=replace(s.appearance, grade=str(v))),
    ),
    Knob(
        "visibility rays",
        "a point",
        (0, 64, 256, 1024),
        ("fit appearance", "shadows", "bake", "render"),
        _visibility,
        _put_visibility,
    ),
    Knob(
        "extraction cell",
        "mm",
        (4.0, 3.0, 2.0, 1.5, 1.0),
        ("extract", "clean", "fit appearance", "shadows", "simplify", "bake", "render"),
        lambda s: 1e3 * s.extract.cell_m,
        lambda s, v: replace(s, extract=replace(s.extract, cell_m=1e-3 * float(v))),
    ),
    Knob(
        "triangles",
        "",
        (4000, 8000, 15000, 30000, 60000),
        ("simplify", "unwrap", "bake", "write"),
        lambda s: s.max_triangles,
        lambda s, v: replace(s, max_triangles=int(v)),
    ),
    Knob(
        "texture size",
        "texels a side",
        (256, 512, 1024, 2048),
        ("unwrap", "bake", "write"),
        _texture,
        _put_texture,
    ),
    Knob(
        "texture samples",
        "a texel's side",
        (1, 2, 3),
        ("bake",),
        lambda s: s.bake.samples,
        lambda s, v: replace(s, bake=replace(s.bake, samples=int(v))),
    ),
)


def knob(name: str) -> Knob:
    """The knob of this name.

    Raises
    ------
    KeyError : none has it.
    """
    found = {k.name: k for k in KNOBS}
    return found[name]


def place(values: tuple[Value, ...], value: Value) -> tuple[int, int, float]:
    """Between which two of the measured values a value lies, and how far from the first: by logarithms.

    A name, a zero, or what lies beyond the ends, counts as the nearest end or as the value of that name.
    """
    if value in values:
        at = values.index(value)
        return at, at, 0.0
    numbers = [(float(v), i) for i, v in enumerate(values) if not isinstance(v, str) and v > 0]
    if isinstance(value, str) or value <= 0 or not numbers:
        end = len(values) - 1 if isinstance(value, str) else 0
        return end, end, 0.0
    numbers.sort()
    below, above = [n for n in numbers if n[0] <= value], [n for n in numbers if n[0] > value]
    if not below or not above:
        end = (below[-1] if below else above[0])[1]
        return end, end, 0.0
    (low, i), (high, j) = below[-1], above[0]
    return i, j, math.log(value / low) / math.log(high / low)

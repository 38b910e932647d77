"""The rigs that portraits are lit by, drawn by seed.

Notation: as in `lights`; the key light has power 1 and the others are told as shares of it. A soft box that spans a
half angle a (radians) is matched by a lobe of equal mean spread, sharpness 4 / a^2: 60 by 60 cm at 1.5 m is 80, a
window of 1.2 m at 1.5 m is 20. Lobes sharper than 1000 (a half angle of 3.6 degrees) are not drawn: their
penumbra, a millimetre a few centimetres behind an edge, is below a pixel of these pictures.
"""

import numpy as np

from data_synth.light_colour import daylight, planckian
from data_synth.lights import Lamp, Rig, sample_white_balance

MOST_LOBES = 8
SHARPNESS_RANGE = (0.05, 1000.0)
# Lamps: candle to cold LED. Tungsten 2700 to 3000 K, flash and studio LED 5000 to 6000 K, by their makers' sheets.
TUNGSTEN_K, STUDIO_K, INDOOR_K = (2500.0, 3200.0), (4800.0, 6200.0), (2600.0, 5500.0)
# Skies: overcast about 6500 K, clear 9000 K to beyond 20000 K (CIE 015; Lee and Hernandez-Andres 2005,
# DOI 10.1364/AO.44.005712). Sunlight reddens with the air it crosses, see `_sun_and_sky`.
OVERCAST_K, CLEAR_SKY_K = (5800.0, 7500.0), (8000.0, 20000.0)


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _kelvin(rng: np.random.Generator, low: float, high: float) -> float:
    """A temperature, drawn evenly in mired."""
    return 1e6 / rng.uniform(1e6 / high, 1e6 / low)


def _lamp(rng, azimuth, elevation, sharpness, power, colour, *, side: float = 1.0, gel: bool = False) -> Lamp:
    """Draw a lamp from (low, high) ranges; sharpness and power on a logarithmic scale; `side` mirrors the azimuth."""
    return Lamp(
        side * rng.uniform(*azimuth),
        rng.uniform(*elevation),
        _log_uniform(rng, *sharpness),
        _log_uniform(rng, *power),
        colour,
        gel,
    )


def _ambient(rng: np.random.Generator, low: float, high: float, colour: np.ndarray) -> Lamp:
    """What walls and air send from everywhere, a little more from above."""
    return _lamp(rng, (-180, 180), (30, 90), (0.05, 1.0), (low, high), colour)


def _ground(rng: np.random.Generator, low: float, high: float, colour: np.ndarray) -> Lamp:
    """What the floor throws back: the light's colour, warmed by soil, wood or skin-coloured walls."""
    tint = np.array([1.0, 0.93, 0.80]) ** rng.uniform(0.0, 1.5)
    return _lamp(rng, (0, 0), (-90, -80), (0.8, 2.0), (low, high), colour * tint)


def _side(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _studio(rng: np.random.Generator) -> tuple[Lamp, ...]:
    """Key, fill and rim. Lighting ratios of 2:1 to 8:1 on the face are what portrait manuals teach."""
    side, white = _side(rng), planckian(_kelvin(rng, *STUDIO_K))
    lamps = [
        _lamp(rng, (15, 65), (15, 50), (8, 80), (1, 1), white, side=side),
        _lamp(rng, (15, 70), (-10, 30), (2, 12), (0.1, 0.6), white, side=-side),
        _ambient(rng, 0.03, 0.2, white),
    ]
    if rng.random() < 0.7:
        warm = planckian(_kelvin(rng, 3000, 7000)) if rng.random() < 0.3 else white
        lamps.append(_lamp(rng, (120, 170), (10, 50), (20, 120), (0.3, 1.5), warm, side=-side))
    return tuple(lamps)


def _butterfly(rng: np.random.Generator) -> tuple[Lamp, ...]:
    """A beauty dish high in front, and a reflector below the chin."""
    white = planckian(_kelvin(rng, *STUDIO_K))
    return (
        _lamp(rng, (-12, 12), (35, 60), (20, 120), (1, 1), white),
        _lamp(rng, (-10, 10), (-50, -25), (2, 8), (0.15, 0.5), white),
        _ambient(rng, 0.03, 0.2, white),
    )


def _ring(rng: np.random.Generator) -> tuple[Lamp, ...]:
    """A ring light about the lens: 36 to 48 cm across, at 0.6 to 1.2 m."""
    white = planckian(_kelvin(rng, 3200, 6000))
    radius = np.degrees(np.arctan(rng.uniform(0.18, 0.24) / rng.uniform(0.6, 1.2)))
    azimuth, elevation = rng.uniform(-15, 15), rng.uniform(-8, 12)
    lamps = [
        Lamp(azimuth + radius * np.cos(a), elevation + radius * np.sin(a), 120.0, 1.0 / 6.0, white)
        for a in np.radians(60.0 * np.arange(6))
    ]
    return (*lamps, _ambient(rng, 0.05, 0.3, planckian(_kelvin(rng, *INDOOR_K))))


def _window(rng: np.random.Generator) -> tuple[Lamp, ...]:
    """A window at one side; on the other the room gives back a fifth to a tenth, or a lamp burns in it."""
    side, sky = _side(rng), daylight(_kelvin(rng, 5500, 9000))
    lit = rng.random() < 0.35
    room = planckian(_kelvin(rng, *TUNGSTEN_K)) if lit else sky * np.array([1.0, 0.94, 0.84])
    return (
        _lamp(rng, (25, 95), (0, 35), (3, 25), (1, 1), sky, side=side),
        _lamp(rng, (30, 110), (-20, 40), (1, 6) if lit else (1, 3), (0.06, 0.35), room, side=-side),
        _ambient(rng, 0.04, 0.2, 0.5 * (sky + room)),
    )


def _sun(rng: np.random.Generator, elevation_deg: float, azimuth: tuple[float, float]) -> tuple[Lamp, Lamp]:
    """Sun and its sky. Direct light falls as 0.7^(m^0.678) with the air mass m, and a clear sky brings a tenth of it.

    Both by Meinel and Meinel 1976, Applied Solar Energy; the sky is held to its share at m = 1 as the sun sinks, and
    haze moves light from the sun to the sky.
    """
    air_mass = 1.0 / np.sin(np.radians(max(elevation_deg, 5.0)))
    # 5600 K at one air mass, 100 mired redder for four more: 3600 K at 12 degrees.
    sun = planckian(1e6 / (178.0 + 25.0 * (air_mass - 1.0)))
    haze = rng.uniform(0.0, 1.0) ** 2
    share = 0.1 * 0.7 ** (1.0 - min(air_mass, 6.0) ** 0.678) * (1.0 + 5.0 * haze)
    sky = daylight(1e6 / (1e6 / _kelvin(rng, *CLEAR_SKY_K) * (1 - haze) + 1e6 / 6500.0 * haze))
    sharpness = (600.0, 1000.0) if haze < 0.5 else (60.0, 600.0)
    return (
        _lamp(rng, azimuth, (elevation_deg, elevation_deg), sharpness, (1, 1), sun),
        _lamp(rng, (-180, 180), (60, 90), (0.7, 1.6), (share, share), sky),
    )


def _sun_and_sky(rng: np.random.Generator) -> tuple[Lamp, ...]:
    sun, sky = _sun(rng, rng.uniform(12, 65), (-100, 100))
    return sun, sky, _ground(rng, 0.05, 0.3, 0.8 * sun.colour + 0.2 * sky.colour)


def _backlit(rng: np.random.Generator) -> tuple[Lamp, ...]:
    """The sun behind the head, the face in the light of the sky and of what stands before it."""
    sun, sky = _sun(rng, rng.uniform(8, 50), (130, 230))
    front = _lamp(rng, (-60, 60), (-20, 30), (1, 4), (0.1, 0.4), 0.7 * sun.colour + 0.3 * sky.colour)
    return sun, sky, front, _ground(rng, 0.05, 0.3, sun.colour)


def _overcast(rng: np.random.Generator) -> tuple[Lamp, ...]:
    """CIE overcast sky: three times as bright at the zenith as at the horizon."""
    sky = daylight(_kelvin(rng, *OVERCAST_K))
    return (
        _lamp(rng, (-180, 180), (55, 90), (0.8, 2.5), (1, 1), sky),
        _lamp(rng, (-60, 60), (0, 40), (1, 4), (0.2, 0.7), sky),
        _ground(rng, 0.05, 0.25, sky),
    )


def _shade(rng: np.random.Generator) -> tuple[Lamp, ...]:
    """Open shade: blue sky from one side, and a sunlit wall or street that throws warm light back."""
    side = _side(rng)
    return (
        _lamp(rng, (0, 80), (20, 70), (0.8, 3), (1, 1), daylight(_kelvin(rng, *CLEAR_SKY_K)), side=side),
        _lamp(rng, (20, 120), (-20, 20), (1.5, 8), (0.15, 0.8), planckian(_kelvin(rng, 4000, 5500)), side=-side),
        _ground(rng, 0.05, 0.3, planckian(_kelvin(rng, 4500, 5800))),
    )


def _coloured(rng: np.random.Generator) -> tuple[Lamp, ...]:
    """Gels from both sides, with some white in front of them."""
    white = planckian(_kelvin(rng, *STUDIO_K))
    lamps = [_ambient(rng, 0.1, 0.3, white), _lamp(rng, (-50, 50), (0, 40), (3, 20), (0.3, 0.8), white)]
    for side in (-1.0, 1.0):
        colour = 0.25 + 2.0 * rng.dirichlet(np.full(3, 0.8))
        lamps.append(_lamp(rng, (25, 130), (-15, 45), (5, 40), (0.4, 1.0), colour, side=side, gel=True))
    return tuple(lamps)


def _harsh(rng: np.random.Generator) -> tuple[Lamp, ...]:
    """One or two bare bulbs or spots and next to nothing else."""
    white = planckian(_kelvin(rng, *INDOOR_K))
    lamps = [_lamp(rng, (-75, 75), (-5, 80), (80, 600), (1, 1), white), _ambient(rng, 0.02, 0.1, white)]
    if rng.random() < 0.5:
        lamps.append(_lamp(rng, (-150, 150), (-10, 50), (60, 400), (0.2, 0.9), planckian(_kelvin(rng, *INDOOR_K))))
    return tuple(lamps)


def _flash(rng: np.random.Generator) -> tuple[Lamp, ...]:
    """A phone's or camera's own flash, a hand's breadth off the lens, in a dim room."""
    room = planckian(_kelvin(rng, *TUNGSTEN_K))
    return (
        _lamp(rng, (-20, 20), (-8, 20), (300, 1000), (1, 1), planckian(_kelvin(rng, 5000, 6000))),
        _lamp(rng, (-90, 90), (30, 80), (2, 30), (0.05, 0.4), room),
        _ambient(rng, 0.05, 0.25, room),
    )


def _indoors(rng: np.random.Generator) -> tuple[Lamp, ...]:
    """Ceiling lamps and what walls give back, none of it placed for the portrait."""
    white = planckian(_kelvin(rng, *INDOOR_K))
    lamps = [_ambient(rng, 0.15, 0.5, white), _lamp(rng, (-100, 100), (25, 85), (4, 60), (1, 1), white)]
    for _ in range(rng.integers(1, 5)):
        other = white if rng.random() < 0.7 else planckian(_kelvin(rng, *INDOOR_K))
        lamps.append(_lamp(rng, (-180, 180), (15, 80), (4, 100), (0.2, 0.9), other))
    return (*lamps, _ground(rng, 0.1, 0.3, white))


def _anywhere(rng: np.random.Generator) -> tuple[Lamp, ...]:
    """Lobes without a story, for what the other rigs leave out."""
    lamps = [
        _ambient(rng, 0.05, 0.3, planckian(_kelvin(rng, 3000, 12000))),
        _lamp(rng, (-60, 60), (-10, 50), (3, 60), (0.8, 0.8), planckian(_kelvin(rng, 3000, 12000))),
    ]
    for _ in range(rng.integers(1, 7)):
        white = planckian(_kelvin(rng, 2500, 15000))
        lamps.append(_lamp(rng, (-180, 180), (-30, 80), (1.5, 100), (0.05, 0.7), white))
    return tuple(lamps)


# Names and how often each is drawn. Soft rigs prevail: they are what portraits are taken in.
RIGS = (
    ("studio", _studio, 0.18),
    ("butterfly", _butterfly, 0.06),
    ("ring light", _ring, 0.04),
    ("window", _window, 0.13),
    ("sun and sky", _sun_and_sky, 0.10),
    ("backlit", _backlit, 0.05),
    ("overcast", _overcast, 0.10),
    ("shade", _shade, 0.07),
    ("coloured", _coloured, 0.05),
    ("harsh", _harsh, 0.07),
    ("flash", _flash, 0.04),
    ("indoors", _indoors, 0.07),
    ("anywhere", _anywhere, 0.04),
)


def sample_rig(rng: np.random.Generator) -> Rig:
    """Draw a rig as a camera's white balance records it: 2 to 8 lobes with sharpness in `SHARPNESS_RANGE`."""
    name, lamps, _ = RIGS[rng.choice(len(RIGS), p=[share for *_, share in RIGS])]
    return Rig(name, lamps(rng)).white_balanced(sample_white_balance(rng))

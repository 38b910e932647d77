"""What covers a head, as parameters: pigment, grooming and dress.

Notation: lengths in millimetres on the template; colours linear Rec. 709; strengths 0 to 1 unless said otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass

from sira_assets.errors import InputError

HAIR_STYLES = (
    "bald",
    "buzz",
    "crop",
    "short",
    "side_part",
    "swept_back",
    "undercut",
    "receding",
    "curly",
    "afro",
    "fringe",
    "bob",
    "long",
    "wavy",
    "ponytail",
    "bun",
)
BEARDS = ("none", "moustache", "goatee", "chin_strap", "full", "long")
HEADWEAR = ("none", "cap", "beanie", "headband")
GARMENTS = ("none", "tshirt", "vneck", "tank", "shirt", "jumper", "hoodie", "scarf")
PATTERNS = ("plain", "melange", "stripes", "check", "dots")


def one_of(what: str, value: str, among: tuple[str, ...]) -> None:
    """Raise InputError unless ``value`` is ``among`` the names of ``what``."""
    if value not in among:
        raise InputError(
            expected=f"{what} among " + ", ".join(among), received=repr(value), remedy="choose one of these"
        )


@dataclass(frozen=True)
class Pigment:
    """Colour of skin, hair and eyes.

    Attributes
    ----------
    melanin : float
        Volume fraction of melanosomes in the epidermis, 0.01 (pale) to 0.30 (very dark).
    haemoglobin : float
        Volume fraction of blood in the dermis, 0.006 to 0.05.
    scattering : float
        The dermis' scattering over the published mean, 0.7 to 1.6.
    redness, freckles, moles, stubble, brow_weight, lip_colour, under_eye, oil, blotches : float
        Strength of each, 0 to 1.
    hair_melanin : float
        0 (white) to 1 (black).
    hair_redness : float
        0 (ash) to 1 (red).
    grey : float
        Share of white hairs.
    iris : (3,) tuple of float
        Linear Rec. 709.
    """

    melanin: float = 0.05
    haemoglobin: float = 0.018
    scattering: float = 1.0
    redness: float = 0.5
    freckles: float = 0.0
    moles: float = 0.3
    stubble: float = 0.0
    brow_weight: float = 0.7
    lip_colour: float = 0.5
    under_eye: float = 0.3
    oil: float = 0.5
    blotches: float = 0.5
    hair_melanin: float = 0.75
    hair_redness: float = 0.2
    grey: float = 0.0
    iris: tuple[float, float, float] = (0.08, 0.05, 0.03)


@dataclass(frozen=True)
class Groom:
    """How hair grows and is worn.

    Attributes
    ----------
    front_mm, recede_mm, peak_mm : float
        The hairline: raised at the forehead (-8 to 12), recession at the temples (0 to 22), widow's peak (0 to 9).
    sideburn_mm, nape_mm : float
        Lengthening of both, -8 to 20.
    part : float
        Place of the parting, -1 (right) to 1 (left).
    wave, clump : float
        Waviness (0 to 1) and strength of the clumps' relief (0.4 to 1.6).
    front_fall_mm : float
        How far forward hanging hair comes, 0 (behind the shoulders) to 40 (before them).
    beard : str
        Among `BEARDS`.
    beard_mm : float
        Its length, 2 to 30.
    brow_thickness, brow_arch : float
        -1 to 1.
    """

    front_mm: float = 0.0
    recede_mm: float = 3.0
    peak_mm: float = 2.0
    sideburn_mm: float = 0.0
    nape_mm: float = 0.0
    part: float = 0.5
    wave: float = 0.2
    clump: float = 1.0
    front_fall_mm: float = 10.0
    beard: str = "none"
    beard_mm: float = 6.0
    brow_thickness: float = 0.0
    brow_arch: float = 0.0

    def __post_init__(self) -> None:
        one_of("a beard", self.beard, BEARDS)


@dataclass(frozen=True)
class Dress:
    """What is worn. ``neckline``: 0 (close to the neck) to 1 (wide); colours linear Rec. 709."""

    garment: str = "tshirt"
    neckline: float = 0.3
    cloth: tuple[float, float, float] = (0.1, 0.12, 0.16)
    second: tuple[float, float, float] = (0.5, 0.5, 0.5)
    pattern: str = "plain"
    headwear: str = "none"
    headwear_colour: tuple[float, float, float] = (0.05, 0.06, 0.1)

    def __post_init__(self) -> None:
        one_of("a garment", self.garment, GARMENTS)
        one_of("headwear", self.headwear, HEADWEAR)
        one_of("a pattern", self.pattern, PATTERNS)


def is_plain(params) -> bool:
    """Whether a head (`HeadParams`) wears no hat, no scarf and no beard, and no hair that is a shape of its own.

    Such hair is an afro, hair that hangs, hair tied behind the head, and a fringe over the forehead.
    """
    apart = params.hair_style in ("afro", "bob", "long", "wavy", "ponytail", "bun", "fringe")
    worn = params.dress.headwear != "none" or params.dress.garment == "scarf"
    return not (apart or worn or params.groom.beard != "none")

"""The template head: an implicit surface of named anatomical primitives.

Notation
--------
``x``        point in the canonical head frame (metres; +X the subject's left, +Y up, +Z out of the face).
``f(x)``     negative inside, about the signed distance near the surface: ``f = max(f_skin, cut)``.
mass         an ellipsoid (centre ``c``, radii ``r``, rotation vector ``w``) joined to the ones before it by a
             polynomial smooth minimum of width ``k``.
stroke       an anisotropic Gaussian added to the field: ``f -= h exp(-|S R^T (x - c)|^2 / 2)``; ``h`` is how far it
             raises (or, negative, sinks) the surface.
eye          an ellipsoid eyeball seen through an almond-shaped opening cut into the lids.

Paired primitives stand for a left one and its mirror image, so the template is symmetric about x = 0. The ellipsoid
bound ``k0 (k0 - 1) / k1`` and the polynomial smooth minimum are those of I. Quilez, "Distance functions" (2008-2013).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import torch
from torch import Tensor


@dataclass(frozen=True)
class Primitives:
    """Columns of one kind of primitive (masses or strokes); lengths in millimetres.

    Attributes
    ----------
    name : tuple of str
        Anatomical name of each primitive.
    paired : Tensor, (n,) bool
        True where the primitive has a mirror image.
    centre_mm : Tensor, (n, 3)
    log_size : Tensor, (n, 3)
        Natural logarithm of the radii (masses) or standard deviations (strokes) in millimetres.
    rotation : Tensor, (n, 3)
        Rotation vector in radians; an unpaired primitive turns about x only.
    weight : Tensor, (n,)
        Masses: logarithm of the blend width in millimetres. Strokes: height in millimetres.
    """

    name: tuple[str, ...]
    paired: Tensor
    centre_mm: Tensor
    log_size: Tensor
    rotation: Tensor
    weight: Tensor


@dataclass(frozen=True)
class Template:
    """All parameters of the template head.

    Attributes
    ----------
    masses, strokes : Primitives
    eyeball : Tensor, (6,)
        Centre and log radii (mm) of the left eyeball.
    lids : Tensor, (13,)
        Left eye opening: inner corner (x, y, z), outer corner (x, y, z), upper height and its skew, lower height and
        its skew, depth of the corners, roundness of the lid margin, width of the eyeball's contact (all mm; skews 1).
    floor_mm : float
        Height of the flat cut that closes the bust.
    """

    masses: Primitives
    strokes: Primitives
    eyeball: Tensor
    lids: Tensor
    floor_mm: float


def rotation_matrices(rotation: Tensor) -> Tensor:
    """Rodrigues' formula. ``rotation``: (n, 3) radians -> (n, 3, 3)."""
    angle = torch.sqrt((rotation**2).sum(-1) + 1e-16)[:, None, None]
    x, y, z = (rotation / angle[:, 0]).unbind(-1)
    o = torch.zeros_like(x)
    k = torch.stack([o, -z, y, z, o, -x, -y, x, o], -1).reshape(-1, 3, 3)
    return torch.eye(3, dtype=rotation.dtype) + torch.sin(angle) * k + (1 - torch.cos(angle)) * (k @ k)


def smooth_min(a: Tensor, b: Tensor, k: Tensor | float) -> Tensor:
    """Polynomial smooth minimum of width ``k``; equals ``min`` where ``|a - b| >= k``."""
    h = torch.clamp(k - (a - b).abs(), min=0.0) / k
    return torch.minimum(a, b) - 0.25 * k * h * h


def smooth_max(a: Tensor, b: Tensor, k: Tensor | float) -> Tensor:
    """Polynomial smooth maximum of width ``k``."""
    return -smooth_min(-a, -b, k)


def _ellipsoid(local: Tensor, radius: Tensor) -> Tensor:
    k0 = torch.sqrt(((local / radius) ** 2).sum(-1) + 1e-12)
    k1 = torch.sqrt(((local / radius**2) ** 2).sum(-1) + 1e-18)
    return k0 * (k0 - 1.0) / k1


def _expanded(p: Primitives) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Primitives with their mirror images: centre, log size, rotation matrix, weight, mirrors adjacent."""
    free = torch.where(p.paired[:, None], 1.0, 0.0)
    only_x = torch.tensor([1.0, 0.0, 0.0], dtype=p.centre_mm.dtype)
    only_yz = torch.tensor([0.0, 1.0, 1.0], dtype=p.centre_mm.dtype)
    centre = p.centre_mm * torch.maximum(free, only_yz)
    rotation = p.rotation * torch.maximum(free, only_x)
    flip_c = torch.tensor([-1.0, 1.0, 1.0], dtype=centre.dtype)
    flip_w = torch.tensor([1.0, -1.0, -1.0], dtype=centre.dtype)
    mirrored = torch.nonzero(p.paired)[:, 0]
    order = torch.argsort(torch.cat([torch.arange(len(p.name)) * 2, mirrored * 2 + 1]))
    pick = lambda a, b: torch.cat([a, b], 0)[order]  # noqa: E731
    return (
        pick(centre, centre[mirrored] * flip_c),
        pick(p.log_size, p.log_size[mirrored]),
        rotation_matrices(pick(rotation, rotation[mirrored] * flip_w)),
        pick(p.weight, p.weight[mirrored]),
    )


def masses_field(t: Template, x_mm: Tensor) -> Tensor:
    """Smooth union of the ellipsoids. ``x_mm``: (N, 3) millimetres -> (N,) millimetres."""
    centre, log_size, frame, log_k = _expanded(t.masses)
    offset = torch.einsum("mj,mjk->mk", centre, frame)
    local = (x_mm @ frame.permute(1, 0, 2).reshape(3, -1)).reshape(len(x_mm), -1, 3) - offset
    distance = _ellipsoid(local, torch.exp(log_size))
    k = torch.exp(log_k)
    f, column = distance[:, 0], 0
    for i, paired in enumerate(t.masses.paired.tolist()):
        one = distance[:, column]
        if paired:
            # left and right are joined first: the smooth minimum is not associative, and the head is symmetric
            one = smooth_min(one, distance[:, column + 1], k[column])
        f = one if i == 0 else smooth_min(f, one, k[column])
        column += 2 if paired else 1
    return f


def strokes_field(t: Template, x_mm: Tensor) -> Tensor:
    """Sum of the sculpt strokes' heights. (N, 3) -> (N,) millimetres."""
    centre, log_size, frame, height = _expanded(t.strokes)
    whiten = frame * torch.exp(-log_size)[:, None, :]
    offset = torch.einsum("mj,mjk->mk", centre, whiten)
    local = (x_mm @ whiten.permute(1, 0, 2).reshape(3, -1)).reshape(len(x_mm), -1, 3) - offset
    return torch.exp(-0.5 * (local**2).sum(-1)) @ height


def strokes_near(t: Template, centre_mm: Tensor, radius_mm: float, reach: float = 4.2) -> Template:
    """The template with only the strokes that reach into a ball; the others are below ``exp(-reach^2/2)`` there."""
    p = t.strokes
    folded = torch.cat([centre_mm[:1].abs(), centre_mm[1:]])
    frame = rotation_matrices(p.rotation)
    inverse = torch.exp(-p.log_size)
    # the ball is as wide, in units of the spread along any axis, as radius over the smallest spread that matters
    nearest = torch.zeros(len(p.name), dtype=torch.bool)
    for side in (1.0, -1.0):
        offset = folded * torch.tensor([side, 1.0, 1.0], dtype=p.centre_mm.dtype) - p.centre_mm
        local = torch.einsum("mj,mjk->mk", offset, frame).abs()
        inside = torch.clamp(local - radius_mm, min=0.0) * inverse
        nearest |= (inside**2).sum(-1) < reach**2
    keep = torch.nonzero(nearest)[:, 0]
    strokes = Primitives(
        tuple(p.name[i] for i in keep.tolist()),
        p.paired[keep],
        p.centre_mm[keep],
        p.log_size[keep],
        p.rotation[keep],
        p.weight[keep],
    )
    return Template(t.masses, strokes, t.eyeball, t.lids, t.floor_mm)


def eyeball_field(t: Template, x_mm: Tensor) -> Tensor:
    """Both eyeballs (mirrored by |x|). (N, 3) -> (N,) millimetres."""
    mirrored = torch.cat([x_mm[:, :1].abs(), x_mm[:, 1:]], -1)
    return _ellipsoid(mirrored - t.eyeball[:3], torch.exp(t.eyeball[3:]))


def lid_opening(t: Template, x_mm: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The almond between the lids: signed height over the opening (negative inside), and its two margins.

    Returns ``(opening, below_upper, above_lower)`` in millimetres; ``below_upper`` is y minus the upper margin,
    ``above_lower`` the lower margin minus y. Behind the corners' depth the opening is closed.
    """
    e = t.lids
    x, y, z = x_mm[:, 0].abs(), x_mm[:, 1], x_mm[:, 2]
    u = (2.0 * x - (e[0] + e[3])) / (e[3] - e[0])
    arch = 1.0 - u * u
    line = e[1] + (e[4] - e[1]) * 0.5 * (u + 1.0)
    upper = y - (line + e[6] * arch * (1.0 + e[7] * u))
    lower = (line - e[8] * arch * (1.0 + e[9] * u)) - y
    bottom = e[2] + (e[5] - e[2]) * 0.5 * (u + 1.0) - e[10]
    # beyond the corners the parabolas cross and the opening closes by itself (arch < 0)
    opening = torch.maximum(torch.maximum(upper, lower), bottom - z)
    return opening, upper, lower


def template_field(t: Template, x_mm: Tensor) -> Tensor:
    """The whole head. ``x_mm``: (N, 3) millimetres -> f: (N,) millimetres, negative inside."""
    skin = masses_field(t, x_mm) - strokes_field(t, x_mm)
    opening, _, _ = lid_opening(t, x_mm)
    skin = smooth_max(skin, -opening, torch.exp(t.lids[11]))
    f = smooth_min(skin, eyeball_field(t, x_mm), torch.exp(t.lids[12]))
    return smooth_max(f, t.floor_mm - x_mm[:, 1], 3.0)


def template_to_json(t: Template) -> dict:
    """Named, rounded parameters, as `template_from_json` reads them (the shipped file adds a line on its source)."""

    def rows(p: Primitives) -> list[dict]:
        out = []
        for i, name in enumerate(p.name):
            numbers = {
                "centre_mm": p.centre_mm[i],
                "log_size": p.log_size[i],
                "rotation": p.rotation[i],
                "weight": p.weight[i],
            }
            row: dict = {"name": name, "paired": bool(p.paired[i])}
            row.update({k: [round(float(a), 4) for a in v.reshape(-1)] for k, v in numbers.items()})
            out.append(row)
        return out

    def vector(v: Tensor) -> list[float]:
        return [round(float(a), 4) for a in v]

    return {
        "masses": rows(t.masses),
        "strokes": rows(t.strokes),
        "eyeball": vector(t.eyeball),
        "lids": vector(t.lids),
        "floor_mm": t.floor_mm,
    }


def template_from_json(data: dict, dtype: torch.dtype = torch.float32) -> Template:
    """Inverse of `template_to_json`."""

    def columns(rows: list[dict]) -> Primitives:
        def tensor(key: str) -> Tensor:
            return torch.tensor([r[key] for r in rows], dtype=dtype)

        return Primitives(
            tuple(r["name"] for r in rows),
            torch.tensor([r["paired"] for r in rows], dtype=torch.bool),
            tensor("centre_mm"),
            tensor("log_size"),
            tensor("rotation"),
            tensor("weight")[:, 0],
        )

    return Template(
        columns(data["masses"]),
        columns(data["strokes"]),
        torch.tensor(data["eyeball"], dtype=dtype),
        torch.tensor(data["lids"], dtype=dtype),
        float(data["floor_mm"]),
    )


@lru_cache(maxsize=1)
def load_template() -> Template:
    """The calibrated template that ships with the package."""
    text = resources.files("data_synth").joinpath("data/template.json").read_text(encoding="utf-8")
    return template_from_json(json.loads(text))

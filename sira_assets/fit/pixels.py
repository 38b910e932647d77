"""The portrait as rays in the canonical frame, sorted by what they can tell.

Notation: rays o + t d in network units (UNIT_M canonical metres) with unit d; rgb sRGB-encoded; the silhouette band is
the pixels near the mask's edge, where a ray says where the head ends.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from sira_assets.errors import InputError
from sira_assets.fields.mlp import UNIT_M
from sira_assets.numerics.colour import srgb_from_linear
from sira_assets.scene.canonical import transform_points
from sira_assets.scene.portrait import Portrait

# Below the chin a mask ends where the photo, the clothes or the scan were cut: a background pixel there says nothing.
CUT_Y_M = -0.115
# Pixels this far (canonical metres, at the head's depth) outside the mask still belong to the silhouette band.
BAND_M = 0.02
# Where ears are in the reference space: low and high |x|, y, z, network units. Outwards as far as any hair.
EAR = ((0.76, -0.65, -1.08), (2.4, 0.22, -0.28))
# A pixel with no channel above this (linear: an 8-bit step) was not exposed: it says nothing of the surface's shape.
UNEXPOSED = 1.0 / 255.0 / 12.92


@dataclass(frozen=True)
class PixelRays:
    """N pixels' rays and what the photo says of them."""

    origins: Float[Tensor, "N 3"]
    directions: Float[Tensor, "N 3"]
    rgb: Float[Tensor, "N 3"]
    in_mask: Bool[Tensor, " N"]
    usable: Bool[Tensor, " N"]  # colour neither clipped nor unexposed
    row: Tensor
    column: Tensor

    def __len__(self) -> int:
        return len(self.origins)

    def select(self, index: Tensor) -> "PixelRays":
        """Some of the pixels."""
        return PixelRays(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


def canonical_rays(portrait: Portrait, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Origins and unit directions (N, 3) of the rays through pixel positions (N, 2), centres at +0.5; network units."""
    origins, directions = portrait.camera.rays_world(pixels)
    to_canonical = portrait.canonical_from_world
    directions = directions @ to_canonical[:3, :3].T
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return transform_points(to_canonical, origins) / UNIT_M, directions


def pixel_rays(portrait: Portrait, rows: np.ndarray, columns: np.ndarray, *, device="cpu") -> PixelRays:
    """Rays through pixel centres."""
    origins, directions = canonical_rays(portrait, np.stack([columns + 0.5, rows + 0.5], 1))
    exposed = (portrait.image_linear[rows, columns] > UNEXPOSED).any(-1)
    as_tensor = lambda a, kind=torch.float32: torch.as_tensor(np.ascontiguousarray(a), dtype=kind, device=device)  # noqa: E731
    return PixelRays(
        as_tensor(origins),
        as_tensor(directions),
        as_tensor(srgb_from_linear(portrait.image_linear[rows, columns])),
        as_tensor(portrait.mask[rows, columns], torch.bool),
        as_tensor(~portrait.saturated[rows, columns] & exposed, torch.bool),
        as_tensor(rows, torch.int64),
        as_tensor(columns, torch.int64),
    )


def mask_rays(portrait: Portrait, *, device="cpu") -> PixelRays:
    """All pixels of the mask, row by row."""
    return pixel_rays(portrait, *np.nonzero(portrait.mask), device=device)


def require_pixels(usable: int, in_all: int) -> None:
    """Refuse a portrait of which nothing can be learnt.

    Raises
    ------
    InputError : fewer than a hundred pixels of the mask show the head unclipped.
    """
    if usable < 100:
        raise InputError(
            expected="a hundred usable pixels: of the mask, on the head, not clipped",
            received=f"{usable} usable pixels of {in_all}",
            remedy="check mask, exposure, landmarks and canonical_from_world",
        )


def pixels_per_metre(portrait: Portrait) -> float:
    """Pixels that one canonical metre covers at the head's origin."""
    centre = transform_points(portrait.world_from_canonical, np.zeros((1, 3)))
    _, depth = portrait.camera.project(centre)
    scale = np.cbrt(np.linalg.det(portrait.world_from_canonical[:3, :3]))
    return float(portrait.camera.intrinsics[0, 0] * scale / depth[0])


def silhouette_band(portrait: Portrait) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the band: within BAND_M of the mask's outer edge, less the cut below the chin.

    A hole in the mask is a fault of the mask (a highlight, a pupil, an earring) far more often than a view past the
    head: its pixels say nothing, neither of colour nor of the silhouette.
    """
    from scipy import ndimage

    reach = max(2.0, BAND_M * pixels_per_metre(portrait))
    filled = ndimage.binary_fill_holes(portrait.mask)
    outside = ndimage.distance_transform_edt(~filled)
    inside = ndimage.distance_transform_edt(filled)
    # A mask that touches the picture's border was cropped there; the border is no silhouette.
    rows, columns = np.nonzero((outside <= reach) & (inside <= reach) & (portrait.mask | ~filled))
    rays = pixel_rays(portrait, rows, columns)
    # Height at which a ray crosses the canonical plane z = 0, the plane of the eyes and, nearly, of the silhouette.
    t = -rays.origins[:, 2] / rays.directions[:, 2]
    y = ((rays.origins[:, 1] + t * rays.directions[:, 1]) * UNIT_M).numpy()
    keep = portrait.mask[rows, columns] | (y > CUT_Y_M)
    return rows[keep], columns[keep]


def on_face(x: Float[Tensor, "N 3"]) -> Bool[Tensor, " N"]:
    """Which points (N, 3), network units, lie on the front within 7.5 cm of the face's middle."""
    away = x - x.new_tensor([0.0, -0.4, 0.0])
    return (away[:, :2].norm(dim=-1) < 0.75) & (x[:, 2] > 0.2)


def on_ears(x_ref: Float[Tensor, "N 3"]) -> Bool[Tensor, "N 2"]:
    """Which points of the reference space, network units, lie on the right ear or outwards of it, which on the left."""
    folded = torch.cat([x_ref[:, :1].abs(), x_ref[:, 1:]], -1)
    low, high = (x_ref.new_tensor(corner) for corner in EAR)
    either = ((folded > low) & (folded < high)).all(-1)
    return torch.stack([either & (x_ref[:, 0] < 0), either & (x_ref[:, 0] > 0)], -1)


def face_weight(rays: PixelRays) -> Float[Tensor, " N"]:
    """How often a pixel is drawn: 3 where its ray crosses the plane z = 3 cm within 7.5 cm of the face, else 1."""
    t = (0.3 - rays.origins[:, 2]) / rays.directions[:, 2]
    crossing = rays.origins + t[:, None] * rays.directions
    centre = crossing.new_tensor([0.0, -0.4])
    return torch.where((crossing[:, :2] - centre).norm(dim=-1) < 0.75, 3.0, 1.0)

"""Draw hero.png from an exported avatar of the bundled portrait: python docs/draw_hero.py AVATAR_DIR

Photo, fitted geometry, diffuse albedo, the avatar under the light found, and under two lights it never saw. The last
three are the exported field, relit by closed-form shading with cast shadows.
"""

import json
import struct
import sys
from pathlib import Path

import numpy as np

from sira_assets.fields.fitted import load_fitted
from sira_assets.mesh.extract import extract_mesh
from sira_assets.numerics.colour import srgb_from_linear
from sira_assets.render.view import render_view
from sira_assets.render.visibility_table import surface_visibility
from sira_assets.scene.bundled import bundled_portrait
from sira_assets.scene.image import read_image, write_png
from sira_assets.scene.sg_light import SGLight

# Axes in the camera's frame: x right, y up, z towards the camera.
LIGHTS = {
    "sunset": SGLight([[-0.9, 0.1, 0.4], [0.6, 0.5, 0.2]], [12.0, 1.5], [[9.0, 4.0, 1.6], [0.9, 1.2, 2.2]]),
    "window": SGLight([[0.8, 0.5, 0.35], [0.0, 1.0, 0.0]], [25.0, 0.5], [[16.0, 17.0, 19.0], [0.6, 0.6, 0.65]]),
}


def main(avatar: Path) -> None:
    """Write docs/hero.png."""
    glb = (avatar / "avatar.glb").read_bytes()
    (length,) = struct.unpack("<I", glb[12:16])
    described = json.loads(glb[20 : 20 + length])
    roughness = described["materials"][0]["pbrMetallicRoughness"]["roughnessFactor"]
    canonical_from_world = np.array(described["scenes"][0]["extras"]["canonical_from_world"], float).reshape(4, 4)
    portrait, head = bundled_portrait(), load_fitted(avatar / "field.safetensors")
    mesh = extract_mesh(head)
    panels = [srgb_from_linear(portrait.image_linear)]
    panels += [srgb_from_linear(read_image(avatar / "renders" / f"{n}.png").linear) for n in ("geometry", "albedo")]
    found = SGLight.from_dict(json.loads((avatar / "lights.json").read_text()))
    world_from_view = portrait.camera.world_from_camera[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    for light in (found, *(light.rotated(world_from_view) for light in LIGHTS.values())):
        shadows = surface_visibility(mesh, light, canonical_from_world)
        view = render_view(head, mesh, portrait.camera, canonical_from_world, light, roughness, shadows=shadows)
        panels.append(srgb_from_linear(view.final))
    rows, columns = np.nonzero(portrait.mask)
    top, left = max(rows.min() - 25, 0), max(columns.min() - 40, 0)
    bottom, right = min(rows.max() + 60, portrait.camera.height), min(columns.max() + 40, portrait.camera.width)
    write_png(Path(__file__).parent / "hero.png", np.concatenate([p[top:bottom, left:right] for p in panels], 1))


if __name__ == "__main__":
    main(Path(sys.argv[1]))

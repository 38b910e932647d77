"""The same scene in Mitsuba 3, an independent path tracer: diffuse vertex colours under an environment map."""

import numpy as np

from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.camera import Camera
from sira_assets.scene.envmap import envmap_from_sg
from sira_assets.scene.sg_light import SGLight


def trace_diffuse(
    mesh: TriangleMesh, albedo: np.ndarray, camera: Camera, light: SGLight, *, samples: int
) -> np.ndarray:
    """Radiance (H, W, 3): direct light with shadows, box pixel filter, interpolated vertex normals.

    The camera has square pixels and its principal point at the centre.
    """
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(
        {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}}
    )
    shape = mi.Mesh("head", len(mesh.vertices), len(mesh.faces), properties, has_vertex_normals=True)
    shape.add_attribute("vertex_color", 3, np.ascontiguousarray(albedo, np.float32).ravel())
    buffers = mi.traverse(shape)
    buffers["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    buffers["vertex_normals"] = mesh.normals.astype(np.float32).ravel()
    buffers["faces"] = mesh.faces.astype(np.uint32).ravel()
    buffers.update()
    # Mitsuba's camera looks along +z with x to the left and y up.
    to_world = camera.world_from_camera @ np.diag([-1.0, -1.0, 1.0, 1.0])
    radiance = envmap_from_sg(light, 512).radiance
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "sensor": {
                "type": "perspective",
                "fov_axis": "x",
                "fov": float(np.degrees(2 * np.arctan(camera.width / (2 * camera.intrinsics[0, 0])))),
                "near_clip": 0.01,
                "to_world": mi.ScalarTransform4f(to_world),
                "film": {
                    "type": "hdrfilm",
                    "width": camera.width,
                    "height": camera.height,
                    "rfilter": {"type": "box"},
                    "pixel_format": "rgb",
                    "component_format": "float32",
                },
                "sampler": {"type": "multijitter", "sample_count": samples},
            },
            "light": {"type": "envmap", "bitmap": mi.Bitmap(radiance)},
            "head": shape,
        }
    )
    integrator = mi.load_dict({"type": "path", "max_depth": 2, "hide_emitters": True})
    return np.array(mi.render(scene, integrator=integrator, spp=samples))[..., :3]

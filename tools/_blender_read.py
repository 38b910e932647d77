"""Runs inside Blender: import files, write down what was understood, and render each from the portrait's camera.

Notation: Blender's importers turn Y up into Z up, (x, y, z) -> (x, -z, y); everything written here is turned back.

    python _blender_read.py JOB.json                      # a Python that has the module bpy
    blender --background --python _blender_read.py -- JOB.json

JOB.json: files (paths), out (folder), envmap (path or null), camera (scene.extras.camera or null), samples, threads.
For files[k] it writes out/k.npz (corners (F, 3, 3), uv (F, 3, 2), base (H, W, 3) uint8), out/k.json (pictures by slot)
and, given camera and envmap, out/k.exr. This file imports nothing of the project: Blender has its own Python.
"""

import json
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

# (x, y, z) of the file's world to Blender's.
BLENDER_FROM_FILE = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


def load(path):
    """Import one file into an empty scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    suffix = Path(path).suffix.lower()
    if suffix == ".glb":
        bpy.ops.import_scene.gltf(filepath=path)
    elif suffix == ".obj":
        bpy.ops.wm.obj_import(filepath=path)
    else:
        # Without this the scene is scaled to metres; the file's own numbers are compared here.
        bpy.ops.wm.usd_import(filepath=path, apply_unit_conversion_scale=False)


def geometry():
    """Corners (F, 3, 3) in the file's world and UVs (F, 3, 2), origin bottom left, of all meshes."""
    corners, uv = [], []
    for thing in bpy.data.objects:
        if thing.type != "MESH":
            continue
        mesh = thing.data
        mesh.calc_loop_triangles()
        points = np.empty(3 * len(mesh.vertices), np.float32)
        mesh.vertices.foreach_get("co", points)
        pose = np.linalg.inv(BLENDER_FROM_FILE) @ np.array(thing.matrix_world)
        points = points.reshape(-1, 3).astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
        triangles, loops = (np.empty(3 * len(mesh.loop_triangles), np.int32) for _ in range(2))
        mesh.loop_triangles.foreach_get("vertices", triangles)
        mesh.loop_triangles.foreach_get("loops", loops)
        corners.append(points[triangles].reshape(-1, 3, 3))
        coordinates = np.zeros(2 * len(mesh.loops), np.float32)
        if mesh.uv_layers:
            mesh.uv_layers.active.data.foreach_get("uv", coordinates)
        uv.append(coordinates.reshape(-1, 2)[loops].reshape(-1, 3, 2))
    return np.concatenate(corners), np.concatenate(uv)


def picture_behind(socket, depth=0):
    """The image whose texture node feeds a socket, through whatever lies between."""
    for link in socket.links if depth < 8 else ():
        node = link.from_node
        if node.bl_idname == "ShaderNodeTexImage":
            return node.image
        for other in node.inputs:
            found = picture_behind(other, depth + 1)
            if found is not None:
                return found
    return None


def surface_pictures():
    """{slot of the Principled BSDF: image}."""
    found = {}
    for material in bpy.data.materials:
        for node in material.node_tree.nodes if material.node_tree else ():
            if node.bl_idname == "ShaderNodeBsdfPrincipled":
                found |= {s.name: picture_behind(s) for s in node.inputs if picture_behind(s) is not None}
    return found


def texels(image):
    """(H, W, 3) uint8 codes, row 0 on top."""
    width, height = image.size
    values = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(values)
    values = values.reshape(height, width, image.channels)[::-1, :, :3]
    return np.rint(255 * np.clip(values, 0, 1)).astype(np.uint8)


def light_by(envmap):
    """The panorama as the world's light; Blender's centre is +X, ours the file's +Z, Blender's -Y: a quarter turn."""
    world = bpy.data.worlds.new("world")
    bpy.context.scene.world = world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    picture = nodes.new("ShaderNodeTexEnvironment")
    picture.image = bpy.data.images.load(envmap)
    mapping = nodes.new("ShaderNodeMapping")
    mapping.inputs["Rotation"].default_value[2] = np.pi / 2
    links.new(nodes.new("ShaderNodeTexCoord").outputs["Generated"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], picture.inputs["Vector"])
    background = nodes.new("ShaderNodeBackground")
    links.new(picture.outputs["Color"], background.inputs["Color"])
    links.new(background.outputs["Background"], nodes.new("ShaderNodeOutputWorld").inputs["Surface"])


def look_through(said):
    """The portrait's pinhole camera, principal point and all."""
    lens, pose = np.array(said["intrinsics"]), np.array(said["world_from_camera"])
    width, height = said["width"], said["height"]
    camera = bpy.data.cameras.new("portrait")
    camera.sensor_fit = "HORIZONTAL"
    camera.lens = camera.sensor_width * lens[0, 0] / width
    camera.shift_x = 0.5 - lens[0, 2] / width
    camera.shift_y = (lens[1, 2] - 0.5 * height) / width
    camera.clip_start, camera.clip_end = 1e-3, 1e4
    thing = bpy.data.objects.new("portrait", camera)
    thing.matrix_world = Matrix((BLENDER_FROM_FILE @ pose @ np.diag([1.0, -1.0, -1.0, 1.0])).tolist())
    scene = bpy.context.scene
    scene.collection.objects.link(thing)
    scene.camera = thing
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.render.resolution_percentage = 100
    scene.render.pixel_aspect_y = lens[0, 0] / lens[1, 1]


def render(path, samples, threads):
    """Cycles on the processor: direct light with shadows, as relight renders; linear EXR with alpha."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = samples
    scene.cycles.use_denoising = False
    scene.cycles.max_bounces = 0
    scene.cycles.pixel_filter_type = "BOX"
    scene.render.film_transparent = True
    scene.render.threads_mode, scene.render.threads = "FIXED", threads
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)


def main():
    job = json.loads(Path(sys.argv[-1]).read_text())
    for k, path in enumerate(job["files"]):
        load(path)
        corners, uv = geometry()
        pictures = surface_pictures()
        base = pictures.get("Base Color")
        arrays = {} if base is None else {"base": texels(base)}
        np.savez(Path(job["out"]) / f"{k}.npz", corners=corners, uv=uv, **arrays)
        said = {slot: [image.name, *image.size, image.colorspace_settings.name] for slot, image in pictures.items()}
        (Path(job["out"]) / f"{k}.json").write_text(json.dumps({"version": bpy.app.version_string, "pictures": said}))
        if job["camera"] and job["envmap"]:
            light_by(job["envmap"])
            look_through(job["camera"])
            render(Path(job["out"]) / f"{k}.exr", job["samples"], job["threads"])


main()

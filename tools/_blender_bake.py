"""Blender's bake of a dense surface's vertex colours onto a coarse one: BLENDER_PYTHON _blender_bake.py IN.npz OUT.npz.

Run by a Python that has `bpy`; `measure_bake.py --blender` calls it. In: vertices, faces, corner_uv (F, 3, 2),
dense_vertices, dense_faces, dense_colours (V, 3), size, samples. Out: texture (S, S, 3) row 0 on top, seconds.
"""

import sys
import time

import bpy
import numpy as np


def add_mesh(name, vertices, faces):
    """A mesh object of these triangles."""
    data = bpy.data.meshes.new(name)
    data.from_pydata(vertices.tolist(), [], faces.tolist())
    data.update()
    for polygon in data.polygons:
        polygon.use_smooth = True
    made = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(made)
    return made


def main(source, target):
    """Build the scene, bake its emission, write."""
    given = np.load(source)
    size = int(given["size"])
    bpy.ops.wm.read_factory_settings(use_empty=True)
    coarse = add_mesh("coarse", given["vertices"], given["faces"])
    layer = coarse.data.uv_layers.new(name="atlas")
    layer.data.foreach_set("uv", given["corner_uv"].astype(np.float32).reshape(-1))
    dense = add_mesh("dense", given["dense_vertices"], given["dense_faces"])
    colours = dense.data.color_attributes.new(name="Col", type="FLOAT_COLOR", domain="POINT")
    rgba = np.column_stack([given["dense_colours"], np.ones(len(given["dense_colours"]))]).astype(np.float32)
    colours.data.foreach_set("color", rgba.reshape(-1))

    shown = bpy.data.materials.new("shown")
    shown.use_nodes = True
    nodes, links = shown.node_tree.nodes, shown.node_tree.links
    nodes.clear()
    attribute, emission = nodes.new("ShaderNodeVertexColor"), nodes.new("ShaderNodeEmission")
    attribute.layer_name = "Col"
    output = nodes.new("ShaderNodeOutputMaterial")
    links.new(attribute.outputs["Color"], emission.inputs["Color"])
    links.new(emission.outputs[0], output.inputs["Surface"])
    dense.data.materials.append(shown)

    picture = bpy.data.images.new("picture", size, size, float_buffer=True)
    picture.colorspace_settings.name = "Non-Color"
    baked = bpy.data.materials.new("baked")
    baked.use_nodes = True
    node = baked.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = picture
    baked.node_tree.nodes.active = node
    coarse.data.materials.append(baked)

    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = int(given["samples"])
    scene.render.threads_mode, scene.render.threads = "FIXED", 2
    for thing in (dense, coarse):
        thing.select_set(True)
    bpy.context.view_layer.objects.active = coarse
    started, cpu = time.monotonic(), time.process_time()
    bpy.ops.object.bake(
        type="EMIT",
        use_selected_to_active=True,
        cage_extrusion=0.003,
        max_ray_distance=0.006,
        margin=16,
        margin_type="EXTEND",
    )
    seconds, cpu = time.monotonic() - started, time.process_time() - cpu
    pixels = np.empty(size * size * 4, np.float32)
    picture.pixels.foreach_get(pixels)
    np.savez(target, texture=pixels.reshape(size, size, 4)[::-1, :, :3], seconds=seconds, cpu=cpu)


if __name__ == "__main__":
    main(*sys.argv[1:])

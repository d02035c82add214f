"""What tests/renderers/test_blender.py has Blender do: python in_blender.py JOBS.json, with the Python that has bpy.

A job is one of
  {"open": FILE}                                        an exported file's material becomes the one that is used
  {"run": FILE}                                         the same, as Blender's text editor runs it
  {"add_on": ZIP, "import": FILE}                       installs an add-on and imports with it
  {"save": FILE}                                        saves what there is, and opens it again
  {"render": NPY, "scene": NPZ, "size": N, "samples": N, "seed": N, "controls": {SOCKET: VALUE}}
"""

import json
import math
import pathlib
import runpy
import sys

import bpy
import numpy as np


def used():
    return bpy.data.materials["Pearl"]


def mesh_of(scene):
    mesh = bpy.data.meshes.new("shape")
    mesh.from_pydata(scene["vertices"].tolist(), [], scene["faces"].tolist())
    mesh.shade_smooth()
    mesh.normals_split_custom_set_from_vertices(scene["normals"].tolist())
    return mesh


def emitter(scene):
    material = bpy.data.materials.new("light")
    if material.node_tree is None:
        material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    emission, output = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    emission.inputs["Strength"].default_value = float(scene["area_radiance"])
    material.node_tree.links.new(emission.outputs[0], output.inputs["Surface"])
    mesh = bpy.data.meshes.new("light")
    mesh.from_pydata(scene["area"].tolist(), [], [(0, 1, 2, 3)])
    mesh.materials.append(material)
    return mesh


def world_of(scene):
    world = bpy.data.worlds.new("sky")
    if world.node_tree is None:
        world.use_nodes = True
    nodes = world.node_tree.nodes
    background = next(node for node in nodes if node.type == "BACKGROUND")
    if "sky" not in scene:
        background.inputs["Color"].default_value = (0, 0, 0, 1)
        return world
    sky = scene["sky"]
    image = bpy.data.images.new("sky", sky.shape[1], sky.shape[0], float_buffer=True, is_data=True)
    pixels = np.ones((*sky.shape[:2], 4), np.float32)
    pixels[..., :3] = sky[::-1]
    image.pixels.foreach_set(pixels.ravel())
    texture = nodes.new("ShaderNodeTexEnvironment")
    texture.image = image
    world.node_tree.links.new(texture.outputs["Color"], background.inputs["Color"])
    return world


def render(job):
    for thing in list(bpy.data.objects):
        bpy.data.objects.remove(thing)
    given = np.load(job["scene"])
    scene = bpy.context.scene
    add = lambda name, data: scene.collection.objects.link(bpy.data.objects.new(name, data)) or bpy.data.objects[name]
    shape = mesh_of(given)
    shape.materials.append(used())
    add("shape", shape)
    if "area" in given:
        add("light", emitter(given)).visible_camera = False
    scene.world = world_of(given)
    camera = bpy.data.cameras.new("camera")
    camera.angle = float(given["fov"])
    eye = add("camera", camera)
    eye.location = given["origin"].tolist()
    eye.rotation_mode = "QUATERNION"
    import mathutils

    eye.rotation_quaternion = (-mathutils.Vector(given["origin"].tolist())).to_track_quat("-Z", "Y")
    scene.camera = eye
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.device, cycles.samples, cycles.seed = "CPU", job["samples"], job["seed"]
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.max_bounces, cycles.pixel_filter_type = job.get("bounces", 0), "BOX"
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.blur_glossy = 0.0
    cycles.light_sampling_threshold = 0.0
    scene.render.film_transparent = True
    scene.render.resolution_x = scene.render.resolution_y = job["size"]
    scene.render.resolution_percentage = 100
    scene.render.threads_mode, scene.render.threads = "FIXED", 2
    settings = scene.render.image_settings
    settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGBA"
    group = next(node for node in used().node_tree.nodes if node.type == "GROUP")
    for name, value in job.get("controls", {}).items():
        group.inputs[name].default_value = value
    target = pathlib.Path(job["render"])
    scene.render.filepath = str(target.with_suffix(".exr"))
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    image.colorspace_settings.name = "Non-Color"
    size = job["size"]
    pixels = np.empty(size * size * 4, np.float32)
    image.pixels.foreach_get(pixels)
    # Top row first.
    np.save(target, pixels.reshape(size, size, 4)[::-1])


def forget():
    for material in list(bpy.data.materials):
        bpy.data.materials.remove(material)


def main(jobs):
    for job in jobs:
        if "open" in job:
            forget()
            module = runpy.run_path(job["open"], run_name="pearl")
            module["material_of"](module["pearl_of"](pathlib.Path(job["open"]).read_text(encoding="utf-8")))
        elif "run" in job:
            forget()
            runpy.run_path(job["run"], run_name="__main__")
        elif "add_on" in job:
            forget()
            bpy.ops.extensions.package_install_files(filepath=job["add_on"], repo="user_default", enable_on_install=True)
            # An operator's error comes as an exception with its text.
            try:
                bpy.ops.import_scene.pearl(filepath=job["import"])
            except RuntimeError as why:
                print("refused:", why)
        elif "save" in job:
            used().use_fake_user = True
            bpy.ops.wm.save_as_mainfile(filepath=job["save"])
            bpy.ops.wm.read_homefile(use_empty=True)
            bpy.ops.wm.open_mainfile(filepath=job["save"])
        else:
            render(job)
    print("done", bpy.app.version_string, math.nan if not bpy.data.materials else used().name)


if __name__ == "__main__":
    main(json.loads(pathlib.Path(sys.argv[1]).read_text()))

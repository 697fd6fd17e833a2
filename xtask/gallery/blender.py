"""Renders one file of the gallery in Blender's Cycles with Lumistack's camera and light, as linear EXR pictures.

    python blender.py FOLDER/ours.json [threads]

Reads FOLDER/ours.json and environment.exr. Writes FOLDER/blender-a.exr and blender-b.exr (half of the samples each,
different seeds), FOLDER/covered.npy (for every pixel the fraction that surfaces cover) and FOLDER/blender.json.

glTF's y up becomes Blender's z up: (x, y, z) -> (x, -z, y). Lights are imported as "Unitless" (COMPAT): W/sr for candela, W/m^2 for lux,
as in Lumistack's path tracer. Two deviations of the importer from the format are corrected, so that only the rendering
differs. Surfaces without a material get glTF's default material. Glass absorbs -ln(attenuationColor)/attenuationDistance.
"""

import hashlib
import json
import math
import os
import sys
import time

import bpy
import mathutils
import numpy

BLENDER_FROM_GLTF = mathutils.Matrix.Rotation(math.pi / 2, 4, "X")


def main():
    path = os.path.abspath(sys.argv[1])
    folder = os.path.dirname(path)
    with open(path) as file:
        ours = json.load(file)
    said = {"blender": bpy.app.version_string, "asked": asked(ours, folder)}
    try:
        with open(os.path.join(folder, "blender.json")) as file:
            if json.load(file).get("asked") == said["asked"]:
                return
    except (OSError, ValueError):
        pass
    if "error" in ours:
        return
    try:
        said.update(render(ours, folder, int(sys.argv[2]) if len(sys.argv) > 2 else 0))
    except Exception as error:  # the importer raises exceptions of any type
        said["error"] = str(error).strip().splitlines()[-1]
    with open(os.path.join(folder, "blender.json"), "w") as file:
        json.dump(said, file, indent=1)


def asked(ours, folder):
    """Computes a digest of all inputs of the pictures."""
    keys = ["path", "size", "samples", "max_bounces", "animated", "environment", "reach", "window"]
    digest = hashlib.sha256(json.dumps([ours.get(key) for key in keys]).encode())
    for path in [ours["path"], __file__, os.path.join(folder, "environment.exr")]:
        if os.path.exists(path):
            with open(path, "rb") as file:
                digest.update(file.read())
    return digest.hexdigest()


def render(ours, folder, threads):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if not ours["animated"]:
        rest()
    start = time.monotonic()
    if os.path.splitext(ours["path"])[1].startswith(".usd"):
        bpy.ops.wm.usd_import(filepath=ours["path"], import_proxy=False, import_guide=False, apply_unit_conversion_scale=False)
    else:
        bpy.ops.import_scene.gltf(
            filepath=ours["path"], export_import_convert_lighting_mode="COMPAT", disable_bone_shape=True
        )
        default_material()
        absorption()
    imported = time.monotonic() - start
    scene = bpy.context.scene
    camera(scene, ours)
    world(scene, ours, folder)
    settings(scene, ours, threads)
    seconds = 0.0
    for seed, name in enumerate(["blender-a", "blender-b"], start=1):
        start = time.monotonic()
        scene.cycles.seed = seed
        picture(scene, os.path.join(folder, name + ".exr"), "RGB")
        seconds += time.monotonic() - start
    coverage(scene, folder)
    return {"seconds_import": imported, "seconds_render": seconds}


def rest():
    """Removes animations before the import. So nodes, joints and morph targets have the values that the file's nodes state."""
    from io_scene_gltf2.io.imp.gltf2_io_gltf import glTFImporter

    read = glTFImporter.read

    def read_still(self):
        read(self)
        self.data.animations = None

    glTFImporter.read = read_still


def default_material():
    """Gives surfaces without a material glTF's default material: fully rough white metal."""
    white = bpy.data.materials.new("glTF default")
    white.use_nodes = True
    shader = white.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    shader.inputs["Metallic"].default_value = shader.inputs["Roughness"].default_value = 1.0
    for held in bpy.data.objects:
        if held.type == "MESH" and not any(slot.material for slot in held.material_slots):
            held.data.materials.clear()
            held.data.materials.append(white)


def absorption():
    """Corrects the absorption of glass.

    Cycles absorbs density * (1 - color). The importer sets density = 1/attenuationDistance and color = attenuationColor, but
    glTF wants -ln(attenuationColor)/attenuationDistance.
    """
    for material in bpy.data.materials:
        for node in material.node_tree.nodes if material.use_nodes else []:
            if node.type != "VOLUME_ABSORPTION":
                continue
            color, density = node.inputs["Color"].default_value, node.inputs["Density"]
            wanted = [-math.log(max(channel, 1e-6)) * density.default_value for channel in color[:3]]
            density.default_value = max(wanted)
            if max(wanted) > 0.0:
                node.inputs["Color"].default_value = (*(1.0 - w / max(wanted) for w in wanted), 1.0)


def camera(scene, ours):
    window = ours["window"]
    x, y, z, w = window["rotation"]
    pose = mathutils.Quaternion((w, x, y, z)).to_matrix().to_4x4()
    pose.translation = mathutils.Vector(window["centre"])
    camera = bpy.data.cameras.new("window")
    camera.type = "ORTHO"
    camera.sensor_fit = "HORIZONTAL"
    camera.ortho_scale = window["width"]
    camera.clip_start = 1e-4 * ours["reach"]
    camera.clip_end = 2.0 * ours["reach"]
    camera.dof.use_dof = False
    held = bpy.data.objects.new("window", camera)
    held.matrix_world = BLENDER_FROM_GLTF @ pose @ mathutils.Matrix.Translation((0, 0, ours["reach"]))
    scene.collection.objects.link(held)
    scene.camera = held


def world(scene, ours, folder):
    world = bpy.data.worlds.new("light")
    scene.world = world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    background = nodes["Background"]
    if ours["environment"] is None:
        background.inputs["Strength"].default_value = 0.0
        return
    picture = nodes.new("ShaderNodeTexEnvironment")
    picture.image = bpy.data.images.load(os.path.join(folder, "environment.exr"))
    picture.image.colorspace_settings.name = "Linear Rec.709"
    # the centre of an environment map of Lumistack looks along -z, which is Blender's +y; the
    # centre of a map of Blender looks along +x
    x, y, z, w = ours["environment"]["rotation"]
    turned = mathutils.Quaternion((w, x, y, z)).to_matrix().to_4x4()
    scene_from_map = BLENDER_FROM_GLTF @ turned @ BLENDER_FROM_GLTF.inverted()
    lookup = mathutils.Matrix.Rotation(-math.pi / 2, 4, "Z") @ scene_from_map.inverted()
    mapping = nodes.new("ShaderNodeMapping")
    mapping.vector_type = "POINT"
    mapping.inputs["Rotation"].default_value = lookup.to_euler("XYZ")
    direction = nodes.new("ShaderNodeTexCoord")
    links.new(direction.outputs["Generated"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], picture.inputs["Vector"])
    links.new(picture.outputs["Color"], background.inputs["Color"])


def settings(scene, ours, threads):
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = ours["size"]
    scene.render.resolution_percentage = 100
    scene.render.threads_mode = "FIXED" if threads else "AUTO"
    if threads:
        scene.render.threads = threads
    scene.view_settings.view_transform = "Raw"
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.samples = max(ours["samples"] // 2, 1)
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = False
    cycles.pixel_filter_type = "BOX"
    cycles.filter_width = 1.0
    # do not clamp or blur
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.blur_glossy = 0.0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.light_sampling_threshold = 0.0
    # Cycles does not count the bounce at the first hit, so its limit is one less than Lumistack's.
    for kind in ["max", "diffuse", "glossy", "transmission"]:
        setattr(cycles, kind + "_bounces", ours["max_bounces"] - 1)
    cycles.transparent_max_bounces = 256


def picture(scene, path, mode):
    image = scene.render.image_settings
    image.file_format = "OPEN_EXR"
    image.color_mode = mode
    image.color_depth = "32"
    image.exr_codec = "ZIP"
    scene.render.filepath = path
    bpy.ops.render.render(write_still=True)


def coverage(scene, folder):
    """Measures the covered fraction of every pixel, from the alpha of a short render without background."""
    scene.render.film_transparent = True
    scene.cycles.film_transparent_glass = False
    scene.cycles.samples = 16
    scene.cycles.max_bounces = 0
    path = os.path.join(folder, "covered.exr")
    picture(scene, path, "RGBA")
    image = bpy.data.images.load(path)
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    values = numpy.empty(width * height * 4, dtype=numpy.float32)
    image.pixels.foreach_get(values)
    # Blender's first row is the lowest
    numpy.save(os.path.join(folder, "covered.npy"), values.reshape(height, width, 4)[::-1, :, 3].copy())
    os.remove(path)


main()

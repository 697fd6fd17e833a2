"""Renders the view of `cargo xtask bench render` in Blender's Cycles, on the CPU. `view.py` describes the requests."""
import os
import sys
import tempfile
import time

import bpy
import numpy as np
import view
from mathutils import Matrix, Vector

v = view.View(sys.argv[1])
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene


def material(about):
    made = bpy.data.materials.new("diffuse")
    made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    out, diffuse = tree.nodes.new("ShaderNodeOutputMaterial"), tree.nodes.new("ShaderNodeBsdfDiffuse")
    diffuse.inputs["Roughness"].default_value = 0.0
    tree.links.new(diffuse.outputs["BSDF"], out.inputs["Surface"])
    picture = v.image(about)
    if picture:
        texture = tree.nodes.new("ShaderNodeTexImage")
        texture.image = bpy.data.images.load(picture, check_existing=True)
        tree.links.new(texture.outputs["Color"], diffuse.inputs["Color"])
    else:
        diffuse.inputs["Color"].default_value = (*about["color"], 1.0)
    return made


def add_mesh(about, index):
    positions, triangles, uvs = v.arrays(about)
    made = bpy.data.meshes.new(f"mesh_{index}")
    made.vertices.add(len(positions))
    made.vertices.foreach_set("co", np.ravel(positions))
    made.loops.add(triangles.size)
    made.loops.foreach_set("vertex_index", np.ravel(triangles).astype(np.int32))
    made.polygons.add(len(triangles))
    made.polygons.foreach_set("loop_start", np.arange(0, triangles.size, 3, dtype=np.int32))
    layer = made.uv_layers.new()
    flipped = uvs[np.ravel(triangles)] * np.float32([1, -1]) + np.float32([0, 1])
    layer.uv.foreach_set("vector", np.ravel(flipped).astype(np.float32))
    made.update(calc_edges=True)
    made.shade_flat()
    made.materials.append(material(about))
    scene.collection.objects.link(bpy.data.objects.new(made.name, made))


def frame(x, y, z, origin):
    made = Matrix.Identity(4)
    for column, vector in enumerate((x, y, z, origin)):
        for row in range(3):
            made[row][column] = vector[row]
    return made


def add_lamp():
    """Adds the rectangle light as a lamp, for scenes in which it need not be exact. A lamp has less noise than a mesh that emits light, but
    it is 1 % too bright in Blender 5.0.1.

    The squared error is 2.7e-5 with the lamp and 3.5e-5 with the mesh, on FlightHelmet at 16 samples per pixel.
    """
    corner, (u, w) = np.array(v.light["corner"]), np.array(v.light["edges"])
    lamp = bpy.data.lights.new("light", "AREA")
    lamp.shape = "RECTANGLE"
    lamp.size, lamp.size_y = np.linalg.norm(u), np.linalg.norm(w)
    # a diffuse emitter of radiance L and area A has the power π L A
    lamp.energy = v.light["radiance"] * lamp.size * lamp.size_y * np.pi
    lamp.cycles.max_bounces = 1024
    lamp.use_shadow = True
    placed = bpy.data.objects.new("light", lamp)
    x, y = u / np.linalg.norm(u), w / np.linalg.norm(w)
    # a lamp shines along its -z
    placed.matrix_world = frame(x, -y, -np.cross(x, y), corner + (u + w) / 2)
    scene.collection.objects.link(placed)


def add_shining_mesh():
    corner, (u, w) = np.array(v.light["corner"]), np.array(v.light["edges"])
    made = bpy.data.meshes.new("light")
    made.from_pydata([corner, corner + u, corner + u + w, corner + w], [], [(0, 1, 2, 3)])
    shining = bpy.data.materials.new("light")
    shining.use_nodes = True
    tree = shining.node_tree
    tree.nodes.clear()
    out, emission = tree.nodes.new("ShaderNodeOutputMaterial"), tree.nodes.new("ShaderNodeEmission")
    emission.inputs["Strength"].default_value = v.light["radiance"]
    tree.links.new(emission.outputs["Emission"], out.inputs["Surface"])
    made.materials.append(shining)
    scene.collection.objects.link(bpy.data.objects.new("light", made))


def add_camera():
    made = bpy.data.cameras.new("camera")
    made.sensor_fit = "HORIZONTAL"
    placed = bpy.data.objects.new("camera", made)
    scene.collection.objects.link(placed)
    scene.camera = placed


def aim(about):
    eye, camera = np.array(about["eye"]), scene.camera.data
    camera.angle = about["fov_x_rad"]
    camera.shift_x, camera.shift_y = about["shift"]
    camera.clip_start, camera.clip_end = 1e-3 * np.linalg.norm(eye), 1e4 * np.linalg.norm(eye)
    scene.camera.matrix_world = frame(about["right"], about["up"], about["backward"], Vector(eye))


def configure():
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = v.cols, v.rows
    scene.render.resolution_percentage = 100
    scene.render.use_persistent_data = True
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.threads_mode = "FIXED"
    scene.render.threads = len(os.sched_getaffinity(0))
    world = bpy.data.worlds.new("sky")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (v.sky, v.sky, v.sky, 1.0)
    scene.world = world
    c = scene.cycles
    c.device = "CPU"
    c.use_adaptive_sampling = c.use_denoising = c.use_auto_tile = False
    c.max_bounces = c.diffuse_bounces = view.BOUNCES_AFTER_FIRST_HIT
    c.sample_clamp_direct = c.sample_clamp_indirect = 0.0
    c.min_light_bounces = 1024
    c.light_sampling_threshold = 0.0
    c.pixel_filter_type = "BOX"
    # width of the box filter, pixels
    c.filter_width = 1.0


for n, about in enumerate(v.meshes):
    add_mesh(about, n)
add_shining_mesh() if v.exact else add_lamp()
add_camera()
configure()
folder = tempfile.mkdtemp()


def timed(samples, seed):
    scene.cycles.samples = samples
    scene.cycles.seed = seed
    path = os.path.join(folder, "view.exr")
    scene.render.filepath = path
    start, cpu = time.perf_counter(), time.process_time()
    bpy.ops.render.render(write_still=True)
    seconds, cpu_s = time.perf_counter() - start, time.process_time() - cpu
    loaded = bpy.data.images.load(path)
    picture = np.empty(v.rows * v.cols * 4, dtype=np.float32)
    loaded.pixels.foreach_get(picture)
    bpy.data.images.remove(loaded)
    return seconds, cpu_s, picture.reshape(v.rows, v.cols, 4)[::-1]


def render(sampler, samples, seed, view):
    # A render with one sample takes the time of the fixed work (preparing the scene, writing the
    # file) and of one sample. The longer render also takes the time of its other samples. So the
    # difference of the two times is the time of `samples` - 1 samples. The factor `share` scales
    # this difference to all samples.
    aim(v.cameras[view])
    start, start_cpu, _ = timed(1, seed)
    seconds, cpu_s, picture = timed(samples, seed)
    share = samples / max(samples - 1, 1)
    return (seconds - start) * share, (cpu_s - start_cpu) * share, picture


aim(v.cameras[0])
timed(1, 1)
view.serve(f"Cycles {bpy.app.version_string}", ["default"], render)

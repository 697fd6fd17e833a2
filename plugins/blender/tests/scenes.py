# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes for the tests, and a small display that shows them."""

import math

import bpy

#: A display file: 96 × 60 pixels, 3 × 3 views; lengths in millimetres.
DISPLAY = """name = "three small layers"
frames = 3
refresh_hz = 180.0
brightness = 0.5

[backlight]
kind = "uniform"

[field]
resolution = [96, 60]
pitch_mm = 2.0
views = [3, 3]
fov_deg = [24.0, 18.0]

[[layers]]
d_mm = -12.0
resolution = [96, 60]
pitch_mm = 2.0

[[layers]]
d_mm = 0.0
resolution = [96, 60]
pitch_mm = 2.0

[[layers]]
d_mm = 12.0
resolution = [96, 60]
pitch_mm = 2.0
"""


def empty():
    # Unlike read_factory_settings, this keeps extensions enabled.
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = 16
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False
    scene.cycles.pixel_filter_type = "BOX"
    scene.cycles.filter_width = 1.0
    # Do not clamp or drop light.
    scene.cycles.sample_clamp_direct = scene.cycles.sample_clamp_indirect = 0.0
    scene.cycles.blur_glossy = 0.0
    scene.cycles.light_sampling_threshold = 0.0
    # Cycles does not count the bounce at the first hit, so its limit is one less than Lumistack's
    # default, 6.
    for kind in ("max", "diffuse", "glossy", "transmission"):
        setattr(scene.cycles, kind + "_bounces", 5)
    world = bpy.data.worlds.new("world")
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    scene.world = world
    background(0.0)
    return scene


def background(value):
    node = bpy.context.scene.world.node_tree.nodes["Background"]
    node.inputs["Color"].default_value = (value, value, value, 1.0)


def material(name, colour=(0.8, 0.8, 0.8), glow=0.0):
    made = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0, 0):
        made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*colour, 1.0)
    shader.inputs["Roughness"].default_value = 1.0
    shader.inputs["Metallic"].default_value = 0.0
    shader.inputs["Specular IOR Level"].default_value = 0.0
    if glow:
        shader.inputs["Base Color"].default_value = (0.0, 0.0, 0.0, 1.0)
        shader.inputs["Emission Color"].default_value = (*colour, 1.0)
        shader.inputs["Emission Strength"].default_value = glow
    return made


def add(kind, look, **where):
    getattr(bpy.ops.mesh, f"primitive_{kind}_add")(**where)
    held = bpy.context.object
    held.data.materials.append(look)
    return held


def camera(name="camera", focus=4.0, orthographic=False):
    """Adds a camera at the left and above, which looks roughly along +y. It is slightly rotated
    about its optical axis."""
    data = bpy.data.cameras.new(name)
    data.dof.use_dof = True
    data.dof.focus_distance = focus
    if orthographic:
        data.type, data.ortho_scale = "ORTHO", 3.0
    else:
        data.lens = 40.0
    held = bpy.data.objects.new(name, data)
    held.location = (-1.0, -4.0, 1.0)
    held.rotation_euler = (math.radians(78.0), math.radians(4.0), math.radians(-14.0))
    bpy.context.scene.collection.objects.link(held)
    bpy.context.scene.camera = held
    bpy.context.view_layer.update()
    return held


def shapes(look):
    """Adds shapes in front of the window, in its plane, and behind it."""
    add("uv_sphere", look, radius=0.35, location=(-0.7, 0.4, 0.15), segments=48, ring_count=24)
    add("cube", look, size=0.5, location=(0.35, -0.7, 0.25), rotation=(0.3, 0.5, 0.2))
    add("cone", look, radius1=0.35, depth=0.8, location=(0.55, 1.6, 0.5), vertices=40)
    add("torus", look, major_radius=0.3, minor_radius=0.09, location=(-0.15, 0.9, 0.75), rotation=(0.8, 0.3, 0.0))


def silhouettes():
    scene = empty()
    shapes(material("white", (1.0, 1.0, 1.0), glow=1.0))
    camera()
    return scene


def diffuse():
    """Makes a diffuse scene with a sun, an area light, a round lamp and a grey world."""
    scene = empty()
    background(0.25)
    shapes(material("clay", (0.6, 0.5, 0.4)))
    floor = add("plane", material("floor", (0.35, 0.4, 0.45)), size=9.0, location=(0.0, 1.0, -0.4))
    floor.rotation_euler = (0.05, 0.0, 0.1)
    lamp("SUN", 0.5, rotation=(0.5, 0.3, 0.0))
    area = lamp("AREA", 30.0, location=(-1.0, 0.2, 2.6), rotation=(0.2, -0.3, 0.1))
    area.data.shape, area.data.size, area.data.size_y = "RECTANGLE", 1.2, 0.7
    ball = lamp("POINT", 12.0, location=(1.4, -0.6, 1.6))
    ball.data.shadow_soft_size, ball.data.color = 0.15, (1.0, 0.8, 0.6)
    camera()
    return scene


def lamp(kind, energy, location=(0.0, 0.0, 3.0), rotation=(0.0, 0.0, 0.0)):
    data = bpy.data.lights.new(kind.lower(), kind)
    data.energy = energy
    if kind == "SUN":
        data.angle = 0.0
    held = bpy.data.objects.new(kind.lower(), data)
    held.location, held.rotation_euler = location, rotation
    bpy.context.scene.collection.objects.link(held)
    return held


def beyond():
    """Makes a scene with content that glTF cannot express: a noise texture, an unsupported shader,
    hair, and smoke in a box. It also contains a plain cube."""
    scene = diffuse()
    bark = material("bark", (0.5, 0.5, 0.5))
    tree = bark.node_tree
    noise, ramp = tree.nodes.new("ShaderNodeTexNoise"), tree.nodes.new("ShaderNodeValToRGB")
    noise.inputs["Scale"].default_value = 12.0
    ramp.color_ramp.elements[0].color, ramp.color_ramp.elements[1].color = (0.6, 0.05, 0.02, 1.0), (0.05, 0.5, 0.1, 1.0)
    for name, element in ((0, 0.45), (1, 0.55)):
        ramp.color_ramp.elements[name].position = element
    tree.links.new(noise.outputs[0], ramp.inputs["Fac"])
    tree.links.new(ramp.outputs["Color"], tree.nodes["Principled BSDF"].inputs["Base Color"])
    chalk = material("chalk", (0.5, 0.5, 0.5))
    powder = chalk.node_tree.nodes.new("ShaderNodeBsdfDiffuse")
    powder.inputs["Color"].default_value = (0.1, 0.2, 0.8, 1.0)
    chalk.node_tree.links.new(powder.outputs[0], chalk.node_tree.nodes["Material Output"].inputs["Surface"])
    bpy.data.objects["Sphere"].data.materials[0] = bark
    bpy.data.objects["Cone"].data.materials[0] = chalk
    head = bpy.data.objects["Sphere"]
    bpy.context.view_layer.objects.active = head
    fur = head.modifiers.new("fur", "PARTICLE_SYSTEM").particle_system.settings
    fur.type, fur.count, fur.hair_length = "HAIR", 400, 0.25
    smoke = material("smoke", (0.5, 0.5, 0.5))
    inside = smoke.node_tree.nodes.new("ShaderNodeVolumePrincipled")
    inside.inputs["Density"].default_value = 3.0
    output = smoke.node_tree.nodes["Material Output"]
    smoke.node_tree.links.remove(output.inputs["Surface"].links[0])
    smoke.node_tree.links.new(inside.outputs[0], output.inputs["Volume"])
    box = add("cube", smoke, size=0.6, location=(-0.6, -0.6, 0.8))
    box.name = "smoke"
    return scene


def every_kind(folder):
    """Adds, to the scene of `diffuse`, data of every kind that a render reads: attributes, node curves, a
    picture, geometry nodes, hair, points, and Grease Pencil."""
    kinds = bpy.data.collections.new("kinds")
    bpy.context.scene.collection.children.link(kinds)

    def link(name, data):
        kinds.objects.link(bpy.data.objects.new(name, data))
        return bpy.data.objects[name]

    # Attributes, and a modifier with another level in renders.
    bpy.data.objects["Plane"].name = "floor"
    cube = bpy.data.objects["Cube"].data
    cube.color_attributes.new("paint", "BYTE_COLOR", "CORNER")
    cube.attributes.new("wear", "FLOAT", "POINT")
    bpy.data.objects["Cone"].modifiers.new("smooth", "SUBSURF").levels = 0
    # A material with curves, a color ramp, a value, and a picture.
    many = material("many")
    nodes, links = many.node_tree.nodes, many.node_tree.links
    for kind, name in (("RGBCurve", "curves"), ("ValToRGB", "ramp"), ("Value", "value"), ("TexImage", "image")):
        nodes.new(f"ShaderNode{kind}").name = name
    picture = bpy.data.images.new("picture", 4, 4)
    picture.filepath_raw, picture.file_format = str(folder / "picture.png"), "PNG"
    picture.save()
    nodes["image"].image = picture
    links.new(nodes["value"].outputs[0], nodes["ramp"].inputs[0])
    links.new(nodes["ramp"].outputs[0], nodes["curves"].inputs["Color"])
    links.new(nodes["curves"].outputs[0], nodes["Principled BSDF"].inputs["Base Color"])
    cube.materials.append(many)
    # Geometry nodes that set a material, and that make points.
    for name, owner, node, kind in (("paint", "Torus", "set", "SetMaterial"), ("dots", "Cone", "points", "MeshToPoints")):
        group = bpy.data.node_groups.new(name, "GeometryNodeTree")
        group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
        group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
        given, made, result = group.nodes.new("NodeGroupInput"), group.nodes.new(f"GeometryNode{kind}"), group.nodes.new("NodeGroupOutput")
        made.name = node
        group.links.new(given.outputs[0], made.inputs[0])
        group.links.new(made.outputs[0], result.inputs[0])
        held = link(name, bpy.data.objects[owner].data.copy())
        held.modifiers.new(name, "NODES").node_group = group
    bpy.data.node_groups["paint"].nodes["set"].inputs["Material"].default_value = many
    # Hair as curves and as particles, and a stroke.
    curls = bpy.data.hair_curves.new("curls")
    curls.add_curves([3, 3])
    link("curls", curls)
    head = link("head", bpy.data.objects["Cone"].data.copy())
    fur = head.modifiers.new("fur", "PARTICLE_SYSTEM").particle_system.settings
    fur.type, fur.count, fur.hair_length = "HAIR", 5, 0.25
    pencils = getattr(bpy.data, "grease_pencils_v3", bpy.data.grease_pencils)
    pencil = pencils.new("pencil")
    frame = pencil.layers.new("layer").frames.new(1)
    if hasattr(frame, "drawing"):
        frame.drawing.add_strokes([3])
    else:
        frame.strokes.new().points.add(3)
    link("pencil", pencil)
    bpy.context.view_layer.update()


def stroke_of(pencil):
    """Returns the points of a Grease Pencil's drawing."""
    frame = pencil.layers[0].frames[0]
    return frame.drawing.attributes["position"].data if hasattr(frame, "drawing") else frame.strokes[0].points


def compositor(value):
    """Makes the scene's compositor, which sets the picture's brightness to a value."""
    scene = bpy.context.scene
    if hasattr(scene, "compositing_node_group"):
        tree = bpy.data.node_groups.get("compositor") or bpy.data.node_groups.new("compositor", "CompositorNodeTree")
        scene.compositing_node_group = tree
    else:
        scene.use_nodes = True
        tree = scene.node_tree
    node = tree.nodes.get("bright") or tree.nodes.new("CompositorNodeBrightContrast")
    node.name = "bright"
    node.inputs[1].default_value = value

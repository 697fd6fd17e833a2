"""Exports Blender's active scene as one .glb file, with lights.

Blender's exporter writes meshes and materials at the current frame, with modifiers, poses and shape
keys applied. This module adds the lights in the units of Cycles: watts W become

    sun             irradiance W                          directional light
    point           W / (4 pi) per steradian              point light; with a radius r a ball of
                                                          radiance W / (4 pi^2 r^2)
    spot            W / (4 pi) per steradian              spot light
    area A          radiance W / (pi A)                   a surface that emits from its front
    world           its radiance                          environment

For a light with a surface, the file also states if cameras see the surface. Cameras are exported
with their plane of focus, the scene's own camera first. Content that cannot be exported causes a
warning.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from .glb import Glb
from .rig import TEMPORARY, focus_of
from .unshown import is_rendered, is_volume_alone

#: Width and height, in pixels, of the picture of a world that is not a plain colour.
SKY = (512, 256)
SKY_SAMPLES = 32
#: Number of rings of a ball that emits light, and number of corners of a disk that emits light.
RINGS, CORNERS = 8, 24
Warn = Callable[[str, str], None]
Rows = list[list[float]]


def export_scene(bpy: Any, path: str | Path, warn: Warn, scene: Any = None) -> None:
    """Writes a scene, by default the active scene, at the current frame. Calls warn(place, message)
    for content that is left out."""
    scene = scene or bpy.context.scene
    with in_window(bpy, scene), _as_rendered(bpy):
        _export_meshes(bpy, path)
        file = Glb.read(path)
        file.drop_flat_triangles()
        _add_lights(bpy, scene, file, warn)
        _add_cameras(bpy, scene, file, warn)
    _add_world(bpy, scene, file, warn)
    for image in bpy.data.images:
        if image.source == "FILE" and image.users and not image.packed_file and not image.has_data:
            if not Path(bpy.path.abspath(image.filepath, library=image.library)).is_file():
                warn(image.name, f"the picture {image.filepath} is missing; surfaces that use the picture have no texture")
    for library in bpy.data.libraries:
        if not Path(bpy.path.abspath(library.filepath)).is_file():
            warn(library.name, f"the library {library.filepath} is missing; objects that are linked from the library are left out")
    file.write(path)


@contextlib.contextmanager
def in_window(bpy: Any, scene: Any) -> Iterator[None]:
    """Gives exporters a context with a window that shows the scene. Exporters need a window, and the
    context of a command (`blender --command`) has none."""
    window = bpy.context.window
    if window is not None and bpy.context.screen is not None and bpy.context.scene == scene:
        yield
        return
    windows = [each for manager in bpy.data.window_managers for each in manager.windows]
    if not windows:
        raise RuntimeError("expected an open window of Blender, which exporters need, found none; start Blender with a file that has a window")
    window = window or windows[0]
    shown = window.scene
    # The exporter reads the scene of the window.
    window.scene = scene
    try:
        with bpy.context.temp_override(window=window, screen=window.screen, scene=scene, view_layer=window.view_layer):
            yield
    finally:
        window.scene = shown


def files_of(bpy: Any) -> tuple[list[str], list[str]]:
    """Returns the existing and the missing files that the scene depends on: libraries, pictures,
    fonts, caches of geometry."""
    named = [(data, data.library) for kind in ("images", "cache_files", "volumes", "fonts") for data in getattr(bpy.data, kind, ())]
    named += [(library, None) for library in bpy.data.libraries]
    named += [(modifier, held.library) for held in bpy.data.objects for modifier in held.modifiers if modifier.type == "MESH_CACHE"]
    found: set[str] = set()
    missing: set[str] = set()
    for data, library in named:
        name = data.filepath
        # Blender's built-in font has a name in angle brackets, and no file.
        if name and not name.startswith("<") and not getattr(data, "packed_file", None):
            path = Path(bpy.path.abspath(name, library=library))
            (found if path.is_file() else missing).add(str(path))
    return sorted(found), sorted(missing)


def untracked(bpy: Any) -> str | None:
    """Returns a description of input that `files_of` does not list, so that its changes cannot be
    detected. Returns None for most scenes."""
    for image in bpy.data.images:
        if image.users and image.source in ("SEQUENCE", "TILED"):
            return f"{image.name}: a picture of many files"
    for data in (*bpy.data.cache_files, *bpy.data.volumes):
        if getattr(data, "is_sequence", False):
            return f"{data.name}: a sequence of files"
    for held in bpy.data.objects:
        for modifier in held.modifiers:
            caches = [getattr(modifier, "point_cache", None), getattr(getattr(modifier, "particle_system", None), "point_cache", None)]
            on_disk = any(cache is not None and (cache.use_disk_cache or cache.use_external) for cache in caches)
            if modifier.type == "FLUID" or on_disk or getattr(modifier, "is_cached", False) or len(getattr(modifier, "bakes", ())):
                return f"{held.name}: the modifier {modifier.name}, whose cache may be on disk"
    return None


@contextlib.contextmanager
def _as_rendered(bpy: Any) -> Iterator[None]:
    """Shows the scene in the viewport as a render would show it, since the exporter reads the settings
    for the viewport. Restores these settings at the end."""
    changed: list[tuple[Any, str, Any]] = []
    added: list[tuple[Any, Any]] = []

    def change(held: Any, name: str, value: Any) -> None:
        old = getattr(held, name, None)
        if old is not None and old != value:
            changed.append((held, name, old))
            setattr(held, name, value)

    try:
        for held in bpy.context.scene.objects:
            if is_volume_alone(held):
                # The domain of a smoke simulation is invisible, but would be exported as a white
                # box.
                change(held, "hide_render", True)
            for modifier in held.modifiers:
                change(modifier, "show_viewport", modifier.show_render)
                if modifier.type in ("SUBSURF", "MULTIRES"):
                    change(modifier, "levels", modifier.render_levels)
            if held.mode == "EDIT":
                held.update_from_editmode()
                # In Edit Mode a mesh has no texture coordinates, but its evaluated copy has them.
                # The exporter uses the copy if the object has a modifier. So add a modifier without
                # effect.
                modifier = held.modifiers.new(TEMPORARY, "DISPLACE") if held.type == "MESH" else None
                if modifier is not None:
                    modifier.strength = 0.0
                    added.append((held, modifier))
        bpy.context.view_layer.update()
        yield
    finally:
        for held, modifier in added:
            held.modifiers.remove(modifier)
        for held, name, value in reversed(changed):
            setattr(held, name, value)


def _export_meshes(bpy: Any, path: str | Path) -> None:
    settings = {
        "export_format": "GLB",
        "use_selection": False,
        "use_visible": False,
        "use_renderable": True,
        "use_active_scene": True,
        "export_apply": True,
        "export_yup": True,
        "export_cameras": False,
        "export_lights": False,
        "export_animations": False,
        "export_skins": False,
        "export_morph": True,
        "export_current_frame": True,
        "export_rest_position_armature": False,
        "export_gn_mesh": True,
        "export_extras": False,
        "export_draco_mesh_compression_enable": False,
        "export_use_gltfpack": False,
        "will_save_settings": False,
    }
    known = bpy.ops.export_scene.gltf.get_rna_type().properties.keys()
    # The exporter ends the Edit Mode of the active object, so hide this object from it.
    with bpy.context.temp_override(active_object=None, object=None):
        bpy.ops.export_scene.gltf(filepath=str(path), **{name: value for name, value in settings.items() if name in known})


def y_up(matrix: Any) -> Rows:
    """Converts a matrix of Blender to glTF's axes."""
    rows = [[float(value) for value in row] for row in matrix]
    return [rows[0], rows[2], [-value for value in rows[1]], rows[3]]


def _add_lights(bpy: Any, scene: Any, file: Glb, warn: Warn) -> None:
    placed = []
    for instance in bpy.context.evaluated_depsgraph_get().object_instances:
        held = instance.object
        if held.type == "LIGHT" and is_rendered(held.original):
            placed.append((held.original, instance.matrix_world.copy()))
    there = {held for held, _ in placed}
    # Add lights that the viewport hides and a render shows.
    placed += [(held, held.matrix_world) for held in scene.objects if held.type == "LIGHT" and held not in there and is_rendered(held)]
    for held, matrix in placed:
        _add_light(held, matrix, file, warn)


def _add_light(held: Any, matrix: Any, file: Glb, warn: Warn) -> None:
    light, name = held.data, held.name
    power = _power(light, name, warn)
    if not max(power) > 0.0:
        return
    seen = getattr(held, "visible_camera", True)
    # Without `normalize`, Cycles interprets the power as power per area.
    area = light.area(matrix_world=matrix) if hasattr(light, "area") else None
    if not getattr(light, "normalize", True) and light.type != "SUN" and area:
        power = [value * area for value in power]
    # Convert each type with the table at the top of this file.
    if light.type == "SUN":
        file.add_light(name, y_up(matrix), {"type": "directional", "color": [1.0, 1.0, 1.0], **_strength(power)})
    elif light.type == "SPOT":
        outer = min(light.spot_size / 2, math.pi / 2)
        cone = {"outerConeAngle": outer, "innerConeAngle": outer * (1.0 - light.spot_blend)}
        file.add_light(name, y_up(matrix), {"type": "spot", "spot": cone, **_strength(power, 4 * math.pi)})
    elif light.type == "POINT" and light.shadow_soft_size <= 0.0:
        file.add_light(name, y_up(matrix), {"type": "point", **_strength(power, 4 * math.pi)})
    elif light.type == "POINT":
        radius = light.shadow_soft_size
        positions, triangles = ball(radius)
        file.add_glow(name, y_up(_without_scale(matrix)), positions, triangles, [value / (2 * math.pi * radius) ** 2 for value in power], seen)
    elif light.type == "AREA":
        width = light.size
        height = light.size_y if light.shape in ("RECTANGLE", "ELLIPSE") else width
        round_shape = light.shape in ("DISK", "ELLIPSE")
        positions, triangles = panel(width, height, round_shape)
        across = (matrix.col[0].xyz * width).cross(matrix.col[1].xyz * height).length * (math.pi / 4 if round_shape else 1.0)
        if not across > 0.0:
            warn(name, "the area light has no area and is left out")
            return
        if light.spread < math.radians(179.0):
            warn(name, f"the area light's spread of {math.degrees(light.spread):.0f}° is taken as 180°")
        file.add_glow(name, y_up(matrix), positions, triangles, [value / (math.pi * across) for value in power], seen)
    else:
        warn(name, f"the light is left out, since its type {light.type.lower()} is not supported")


def _power(light: Any, name: str, warn: Warn) -> list[float]:
    power = [light.energy * 2.0 ** getattr(light, "exposure", 0.0) * channel for channel in light.color]
    if getattr(light, "use_temperature", False):
        power = [value * channel for value, channel in zip(power, light.temperature_color, strict=False)]
    if not light.use_nodes or light.node_tree is None:
        return power
    outputs = [node for node in light.node_tree.nodes if node.type == "OUTPUT_LIGHT" and node.is_active_output]
    links = outputs[0].inputs["Surface"].links if outputs else ()
    if not links:
        return [0.0, 0.0, 0.0]
    node = links[0].from_node
    if node.type != "EMISSION" or node.inputs["Color"].is_linked or node.inputs["Strength"].is_linked:
        warn(name, "the light's nodes are not supported; the light's power and colour are used instead")
        return power
    strength, colour = node.inputs["Strength"].default_value, node.inputs["Color"].default_value
    return [value * strength * channel for value, channel in zip(power, colour, strict=False)]


def _strength(power: Sequence[float], over: float = 1.0) -> dict[str, object]:
    brightest = max(power)
    return {"color": [value / brightest for value in power], "intensity": brightest / over}


def ball(radius: float) -> tuple[list[list[float]], list[list[int]]]:
    """Returns a ball of triangles. It has the area of the exact sphere, so it emits the same
    power."""
    columns = 2 * RINGS
    positions = [[0.0, 0.0, radius]]
    for ring in range(1, RINGS):
        z, across = math.cos(math.pi * ring / RINGS), math.sin(math.pi * ring / RINGS)
        for column in range(columns):
            turn = 2 * math.pi * column / columns
            positions.append([radius * across * math.cos(turn), radius * across * math.sin(turn), radius * z])
    positions.append([0.0, 0.0, -radius])
    triangles = []
    last = len(positions) - 1
    for column in range(columns):
        after = (column + 1) % columns
        triangles.append([0, 1 + column, 1 + after])
        for ring in range(RINGS - 2):
            top, below = 1 + ring * columns, 1 + (ring + 1) * columns
            triangles += [[top + column, below + column, below + after], [top + column, below + after, top + after]]
        under = 1 + (RINGS - 2) * columns
        triangles.append([last, under + after, under + column])
    grow = math.sqrt(4 * math.pi * radius * radius / surface(positions, triangles))
    return [[grow * value for value in position] for position in positions], triangles


def panel(width: float, height: float, is_round: bool) -> tuple[list[list[float]], list[list[int]]]:
    """Returns triangles of a rectangle or an ellipse in the plane z = 0, facing -z. Their area is the
    exact area of the shape."""
    if not is_round:
        x, y = width / 2, height / 2
        return [[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]], [[0, 2, 1], [0, 3, 2]]
    turns = [2 * math.pi * corner / CORNERS for corner in range(CORNERS)]
    grow = math.sqrt(2 * math.pi / CORNERS / math.sin(2 * math.pi / CORNERS))
    edge = [[grow * width / 2 * math.cos(turn), grow * height / 2 * math.sin(turn), 0.0] for turn in turns]
    return [[0.0, 0.0, 0.0], *edge], [[0, 1 + (corner + 1) % CORNERS, 1 + corner] for corner in range(CORNERS)]


def surface(positions: Sequence[Sequence[float]], triangles: Sequence[Sequence[int]]) -> float:
    """Returns the area of triangles."""
    total = 0.0
    for a, b, c in triangles:
        u = [positions[b][axis] - positions[a][axis] for axis in range(3)]
        v = [positions[c][axis] - positions[a][axis] for axis in range(3)]
        cross = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
        total += math.sqrt(sum(part * part for part in cross)) / 2
    return total


def _without_scale(matrix: Any) -> Any:
    """Removes the scale from a matrix. A point light's ball does not scale with its object."""
    return matrix.normalized()


def _add_cameras(bpy: Any, scene: Any, file: Glb, warn: Warn) -> None:
    cameras = [held for held in scene.objects if held.type == "CAMERA" and held is not scene.camera]
    if scene.camera is not None and scene.camera.type == "CAMERA":
        cameras.insert(0, scene.camera)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for held in cameras:
        frame = [tuple(corner) for corner in held.data.view_frame(scene=scene)]
        xs, ys = [corner[0] for corner in frame], [corner[1] for corner in frame]
        width, height = max(xs) - min(xs), max(ys) - min(ys)
        if held.data.type == "PERSP":
            yfov = 2 * math.atan2(height / 2, abs(frame[0][2]))
            camera: dict[str, Any] = {"type": "perspective", "perspective": {"yfov": yfov, "aspectRatio": width / height, "znear": held.data.clip_start}}
        elif held.data.type == "ORTHO":
            lens = {"xmag": width / 2, "ymag": height / 2, "znear": 0.0, "zfar": held.data.clip_end}
            camera = {"type": "orthographic", "orthographic": lens}
        else:
            warn(held.name, f"the camera is left out, since its type {held.data.type.lower()} is not supported")
            continue
        if abs(max(xs) + min(xs)) > 1e-3 * width or abs(max(ys) + min(ys)) > 1e-3 * height:
            warn(held.name, "the camera's picture is shifted; the camera is exported without the shift")
        matrix = held.evaluated_get(depsgraph).matrix_world.normalized()
        file.add_camera(held.name, y_up(matrix), camera, focus_of(bpy, held))


def _add_world(bpy: Any, scene: Any, file: Glb, warn: Warn) -> None:
    world = scene.world
    if world is None:
        return
    colour = plain_colour(world)
    if colour is None:
        width, height, texels = _picture_of_world(bpy, scene)
    else:
        width, height, texels = 8, 4, [colour] * 32
    if any(max(texel) > 0.0 for texel in texels):
        file.set_environment(width, height, texels)
    if world.node_tree is not None and any(
        node.type == "OUTPUT_WORLD" and node.inputs["Volume"].is_linked for node in world.node_tree.nodes
    ):
        warn(world.name, "the world's volume is not supported and is left out")


def plain_colour(world: Any) -> list[float] | None:
    """Returns the radiance of a uniform world; None for a world whose radiance is not uniform."""
    if not world.use_nodes or world.node_tree is None:
        return [float(channel) for channel in world.color]
    outputs = [node for node in world.node_tree.nodes if node.type == "OUTPUT_WORLD" and node.is_active_output]
    links = outputs[0].inputs["Surface"].links if outputs else ()
    if not links:
        return [0.0, 0.0, 0.0]
    node = links[0].from_node
    if node.type != "BACKGROUND" or node.inputs["Color"].is_linked or node.inputs["Strength"].is_linked:
        return None
    strength = node.inputs["Strength"].default_value
    return [float(channel) * strength for channel in node.inputs["Color"].default_value[:3]]


def _picture_of_world(bpy: Any, scene: Any) -> tuple[int, int, list[list[float]]]:
    """Renders the world with Cycles in a temporary scene. Returns width, height and texels, with rows
    from the top; the middle column looks along Blender's +y."""
    import tempfile

    import numpy

    # Set up a panoramic camera in a temporary scene.
    width, height = SKY
    place = bpy.data.scenes.new("Lumistack world")
    data = bpy.data.cameras.new("Lumistack world")
    held = bpy.data.objects.new("Lumistack world", data)
    image = None
    try:
        place.collection.objects.link(held)
        place.camera, place.world = held, scene.world
        held.rotation_euler = (math.pi / 2, 0.0, 0.0)
        data.type = "PANO"
        owner = data if hasattr(data, "panorama_type") else data.cycles
        owner.panorama_type = "EQUIRECTANGULAR"
        # Render linear values without any processing.
        render = place.render
        render.engine = "CYCLES"
        render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
        render.use_compositing = render.use_sequencer = False
        render.film_transparent = False
        render.use_file_extension = False
        place.cycles.samples, place.cycles.use_denoising = SKY_SAMPLES, False
        place.frame_current = scene.frame_current
        settings = render.image_settings
        if hasattr(settings, "media_type"):
            settings.media_type = "IMAGE"
        settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGB", "32"
        # Render to a file, since Blender does not give access to the values of a render.
        with tempfile.TemporaryDirectory() as folder:
            render.filepath = str(Path(folder) / "world.exr")
            bpy.ops.render.render(write_still=True, scene=place.name)
            image = bpy.data.images.load(render.filepath)
            values = numpy.empty(width * height * 4, dtype=numpy.float32)
            image.pixels.foreach_get(values)
        # Blender stores the lowest row first, so reverse the rows.
        texels: list[list[float]] = values.reshape(height, width, 4)[::-1, :, :3].reshape(-1, 3).tolist()
        return width, height, texels
    finally:
        if image is not None:
            bpy.data.images.remove(image)
        bpy.data.objects.remove(held, do_unlink=True)
        bpy.data.cameras.remove(data)
        bpy.data.scenes.remove(place)

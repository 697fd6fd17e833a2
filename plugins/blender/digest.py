# SPDX-License-Identifier: GPL-3.0-or-later
"""A digest of all data that a render depends on. Views from an earlier run are still valid if the
digest is the same.

Objects are read after Blender has evaluated modifiers, drivers and animation. Geometry enters the
digest with its attributes, and meshes also with the normals of their corners. Other data enter it
with their properties that are booleans, numbers, texts or enums, except those in `_SKIP`. Curves,
color ramps and similar parts (`_PARTS`) enter it in the same way. Pictures and volumes also enter it
with the size and time of their files.
"""

from __future__ import annotations

import hashlib
import os
import struct

import bpy

_PLAIN = {"BOOLEAN", "INT", "FLOAT", "STRING", "ENUM"}
#: Properties that do not affect a picture.
_SKIP = {
    "rna_type", "name_full", "session_uid", "is_evaluated", "is_library_indirect", "is_missing", "is_runtime_data", "tag", "use_fake_user",
    "use_extra_user", "users", "is_embedded_data", "original", "select", "show_options", "show_preview", "show_texture", "location_absolute",
    "warning_propagation", "width", "height", "hide", "is_editable", "ui_shortcut", "is_icon_custom", "use_auto_refresh", "location",
    # Settings that every render of a view sets, or that do not affect its picture.
    "filepath", "resolution_x", "resolution_y", "resolution_percentage", "pixel_aspect_x", "pixel_aspect_y", "use_border", "use_multiview",
    "use_sequencer", "use_stamp", "use_overwrite", "use_placeholder", "use_file_extension", "display_mode", "use_lock_interface", "threads", "threads_mode",
    "preview_samples", "use_preview_denoising", "frame_path", "is_movie_format", "file_extension",
    # Values that Blender changes when it draws a window or renders a frame.
    "dimensions", "frame_current", "active_aov_index", "active_lightgroup_index",
}  # fmt: skip
#: Properties of objects that affect a picture, besides their geometry and materials.
_OBJECT = {
    "matrix_world", "visible_camera", "visible_diffuse", "visible_glossy", "visible_transmission", "visible_volume_scatter", "visible_shadow", "is_shadow_catcher",
    "is_holdout", "pass_index", "color", "show_instancer_for_render", "shadow_terminator_normal_offset", "shadow_terminator_geometry_offset",
    "shadow_terminator_shading_offset",
}  # fmt: skip
#: Properties of modifiers and curves that a render uses instead of the 3D view's properties.
_AT_RENDER = {"show_render", "render_levels", "render_steps", "render_resolution", "render_resolution_u", "render_resolution_v"}
#: Properties of a particle system that affect its hair, besides its settings.
_HAIR = {"name", "seed", "child_seed", "use_hair_dynamics"}
#: Names of the types whose properties enter the digest as parts of a data block, node or settings.
#: The types of Cycles have the prefix `_OF_CYCLES`.
_PARTS = {"ColorManagedInputColorspaceSettings", "ColorMapping", "ColorRamp", "CurveMapping", "ImageUser", "MaterialGPencilStyle", "RaytraceEEVEE", "TexMapping", "VolumeRender"}
_OF_CYCLES = "Cycles"
_MESHES = {"MESH", "CURVE", "SURFACE", "FONT", "META"}
#: The property of a node's socket that contains the socket's value.
_INPUT = "default_value"


def digest(scene) -> str:
    """Returns the digest of a scene at its current frame."""
    hasher = _Hasher()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    # Geometry nodes may make several shapes for an object: a mesh, curves, points and instances.
    shapes: set[tuple[str, int]] = set()
    for instance in depsgraph.object_instances:
        held = instance.object
        if held.original.name.startswith("Lumistack view"):
            continue
        hasher.text(held.name)
        hasher.floats(value for row in instance.matrix_world for value in row)
        hasher.text(str(held.original.hide_render))
        shape = held.name, held.data.as_pointer() if held.data is not None else 0
        if shape not in shapes:
            shapes.add(shape)
            hasher.object(held)
    hasher.block(scene.world)
    for settings in (scene.render, getattr(scene, "cycles", None), getattr(scene, "cycles_curves", None), getattr(scene, "eevee", None), scene.view_settings):
        if settings is not None:
            hasher.plain(settings)
            hasher.parts(settings)
    for layer in scene.view_layers:
        hasher.plain(layer)
        hasher.parts(layer)
        hasher.collections(layer.layer_collection)
    if scene.render.use_compositing:
        hasher.block(_compositor(scene))
    hasher.text(bpy.app.version_string)
    return hasher.sha.hexdigest()


def _compositor(scene):
    """Returns the nodes of the compositor, or None if the scene does not use them."""
    if hasattr(scene, "compositing_node_group"):
        return scene.compositing_node_group
    return scene.node_tree if scene.use_nodes else None


class _Hasher:
    def __init__(self) -> None:
        self.sha = hashlib.sha256()
        self._seen: set[int] = set()

    def text(self, text: str) -> None:
        data = text.encode("utf-8", "surrogateescape")
        self.sha.update(struct.pack("<q", len(data)) + data)

    def floats(self, values) -> None:
        for value in values:
            self.sha.update(struct.pack("<d", value))

    def plain(self, held, only: set[str] | None = None) -> None:
        """Adds the properties of `held` that are booleans, numbers, texts or enums. If `only` is
        given, it skips properties whose names are not in `only`."""
        for prop in held.bl_rna.properties:
            name = prop.identifier
            if prop.type not in _PLAIN or name in _SKIP or (only is not None and name not in only):
                continue
            try:
                value = getattr(held, name)
                if getattr(prop, "is_array", False):
                    value = [tuple(row) if hasattr(row, "__len__") else row for row in value]
            except (AttributeError, RuntimeError, TypeError):
                continue
            self.text(f"{name}={value!r}" if not isinstance(value, set) else f"{name}={sorted(value)!r}")

    def parts(self, held) -> None:
        """Adds the parts of `held` that have properties of their own, and the data blocks to which `held`
        refers."""
        for prop in held.bl_rna.properties:
            if prop.type != "POINTER" or prop.identifier in _SKIP:
                continue
            part = getattr(held, prop.identifier, None)
            if part is None:
                continue
            kind = part.bl_rna.identifier
            if isinstance(part, (bpy.types.Image, bpy.types.NodeTree, bpy.types.Material, bpy.types.World)):
                self.block(part)
            elif isinstance(part, bpy.types.Text):
                self.text(part.as_string())
            elif isinstance(part, bpy.types.ID):
                self.text(f"{prop.identifier}={part.name}")
            elif kind in _PARTS or kind.startswith(_OF_CYCLES):
                self.text(prop.identifier)
                # Blender copies properties of Cycles to evaluated data only with other changes, so
                # read them from the original data block.
                is_late = kind.startswith(_OF_CYCLES) and isinstance(held, bpy.types.ID)
                self.plain(getattr(held.original, prop.identifier) if is_late else part)
                for element in getattr(part, "elements", ()):
                    self.floats([element.position, *element.color])
                for curve in getattr(part, "curves", ()):
                    for point in curve.points:
                        self.text(point.handle_type)
                        self.floats(point.location)

    def block(self, data) -> None:
        """Adds a data block, such as a material, light or world, with its nodes."""
        if data is None:
            self.text("none")
            return
        self.text(f"{data.bl_rna.identifier} {data.name}")
        if data.as_pointer() in self._seen:
            return
        self._seen.add(data.as_pointer())
        self.plain(data)
        self.parts(data)
        if isinstance(data, bpy.types.Image):
            self.image(data)
        elif isinstance(data, bpy.types.Volume):
            self.file(data.filepath, data.library)
        elif isinstance(data, bpy.types.NodeTree):
            self.tree(data)

    def tree(self, tree) -> None:
        for node in tree.nodes:
            self.text(f"{node.bl_idname} {node.name}")
            self.plain(node)
            self.parts(node)
            # The outputs of some nodes have a value too, such as those of Value and RGB.
            for socket in (*node.inputs, *node.outputs):
                value = getattr(socket, _INPUT, None)
                self.text(repr(tuple(value)) if hasattr(value, "__len__") and not isinstance(value, str) else repr(getattr(value, "name", value)))
            if getattr(node, "filepath", ""):
                self.file(node.filepath, tree.library)
        for link in tree.links:
            self.text(f"{link.from_node.name}.{link.from_socket.identifier} {link.to_node.name}.{link.to_socket.identifier} {link.is_muted}")

    def collections(self, layer) -> None:
        """Adds how a view layer shows a collection, and the collections in it."""
        self.text(f"{layer.name} {layer.exclude} {layer.holdout} {layer.indirect_only}")
        for child in layer.children:
            self.collections(child)

    def file(self, path: str, library) -> None:
        """Adds the size and time of a file."""
        try:
            known = os.stat(bpy.path.abspath(path, library=library))
            self.text(f"{known.st_size} {known.st_mtime_ns}")
        except (OSError, ValueError):
            self.text("no file")

    def image(self, image) -> None:
        tiles = image.tiles if image.source == "TILED" else ()
        names = [image.filepath.replace("<UDIM>", str(tile.number)).replace("<UVTILE>", _uv_tile(tile.number)) for tile in tiles]
        for name in names or [image.filepath]:
            self.file(name, image.library)
        for packed in image.packed_files:
            self.sha.update(bytes(packed.packed_file.data))

    def object(self, held) -> None:
        """Adds an object that Blender has evaluated: properties, materials, hair and geometry."""
        self.plain(held, _OBJECT)
        if hasattr(held.original, "cycles"):
            self.plain(held.original.cycles)
        for modifier in held.original.modifiers:
            self.plain(modifier, _AT_RENDER)
        linking = getattr(held, "light_linking", None)
        for collection in (getattr(linking, name, None) for name in ("receiver_collection", "blocker_collection")):
            self.text("none" if collection is None else " ".join(each.name for each in collection.all_objects))
        for slot in held.material_slots:
            self.block(slot.material)
        for system in held.particle_systems:
            self.plain(system, _HAIR)
            self.block(system.settings)
            # Hair that was not combed follows from the settings.
            for particle in system.particles if system.is_edited else ():
                self.values(particle.hair_keys, "co_local", 3)
        if held.type in _MESHES:
            self.plain(held.data, _AT_RENDER)
            self.mesh(held)
        elif held.data is not None and held.type != "CAMERA":
            self.block(held.data)
            self.geometry(held.data)
            for layer in getattr(held.data, "layers", ()):
                self.drawing(layer)

    def mesh(self, held) -> None:
        mesh = held.to_mesh()
        if mesh is None:
            return
        try:
            self.values(mesh.loops, "vertex_index", 1, "i4")
            self.values(mesh.polygons, "loop_total", 1, "i4")
            self.values(mesh.polygons, "material_index", 1, "i4")
            # These normals contain smooth and flat shading, sharp edges and custom normals.
            self.values(mesh.corner_normals, "vector", 3)
            self.text(f"{mesh.color_attributes.render_color_index} {[layer.active_render for layer in mesh.uv_layers]}")
            self.geometry(mesh)
        finally:
            held.to_mesh_clear()

    def geometry(self, data) -> None:
        """Adds the materials and attributes of a mesh, of curves, or of points."""
        for material in getattr(data, "materials", ()):
            self.block(material)
        for name in ("curve_offset_data", "curve_offsets"):
            if hasattr(data, name):
                self.values(getattr(data, name), "value", 1, "i4")
        for attribute in getattr(data, "attributes", ()):
            # Names that begin with a dot belong to Blender, such as those of selections.
            if attribute.name.startswith("."):
                continue
            self.text(f"{attribute.name} {attribute.domain} {attribute.data_type} {len(attribute.data)}")
            if len(attribute.data) == 0:
                continue
            known = attribute.data[0].bl_rna.properties
            name = next((name for name in ("value", "vector", "color") if name in known), None)
            if name is None or known[name].type == "STRING":
                for each in attribute.data:
                    self.text(str(getattr(each, name or "", "")))
            else:
                self.values(attribute.data, name, max(known[name].array_length, 1), {"BOOLEAN": "?", "INT": "i4"}.get(known[name].type, "f4"))

    def drawing(self, layer) -> None:
        """Adds a layer of Grease Pencil at the current frame."""
        self.plain(layer)
        self.text(str(layer.hide))
        frame = layer.current_frame() if hasattr(layer, "current_frame") else layer.active_frame
        if frame is None:
            return
        if getattr(frame, "drawing", None) is not None:
            self.geometry(frame.drawing)
        # Blender 4.2 has strokes instead of a drawing.
        for stroke in getattr(frame, "strokes", ()):
            self.plain(stroke)
            for name, count in (("co", 3), ("pressure", 1), ("strength", 1), ("vertex_color", 4)):
                self.values(stroke.points, name, count)

    def values(self, kind, name: str, count: int, number: str = "f4") -> None:
        """Adds a property of all elements of a collection: `count` numbers each."""
        import numpy

        values = numpy.empty(len(kind) * count, dtype=number)
        kind.foreach_get(name, values)
        self.sha.update(values.tobytes())


def _uv_tile(number: int) -> str:
    """Returns the name of tile `number` of a tiled picture in names of files with <UVTILE>."""
    return f"u{(number - 1001) % 10 + 1}_v{(number - 1001) // 10 + 1}"

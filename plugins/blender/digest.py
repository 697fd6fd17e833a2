# SPDX-License-Identifier: GPL-3.0-or-later
"""A digest of all data that a render depends on. Views from an earlier run are still valid if the
digest is the same.

Objects are read after Blender has evaluated modifiers, drivers and animation. Other data enter the
digest with their properties that are booleans, numbers, texts or enums, except those in `_SKIP`.
Pictures also enter it with the size and time of their files.
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
    # Settings that every render sets.
    "filepath", "resolution_x", "resolution_y", "resolution_percentage", "pixel_aspect_x", "pixel_aspect_y", "use_border", "use_multiview",
    "use_sequencer", "use_stamp", "use_overwrite", "use_placeholder", "use_file_extension", "display_mode", "use_lock_interface", "threads", "threads_mode",
    "preview_samples", "use_preview_denoising", "frame_path", "is_movie_format", "file_extension",
}  # fmt: skip
_MESHES = {"MESH", "CURVE", "SURFACE", "FONT", "META"}
#: The property of a node's input socket that contains its value.
_INPUT = "default_value"


def digest(scene) -> str:
    """Returns the digest of a scene at its current frame."""
    hasher = _Hasher()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    shapes: set[str] = set()
    for instance in depsgraph.object_instances:
        held = instance.object
        if held.original.name.startswith("Lumistack view"):
            continue
        hasher.text(held.name)
        hasher.floats(value for row in instance.matrix_world for value in row)
        hasher.text(str(held.original.hide_render))
        if held.name in shapes:
            continue
        shapes.add(held.name)
        hasher.plain(held, {"matrix_world", "visible_camera", "is_shadow_catcher", "is_holdout", "pass_index", "color"})
        for slot in held.material_slots:
            hasher.block(slot.material)
        if held.type in _MESHES:
            hasher.mesh(held)
        elif held.data is not None and held.type != "CAMERA":
            hasher.block(held.data)
    hasher.block(scene.world)
    for settings in (scene.render, getattr(scene, "cycles", None), getattr(scene, "eevee", None), scene.view_settings):
        if settings is not None:
            hasher.plain(settings)
    hasher.text(bpy.app.version_string)
    return hasher.sha.hexdigest()


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
        if isinstance(data, bpy.types.Image):
            self.image(data)
        tree = data if isinstance(data, bpy.types.NodeTree) else getattr(data, "node_tree", None)
        if tree is not None:
            self.tree(tree)

    def tree(self, tree) -> None:
        for node in tree.nodes:
            self.text(f"{node.bl_idname} {node.name}")
            self.plain(node)
            for socket in node.inputs:
                value = getattr(socket, _INPUT, None)
                self.text(repr(tuple(value)) if hasattr(value, "__len__") and not isinstance(value, str) else repr(getattr(value, "name", value)))
            for prop in node.bl_rna.properties:
                if prop.type == "POINTER" and prop.identifier not in _SKIP:
                    held = getattr(node, prop.identifier, None)
                    if isinstance(held, (bpy.types.Image, bpy.types.NodeTree)):
                        self.block(held)
                    elif isinstance(held, bpy.types.ColorRamp):
                        for element in held.elements:
                            self.floats([element.position, *element.color])
        for link in tree.links:
            self.text(f"{link.from_node.name}.{link.from_socket.identifier} {link.to_node.name}.{link.to_socket.identifier}")

    def image(self, image) -> None:
        path = bpy.path.abspath(image.filepath, library=image.library)
        try:
            known = os.stat(path)
            self.text(f"{known.st_size} {known.st_mtime_ns}")
        except (OSError, ValueError):
            self.text("no file")
        if image.packed_file:
            self.sha.update(bytes(image.packed_file.data))

    def mesh(self, held) -> None:
        import numpy

        mesh = held.to_mesh()
        if mesh is None:
            return
        try:
            for kind, name, count, number in (
                (mesh.vertices, "co", 3, numpy.float32),
                (mesh.loops, "vertex_index", 1, numpy.int32),
                (mesh.polygons, "loop_total", 1, numpy.int32),
                (mesh.polygons, "material_index", 1, numpy.int32),
            ):
                values = numpy.empty(len(kind) * count, dtype=number)
                kind.foreach_get(name, values)
                self.sha.update(values.tobytes())
            for layer in mesh.uv_layers:
                values = numpy.empty(len(mesh.loops) * 2, dtype=numpy.float32)
                layer.uv.foreach_get("vector", values)
                self.sha.update(values.tobytes())
        finally:
            held.to_mesh_clear()

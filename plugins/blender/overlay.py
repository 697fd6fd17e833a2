# SPDX-License-Identifier: GPL-3.0-or-later
"""Drawings in the 3D view: the window with its depth of field and viewing zone, and the simulated
view on the window. An arrow moves the window along its normal. A frame moves and scales the window
in its plane.
"""

from __future__ import annotations

import time

import bpy
from lumistack.blender import cameras, depth, outline

from . import jobs

#: Colours of the drawings, linear RGBA.
WINDOW, DEPTH, CONE = (1.0, 0.75, 0.1, 1.0), (0.2, 0.75, 1.0, 0.7), (0.6, 1.0, 0.4, 0.5)
WIDTH_PX = 1.5
#: Seconds without motion after which an arrow or frame is regarded as released.
REST_S = 0.4

_handle = None
_moved_at = 0.0
_pictures: dict[str, object] = {}
_textures: dict[str, object] = {}
_outlines: dict[str, tuple[object, object]] = {}
#: The reason why a scene has no window, for each scene's name.
missing: dict[str, str] = {}


def forget() -> None:
    """Forgets all computed windows, so that they are computed again."""
    _outlines.clear()


def is_drawn(scene) -> bool:
    """Returns true if the user has used the extension in this scene."""
    return scene is not None and hasattr(scene, "lumistack") and scene.lumistack.is_used


def set_picture(scene_name: str, picture) -> None:
    """Sets the simulated view [row, column, rgb] that is drawn on the window."""
    _pictures[scene_name] = picture
    _textures.pop(scene_name, None)


def lines_of(scene) -> list[tuple[tuple[float, ...], list[tuple[float, float, float]]]]:
    """Returns the lines to draw, as pairs of a colour and the ends of lines in scene coordinates.
    The list is empty if the scene has no window."""
    settings = scene.lumistack
    placed = placement(scene)
    if placed is None:
        return []
    display, window = placed
    fov = display.to_dict()["field"]["fov_deg"]
    sharp = depth.in_scene(display.depth_of_field_mm(), settings.depth_scale, display.distance_mm)
    kinds = [
        (settings.show_window, WINDOW, outline.frame(window.size_mm)),
        (settings.show_depth, DEPTH, outline.depth_box(window.size_mm, sharp, display.distance_mm)),
        (settings.show_cone, CONE, outline.cone(window.size_mm, fov)),
    ]
    return [(colour, [window.point(end) for line in lines for end in line]) for is_shown, colour, lines in kinds if is_shown and lines]


def placement(scene) -> tuple[object, cameras.Window] | None:
    """Returns display and window of a scene; None without a window. They are computed again after
    the camera or a setting has changed."""
    kept = _outlines.get(scene.name)
    if scene.name in jobs.busy:
        return kept and kept[1]
    key = _key(scene)
    if kept is not None and kept[0] == key:
        return kept[1]
    try:
        display = jobs.display_of(scene.lumistack)
        found = (display, jobs.window_of(scene, display))
    except jobs.JobError as error:
        found = None
        missing[scene.name] = str(error)
    _outlines[scene.name] = (key, found)
    return found


def _key(scene) -> object:
    """Returns a key that changes when the window may change: the camera's data and the frame
    number. Changes of settings call `forget` instead."""
    camera = key_of_camera(scene)
    return camera and (camera, scene.frame_current)


def key_of_camera(scene) -> object:
    """Returns a key of the camera's data on which the window depends; None without a camera."""
    camera = scene.camera
    if camera is None or camera.type != "CAMERA":
        return None
    dof = camera.data.dof
    focus = dof.focus_object and dof.focus_object.matrix_world.copy()
    frame = tuple(corner.copy().freeze() for corner in camera.data.view_frame(scene=scene))
    return (camera.matrix_world.copy(), camera.data.type, frame, dof.use_dof, dof.focus_distance, focus)


def _draw() -> None:
    import gpu
    from gpu_extras.batch import batch_for_shader

    scene = bpy.context.scene
    view = bpy.context.space_data
    if not is_drawn(scene) or not view.overlay.show_overlays:
        return
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("LESS_EQUAL")
    try:
        _draw_picture(scene, gpu, batch_for_shader)
        shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
        shader.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
        shader.uniform_float("lineWidth", WIDTH_PX)
        for colour, ends in lines_of(scene):
            shader.uniform_float("color", colour)
            batch_for_shader(shader, "LINES", {"pos": ends}).draw(shader)
    finally:
        gpu.state.depth_test_set("NONE")
        gpu.state.blend_set("NONE")


def _draw_picture(scene, gpu, batch_for_shader) -> None:
    picture = _pictures.get(scene.name)
    placed = placement(scene)
    if picture is None or placed is None or not scene.lumistack.show_picture:
        return
    _, window = placed
    texture = _textures.get(scene.name)
    if texture is None:
        import numpy

        rows, columns, _ = picture.shape
        values = numpy.ones((rows, columns, 4), numpy.float32)
        # Keep linear values: Blender encodes the drawing for the screen.
        values[..., :3] = numpy.clip(picture[::-1], 0.0, 1.0)
        texture = gpu.types.GPUTexture((columns, rows), format="RGBA16F", data=gpu.types.Buffer("FLOAT", values.size, values.ravel()))
        _textures[scene.name] = texture
    corners = [window.point(line[0]) for line in outline.frame(window.size_mm)]
    shader = gpu.shader.from_builtin("IMAGE")
    shader.uniform_sampler("image", texture)
    places = {"pos": corners, "texCoord": [(0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0)]}
    batch_for_shader(shader, "TRI_FAN", places).draw(shader)


def _moved() -> None:
    """Called when the user drags the arrow or the frame. Blender adds no undo step for a drag, so a
    timer adds one when the drag has ended."""
    global _moved_at
    _moved_at = time.monotonic()
    if not bpy.app.timers.is_registered(_push_undo):
        bpy.app.timers.register(_push_undo, first_interval=REST_S)


def _push_undo() -> float | None:
    if time.monotonic() - _moved_at < REST_S:
        return REST_S
    windows = bpy.context.window_manager.windows
    if len(windows):
        with bpy.context.temp_override(window=windows[0]):
            bpy.ops.ed.undo_push(message="Move Display Window")
    return None


class LUMISTACK_GGT_window(bpy.types.GizmoGroup):
    bl_label = "Lumistack window"
    bl_space_type = "VIEW_3D"
    bl_region_type = "WINDOW"
    bl_options = {"3D", "PERSISTENT", "SHOW_MODAL_ALL"}

    @classmethod
    def poll(cls, context):
        scene = context.scene
        return is_drawn(scene) and scene.lumistack.show_window and placement(scene) is not None

    def setup(self, context):
        arrow = self.gizmos.new("GIZMO_GT_arrow_3d")
        arrow.draw_style = "NORMAL"
        arrow.color, arrow.alpha = WINDOW[:3], 0.8
        arrow.color_highlight, arrow.alpha_highlight = (1.0, 1.0, 1.0), 1.0
        cage = self.gizmos.new("GIZMO_GT_cage_2d")
        # The window keeps the display's proportions, so only uniform scaling changes it.
        cage.transform = {"TRANSLATE", "SCALE", "SCALE_UNIFORM"}
        cage.color, cage.alpha = WINDOW[:3], 0.3
        cage.color_highlight, cage.alpha_highlight = (1.0, 1.0, 1.0), 1.0
        self._arrow, self._cage = arrow, cage
        # `target_set_handler` calls `_get_cage` at once, which reads `_width`. Without a placement,
        # `refresh` does not set `_width`.
        self._width = 1.0
        self.refresh(context)
        arrow.target_set_handler("offset", get=self._get, set=self._set)
        cage.target_set_handler("matrix", get=self._get_cage, set=self._set_cage)

    def _get(self):
        scene = bpy.context.scene
        placed = placement(scene)
        return 0.0 if placed is None else -scene.lumistack.moved_back_mm * placed[1].scale

    def _set(self, offset):
        scene = bpy.context.scene
        placed = placement(scene)
        if placed is not None:
            scene.lumistack.moved_back_mm = outline.turned(-offset / placed[1].scale, 0.0, -1e5, 1e5)
            _moved()

    def _get_cage(self):
        settings = bpy.context.scene.lumistack
        return outline.cage(settings.window_size, settings.window_shift, self._width)

    def _set_cage(self, matrix):
        settings = bpy.context.scene.lumistack
        settings.window_size, settings.window_shift = outline.of_cage(matrix, self._width)
        _moved()

    def refresh(self, context):
        placed = placement(context.scene)
        if placed is not None:
            settings = context.scene.lumistack
            self._arrow.matrix_basis = arrow_matrix(placed[1], settings.moved_back_mm)
            self._cage.matrix_basis, self._cage.dimensions, self._width = cage_of(*placed, settings)

    def draw_prepare(self, context):
        self.refresh(context)


def arrow_matrix(window: cameras.Window, moved_back_mm: float):
    """Returns the matrix of the arrow. The arrow's origin is the centre of the window before the
    window was moved along its normal."""
    return _matrix(window, window.point((0.0, 0.0, moved_back_mm)))


def cage_of(display, window: cameras.Window, settings):
    """Returns three values of the frame that moves and scales the window.

    The first is the matrix of the frame at rest; its centre is the middle of the camera's picture in
    the window's plane. The second is the size of the window at `window_size` 1. The third is the
    width that is the unit of `window_shift`. Lengths are in scene units.
    """
    grown = 1.0 if display.distance_mm is None else (display.distance_mm + settings.moved_back_mm) / display.distance_mm
    width, height = (window.scale * part / settings.window_size for part in window.size_mm)
    unit = width / grown
    across, upwards = (part * unit / window.scale for part in settings.window_shift)
    return _matrix(window, window.point((-across, -upwards, 0.0))), (width, height), unit


def _matrix(window: cameras.Window, origin):
    """Returns a matrix with the axes of a window and the given origin."""
    from mathutils import Matrix

    return Matrix([[window.right[row], window.up[row], window.back[row], origin[row]] for row in range(3)] + [[0.0, 0.0, 0.0, 1.0]])


def register() -> None:
    global _handle
    bpy.utils.register_class(LUMISTACK_GGT_window)
    if not bpy.app.background:
        _handle = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")


def unregister() -> None:
    global _handle
    if _handle is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_handle, "WINDOW")
        _handle = None
    if bpy.app.timers.is_registered(_push_undo):
        bpy.app.timers.unregister(_push_undo)
    bpy.utils.unregister_class(LUMISTACK_GGT_window)
    for kept in (_pictures, _textures, _outlines, missing):
        kept.clear()

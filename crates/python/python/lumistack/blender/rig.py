"""Renders views with Blender's engines. This module sets a camera for each view, and render
settings that make the views comparable. Afterwards it restores the scene's settings."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from .cameras import SENSOR_MM, ViewCamera, Window, window_distance, window_of_camera

#: Name of the objects that this module adds to a scene for a render.
TEMPORARY = "Lumistack view"


#: Longest time of the test that draws a picture of 4 × 4 pixels, seconds.
LONGEST_S = 120.0


class NoWindow(ValueError):
    """The scene defines no window; the message names the missing part."""


class NoOpenGL(RuntimeError):
    """The engine draws with OpenGL, which is not available."""


#: Program of the child process: it draws a picture of 4 × 4 pixels with OpenGL.
_DRAW = """
import bpy, os
render = bpy.context.scene.render
render.engine = "BLENDER_WORKBENCH"
render.resolution_x = render.resolution_y = 4
bpy.ops.render.render()
os.write(1, b"LUMISTACK DREW")
os._exit(0)
"""
_can_draw: list[bool] = []


def check_engine(bpy: Any, scene: Any) -> None:
    """Tests OpenGL in a child process, since without a window Blender crashes if there is no OpenGL.
    Raises `NoOpenGL`."""
    engine = scene.render.engine
    if not bpy.app.background or not engine.startswith(("BLENDER_EEVEE", "BLENDER_WORKBENCH")):
        return
    if not _can_draw:
        program = bpy.app.binary_path
        words = [program, "-b", "--factory-startup", "--python-expr", _DRAW] if program else [sys.executable, "-c", _DRAW]
        try:
            quiet = subprocess.DEVNULL
            drew = b"LUMISTACK DREW" in subprocess.run(words, stdin=quiet, stdout=subprocess.PIPE, stderr=quiet, timeout=LONGEST_S).stdout
        except subprocess.TimeoutExpired:
            # The child drew until the time was over, so OpenGL works, but slowly.
            drew = True
        _can_draw.append(drew)
    if not _can_draw[0]:
        name = "Workbench" if "WORKBENCH" in engine else "EEVEE"
        raise NoOpenGL(f"{name} needs OpenGL, which Blender does not find here without a window; use Cycles, or start Blender with a screen (for example by `xvfb-run`)")


class Rig:
    """A temporary camera that accepts any matrix, and render settings for linear OpenEXR pictures at
    the display's resolution. Usage: `with Rig(...) as rig: rig.aim(...)`."""

    def __init__(self, bpy: Any, scene: Any, resolution: Sequence[int]) -> None:
        self._bpy, self._scene, self._resolution = bpy, scene, resolution
        self._old: list[tuple[Any, str, Any]] = []
        self._camera: Any = None
        self._holder: Any = None

    def __enter__(self) -> Rig:
        try:
            self._add()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _add(self) -> None:
        bpy, scene = self._bpy, self._scene
        data = bpy.data.cameras.new(TEMPORARY)
        self._camera = bpy.data.objects.new(TEMPORARY, data)
        # `matrix_parent_inverse`, which may be a shear, has an effect only if there is a parent.
        self._holder = bpy.data.objects.new(TEMPORARY, None)
        for held in (self._holder, self._camera):
            scene.collection.objects.link(held)
            # Hide both objects in the 3D view.
            held.hide_viewport = True
        self._camera.parent = self._holder
        data.sensor_fit, data.sensor_width = "HORIZONTAL", SENSOR_MM
        data.dof.use_dof = False
        render = scene.render
        self._set(scene, "camera", self._camera)
        self._set(render, "resolution_x", int(self._resolution[0]))
        self._set(render, "resolution_y", int(self._resolution[1]))
        self._set(render, "resolution_percentage", 100)
        self._set(render, "pixel_aspect_x", 1.0)
        self._set(render, "pixel_aspect_y", 1.0)
        for name in ("use_border", "use_multiview", "use_sequencer", "use_stamp", "use_overwrite", "use_placeholder"):
            self._set(render, name, name == "use_overwrite")
        self._set(render, "use_file_extension", False)
        self._set(render, "filepath", render.filepath)
        image = render.image_settings
        if hasattr(image, "media_type"):
            self._set(image, "media_type", "IMAGE")
        for name, value in (("file_format", "OPEN_EXR"), ("color_mode", "RGBA"), ("color_depth", "32"), ("exr_codec", "ZIP")):
            self._set(image, name, value)

    def _set(self, held: Any, name: str, value: Any) -> None:
        self._old.append((held, name, getattr(held, name)))
        setattr(held, name, value)

    def set(self, held: Any, name: str, value: Any) -> None:
        """Changes a setting; `close` restores its value."""
        if hasattr(held, name):
            self._set(held, name, value)

    def aim(self, camera: ViewCamera, path: str | Path) -> None:
        """Sets the camera to a view and the output to a file."""
        data, held = self._camera.data, self._camera
        # Blender reads a flat list column by column, and a `Matrix` row by row.
        held.matrix_parent_inverse = type(held.matrix_world)([list(row) for row in camera.matrix])
        if camera.ortho_scale is not None:
            data.type, data.ortho_scale = "ORTHO", camera.ortho_scale
        else:
            data.type, data.lens = "PERSP", camera.lens_mm
        data.shift_x, data.shift_y = camera.shift
        data.clip_start, data.clip_end = camera.clip_start, camera.clip_end
        self._scene.render.filepath = str(path)

    def close(self) -> None:
        """Restores all settings and removes the camera; a second call has no effect."""
        while self._old:
            held, name, value = self._old.pop()
            try:
                setattr(held, name, value)
            except (AttributeError, ReferenceError, TypeError):
                # The scene was deleted during the render, so its settings need not be restored.
                pass
        for held in (self._camera, self._holder):
            if held is None:
                continue
            try:
                data = held.data
                self._bpy.data.objects.remove(held, do_unlink=True)
                if data is not None:
                    self._bpy.data.cameras.remove(data)
            except ReferenceError:
                pass
        self._camera = self._holder = None


def remove_leftovers(bpy: Any) -> None:
    """Removes objects that an interrupted render left in a saved file."""
    for held in [held for held in bpy.data.objects if held.name.startswith(TEMPORARY)]:
        bpy.data.objects.remove(held, do_unlink=True)
    for data in [data for data in bpy.data.cameras if data.name.startswith(TEMPORARY) and not data.users]:
        bpy.data.cameras.remove(data)


def render_views(
    bpy: Any,
    scene: Any,
    resolution: Sequence[int],
    todo: Iterable[tuple[ViewCamera, Path, Callable[[], object]]],
    prepare: Callable[[Rig], None] = lambda _: None,
) -> None:
    """Renders views one after another, on the thread of Blender's Python. Calls the function
    `finished` of a view when the view's file is complete. Returns after the last view."""
    with Rig(bpy, scene, resolution) as rig:
        prepare(rig)
        for camera, path, finished in todo:
            rig.aim(camera, path)
            bpy.ops.render.render(write_still=True, scene=scene.name)
            finished()


def focus_of(bpy: Any, camera: Any) -> float | None:
    """Returns the distance of a camera's plane of focus, scene units; None without focus."""
    dof = camera.data.dof
    held = dof.focus_object
    if held is not None:
        depsgraph = bpy.context.evaluated_depsgraph_get()
        matrix = camera.evaluated_get(depsgraph).matrix_world.normalized()
        target = held.evaluated_get(depsgraph).matrix_world
        bone = getattr(dof, "focus_subtarget", "")
        if bone and held.type == "ARMATURE" and bone in held.pose.bones:
            target = target @ held.pose.bones[bone].matrix
        return abs(float((target.translation - matrix.translation).dot(matrix.col[2].xyz)))
    return float(dof.focus_distance) if dof.use_dof else None


def window_of(bpy: Any, scene: Any, size_mm: tuple[float, float], distance: float | None = None, camera: Any = None) -> Window:
    """Returns the window in front of the scene's camera. The window is at the given distance, or
    else at the camera's plane of focus, or else at the distance that `middle_of_view` returns."""
    camera = camera or scene.camera
    if camera is None:
        raise NoWindow("the scene has no camera: add one (Add > Camera, then View > Cameras > Set Active Object as Camera)")
    if camera.type != "CAMERA":
        raise NoWindow(f"{camera.name}: expected a camera, found an object of type {camera.type.lower()}")
    if camera.data.type not in ("PERSP", "ORTHO"):
        raise NoWindow(f"{camera.name}: expected a perspective or an orthographic camera, found {camera.data.type.lower()}")
    depsgraph = bpy.context.evaluated_depsgraph_get()
    matrix = [list(row) for row in camera.evaluated_get(depsgraph).matrix_world]
    frame = [tuple(corner) for corner in camera.data.view_frame(scene=scene)]
    focus = distance or focus_of(bpy, camera) or middle_of_view(bpy, scene, camera)
    if focus is None and not has_content(bpy):
        raise NoWindow("the scene has no visible objects: add an object, or switch one on for renders")
    if focus is None:
        raise NoWindow(f"{camera.name}: the camera sees no object from whose distance the window's distance follows; aim the camera at an object, or set the camera's focus distance")
    return window_of_camera(matrix, frame, camera.data.type == "ORTHO", focus, size_mm)


def middle_of_view(bpy: Any, scene: Any, camera: Any, columns: int = 15, rows: int = 11) -> float | None:
    """Returns the distance of the window for a camera without focus, scene units. None if no content
    is visible."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    matrix = camera.evaluated_get(depsgraph).matrix_world.normalized()
    frame = [corner.copy() for corner in camera.data.view_frame(scene=scene)]
    xs, ys = [corner.x for corner in frame], [corner.y for corner in frame]
    orthographic = camera.data.type == "ORTHO"
    depths = []
    for row in range(rows):
        for column in range(columns):
            place = frame[0].copy()
            place.x = min(xs) + (max(xs) - min(xs)) * (column + 0.5) / columns
            place.y = min(ys) + (max(ys) - min(ys)) * (row + 0.5) / rows
            origin, direction = matrix.translation, matrix.to_3x3() @ place
            if orthographic:
                place.z = 0.0
                origin, direction = matrix @ place, -matrix.col[2].xyz
            hit, point, *_ = scene.ray_cast(depsgraph, origin, direction.normalized())
            if hit:
                depths.append(float(-(matrix.inverted() @ point).z))
    return window_distance(depths)


def depths_through(bpy: Any, scene: Any, window: Window, distance_mm: float | None, columns: int = 40, rows: int = 25) -> list[float]:
    """Returns depths of the content that the middle view shows in the window, millimetres."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    vector = type(scene.cursor.location)
    nearest = depth_range(bpy, scene, window)[1]
    stand = (max(nearest, 0.0) + window.size_mm[0]) if distance_mm is None else distance_mm
    depths = []
    for row in range(rows):
        for column in range(columns):
            x = window.size_mm[0] * ((column + 0.5) / columns - 0.5)
            y = window.size_mm[1] * (0.5 - (row + 0.5) / rows)
            origin = vector(window.point((x, y, stand) if distance_mm is None else (0.0, 0.0, stand)))
            direction = vector(window.point((x, y, 0.0))) - origin
            hit, point, *_ = scene.ray_cast(depsgraph, origin, direction.normalized())
            if hit:
                depths.append(window.place_mm(point)[2])
    return depths


def has_content(bpy: Any) -> bool:
    """Returns true if a render shows any object."""
    return next(_contents(bpy), None) is not None


def _contents(bpy: Any) -> Iterator[Any]:
    """Returns the instances of objects that a render shows."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for instance in depsgraph.object_instances:
        held = instance.object
        if held.type not in ("CAMERA", "LIGHT", "EMPTY", "ARMATURE", "SPEAKER", "LIGHT_PROBE", "LATTICE") and not held.original.hide_render:
            yield instance


def depth_range(bpy: Any, scene: Any, window: Window) -> tuple[float, float]:
    """Returns the farthest and nearest depth of all content that a render shows, millimetres along the
    window's normal. The window's own depth, 0, is included."""
    depths = [0.0]
    for instance in _contents(bpy):
        matrix = instance.matrix_world
        for corner in instance.object.bound_box:
            place = tuple(sum(matrix[row][axis] * corner[axis] for axis in range(3)) + matrix[row][3] for row in range(3))
            depth = window.place_mm(place)[2]
            if math.isfinite(depth):
                depths.append(depth)
    return min(depths), max(depths)

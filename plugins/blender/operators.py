# SPDX-License-Identifier: GPL-3.0-or-later
"""The operators that the buttons run."""

from __future__ import annotations

import functools
import math
import os
import subprocess
import sys
from pathlib import Path

import bpy
import lumistack
from lumistack.blender import outline

from . import cost, jobs, overlay, pictures, settings as settings_of

#: Interval between two checks of running work, seconds.
TICK = 0.1
#: Least width of a new window for the simulated view, pixels.
WINDOW_PX = 720
_previews: list[subprocess.Popen] = []


class _Steps(bpy.types.Operator):
    """Does the steps of a job from a timer; without a window, all steps in one call."""

    bl_options = {"REGISTER"}
    factorizes = True
    is_probe = False

    @classmethod
    def poll(cls, context):
        return context.scene is not None

    def execute(self, context):
        job = jobs.Job(context.scene, factorize=self.factorizes, probe=self.is_probe)
        try:
            jobs.run_now(job)
        except Exception as error:  # every error is reported to the user
            self.report({"ERROR"}, jobs.text_of(error))
            return {"CANCELLED"}
        return self._end(context, job)

    def invoke(self, context, _event):
        self._job = jobs.Job(context.scene, factorize=self.factorizes, probe=self.is_probe)
        self._walk = self._job.steps()
        self._step = None
        self._state = "next"
        bpy.app.handlers.render_complete.append(self._complete)
        bpy.app.handlers.render_cancel.append(self._cancelled)
        self._timer = context.window_manager.event_timer_add(TICK, window=context.window)
        context.window_manager.progress_begin(0.0, 1.0)
        context.window_manager.modal_handler_add(self)
        # Do not open a window for every render: it would cover the panel.
        self._display_type = context.preferences.view.render_display_type
        context.preferences.view.render_display_type = "NONE"
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type == "ESC" and event.value == "PRESS":
            return self._stop(context, "Stopped; finished views and patterns are kept")
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        try:
            return self._go_on(context)
        except Exception as error:  # the timer must be removed after any error
            self._close(context)
            self.report({"ERROR"}, jobs.text_of(error))
            return {"CANCELLED"}

    def _go_on(self, context):
        step = self._step
        if self._state == "rendering":
            return {"PASS_THROUGH"}
        if self._state == "cancelled":
            return self._stop(context, "Stopped; finished views and patterns are kept")
        if bpy.app.is_job_running("RENDER"):
            # Blender has not yet finished its render job for the previous view.
            return {"PASS_THROUGH"}
        if self._state == "rendered":
            step.finished()
            self._state = "next"
        if isinstance(step, jobs.Wait) and not step.work.is_done():
            stage, share = step.work.progress
            self._show_progress(context, f"{step.title} {stage}", step.share + step.part * share)
            return {"PASS_THROUGH"}
        try:
            self._step = step = next(self._walk)
        except StopIteration:
            self._close(context)
            return self._end(context, self._job)
        self._show_progress(context, step.title, step.share)
        if isinstance(step, jobs.Wait):
            jobs.track(step.work)
        elif isinstance(step, jobs.Render):
            step.aim()
            self._state = "rendering"
            if "CANCELLED" in bpy.ops.render.render("INVOKE_DEFAULT", write_still=True, scene=step.scene.name):
                raise jobs.JobError("Blender does not start to render: another render is running, or the scene has no camera")
        return {"PASS_THROUGH"}

    def _complete(self, *_):
        if self._state == "rendering":
            self._state = "rendered"

    def _cancelled(self, *_):
        if self._state == "rendering":
            self._state = "cancelled"

    def _show_progress(self, context, title, share):
        context.window_manager.progress_update(share)
        if context.workspace:
            context.workspace.status_text_set(f"Lumistack: {title} ({100 * share:.0f} %). Esc stops")

    def _stop(self, context, message):
        if isinstance(self._step, jobs.Wait):
            self._step.work.stop()
        self._close(context)
        self.report({"WARNING"}, message)
        return {"CANCELLED"}

    def _close(self, context):
        self._walk.close()
        context.preferences.view.render_display_type = self._display_type
        for handlers, handler in ((bpy.app.handlers.render_complete, self._complete), (bpy.app.handlers.render_cancel, self._cancelled)):
            if handler in handlers:
                handlers.remove(handler)
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        if context.workspace:
            context.workspace.status_text_set(None)

    def _end(self, context, job):
        # Blender shows the last report, so the result comes last. The panel keeps the warnings.
        jobs.warned[context.scene.name] = list(job.warnings)
        for warning in job.warnings:
            self.report({"WARNING"}, warning)
        self._show(context)
        for line in job.said:
            self.report({"INFO"}, line)
        return {"FINISHED"}

    def _show(self, context):
        pass


class LUMISTACK_OT_make(_Steps):
    """Render the views, compute the layers' patterns, and show the simulated display. The lines below state the number of renders"""

    bl_idname = "lumistack.make"
    bl_label = "Make Tensor Display"

    def _show(self, context):
        # The view from straight ahead is usually one of the solver's views, so its picture is
        # better than pictures from other directions. Show a direction between the views instead.
        held = jobs.shown[context.scene.name]
        show_view(context.scene, held.beside)
        if any(held.beside):
            self.report({"INFO"}, f"The picture shows the display {direction(held.beside)}, between the views. Look Around shows other directions")
        if not bpy.app.background:
            show_editor(context)


class LUMISTACK_OT_render_views(_Steps):
    """Render the display's views as a light field; finished views that are still valid are kept"""

    bl_idname = "lumistack.render_views"
    bl_label = "Render Views"
    factorizes = False


class LUMISTACK_OT_estimate(_Steps):
    """Render two views, or with Lumistack's path tracer small views, and estimate the time of Make Tensor Display"""

    bl_idname = "lumistack.estimate"
    bl_label = "Estimate Time"
    factorizes = False
    is_probe = True


def direction(slope) -> str:
    """Returns a text about a direction."""
    angles = [(math.degrees(math.atan(abs(part))), part) for part in slope]
    words = [f"{angle:.1f}° {positive if part > 0.0 else negative}" for (angle, part), positive, negative in zip(angles, ("from the right", "from above"), ("from the left", "from below")) if angle >= 0.05]
    return " and ".join(words) or "from straight ahead"


def show_view(scene, slope) -> None:
    """Simulates the display of a scene as seen from a slope, and shows the view in the image editor
    and in the 3D view."""
    held = jobs.shown.get(scene.name)
    if held is not None:
        picture = lumistack.simulate(held.stack, slope=slope)
        pictures.show(picture)
        overlay.set_picture(scene.name, picture)


def show_editor(context) -> None:
    """Shows the simulated view in an open image editor, or in a new window, as Blender does for a
    render."""
    image = bpy.data.images.get(pictures.SHOWN)
    if image is None:
        return
    areas = _areas(context, "IMAGE_EDITOR")
    if not areas:
        _open_editor(context, image.size)
        areas = _areas(context, "IMAGE_EDITOR")
    if areas:
        areas[0].spaces.active.image = image


def _areas(context, kind: str) -> list:
    return [area for window in context.window_manager.windows for area in window.screen.areas if area.type == kind]


def _open_editor(context, size) -> None:
    """Opens a window of the picture's size, enlarged to at least `WINDOW_PX` pixels of width."""
    render, view = context.scene.render, context.preferences.view
    larger = max(WINDOW_PX / size[0], 1.0)
    changes = [(render, "resolution_x", round(larger * size[0])), (render, "resolution_y", round(larger * size[1])), (render, "resolution_percentage", 100)]
    changes.append((view, "render_display_type", "WINDOW"))
    old = [(held, name, getattr(held, name)) for held, name, _ in changes]
    try:
        for held, name, value in changes:
            setattr(held, name, value)
        bpy.ops.render.view_show("INVOKE_DEFAULT")
    finally:
        for held, name, value in old:
            setattr(held, name, value)
    # The size of the new window is known only after Blender has drawn it, so fit the picture later.
    for delay_s in (0.2, 1.0):
        bpy.app.timers.register(functools.partial(_fit_editor), first_interval=delay_s)


def _fit_editor() -> None:
    """Enlarges the picture in the image editor to the size of its window."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "IMAGE_EDITOR" and area.spaces.active.image == bpy.data.images.get(pictures.SHOWN):
                region = next(region for region in area.regions if region.type == "WINDOW")
                with bpy.context.temp_override(window=window, area=area, region=region):
                    bpy.ops.image.view_all(fit_view=True)


class LUMISTACK_OT_look(bpy.types.Operator):
    """Look around by moving the mouse: left and right, up and down. Esc or the right button ends it"""

    bl_idname = "lumistack.look"
    bl_label = "Look Around"

    @classmethod
    def poll(cls, context):
        return context.scene is not None and context.scene.name in jobs.shown

    def execute(self, context):
        show_view(context.scene, (0.0, 0.0))
        return {"FINISHED"}

    def invoke(self, context, event):
        self._fov = jobs.shown[context.scene.name].stack.display.to_dict()["field"]["fov_deg"]
        show_view(context.scene, (0.0, 0.0))
        # An operator receives mouse events only from its own window.
        kinds = {area.type for area in context.window.screen.areas}
        if "IMAGE_EDITOR" not in kinds and not ("VIEW_3D" in kinds and context.scene.lumistack.show_picture):
            show_editor(context)
        context.window_manager.modal_handler_add(self)
        if context.workspace:
            context.workspace.status_text_set("Lumistack: move the mouse to look around. Esc ends looking around")
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type in ("ESC", "RIGHTMOUSE") or context.scene.name not in jobs.shown:
            if context.workspace:
                context.workspace.status_text_set(None)
            held = jobs.shown.get(context.scene.name)
            show_view(context.scene, held.beside if held else (0.0, 0.0))
            return {"FINISHED"}
        if event.type == "MOUSEMOVE":
            window = context.window
            show_view(context.scene, outline.slope_of_mouse((event.mouse_x, event.mouse_y), (window.width, window.height), self._fov))
            for area in _areas(context, "IMAGE_EDITOR") + _areas(context, "VIEW_3D"):
                area.tag_redraw()
        return {"PASS_THROUGH"}


class LUMISTACK_OT_fit_depth(bpy.types.Operator):
    """Fit the scene to the depths that the display shows sharply: move the window along its normal, and scale depth if that is not enough"""

    bl_idname = "lumistack.fit_depth"
    bl_label = "Fit Depth"
    bl_options = {"REGISTER", "UNDO"}

    compress: bpy.props.BoolProperty(name="Scale depth", description="Also flatten the scene if the scene does not fit after the window has moved", default=True)

    def execute(self, context):
        try:
            self.report({"INFO"}, jobs.fit_depth(context.scene, self.compress))
        except jobs.JobError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class LUMISTACK_OT_check_depth(bpy.types.Operator):
    """Report how much of the scene lies in front of or behind the depths that the display shows sharply"""

    bl_idname = "lumistack.check_depth"
    bl_label = "Check Depth"

    def execute(self, context):
        try:
            settings_of.use(context.scene)
            display = jobs.display_of(context.scene.lumistack)
            sentence = jobs.depth_sentence(context.scene, display, jobs.window_of(context.scene, display))
        except jobs.JobError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"WARNING"} if sentence else {"INFO"}, sentence or "The scene fits the display's depth of field")
        return {"FINISHED"}


class LUMISTACK_OT_preview(bpy.types.Operator):
    """Open the finished display in the browser"""

    bl_idname = "lumistack.preview"
    bl_label = "Open in Browser"

    def execute(self, context):
        folder = finished_folder(context.scene)
        if folder is None:
            self.report({"ERROR"}, f"{jobs.output_folder(context.scene)}: expected patterns, found none; make the tensor display first")
            return {"CANCELLED"}
        end_previews()
        _previews.append(subprocess.Popen(preview_command(folder), env=preview_environment(), stdin=subprocess.DEVNULL))
        return {"FINISHED"}


def finished_folder(scene) -> Path | None:
    """Returns the finished run folder of the scene or of its first time step; else None."""
    folder = jobs.output_folder(scene)
    return next((each for each in (folder, folder / "t0001") if (each / "layers" / "stack.json").is_file()), None)


def preview_command(folder: Path) -> list[str]:
    return [sys.executable, "-m", "lumistack", "preview", str(folder)]


def preview_environment() -> dict[str, str]:
    """Returns environment variables with which a child process finds the package."""
    home = str(Path(lumistack.__file__).resolve().parent.parent)
    paths = [home, *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def end_previews() -> None:
    while _previews:
        process = _previews.pop()
        process.terminate()
        try:
            process.wait(5.0)
        except subprocess.TimeoutExpired:
            process.kill()


_CLASSES = (
    LUMISTACK_OT_make,
    LUMISTACK_OT_render_views,
    LUMISTACK_OT_estimate,
    LUMISTACK_OT_look,
    LUMISTACK_OT_fit_depth,
    LUMISTACK_OT_check_depth,
    LUMISTACK_OT_preview,
)


def register() -> None:
    for each in _CLASSES:
        bpy.utils.register_class(each)


def unregister() -> None:
    end_previews()
    jobs.shown.clear()
    jobs.warned.clear()
    cost.forget()
    pictures.remove()
    for each in reversed(_CLASSES):
        bpy.utils.unregister_class(each)

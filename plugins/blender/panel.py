# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels in Blender's render properties."""

from __future__ import annotations

import textwrap

import bpy
import lumistack

from . import cost, jobs, live, overlay, settings as settings_of

#: Mean width of a character in pixels; width of an icon and margins in characters.
CHARACTER_PX, MARGIN = 6.3, 7
#: Largest number of warnings that the panel shows; Blender's Info Log has all of them.
MOST_WARNINGS = 4
#: Least width of a panel with buttons side by side, pixels.
NARROW_PX = 440.0


class _Panel:
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"

    @classmethod
    def poll(cls, context):
        return context.scene is not None

    def buttons(self, context, layout):
        """Returns a row for three buttons, or a column if the panel is narrow."""
        return layout.row(align=True) if context.region.width >= NARROW_PX * context.preferences.system.ui_scale else layout.column(align=True)

    def lines(self, context, layout, text: str, icon: str = "NONE") -> None:
        """Adds a text, wrapped at the panel's width."""
        characters = int(context.region.width / (CHARACTER_PX * context.preferences.system.ui_scale)) - MARGIN
        characters -= 3 if icon != "NONE" else 0
        for number, line in enumerate(textwrap.wrap(text, max(characters, 20))):
            layout.label(text=line, icon="BLANK1" if number and icon != "NONE" else icon)

    def begin(self, context):
        """Sets up the layout with names on the left, as in Blender's own panels. Returns the layout
        and the scene's settings."""
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        return self.layout, context.scene.lumistack


class LUMISTACK_PT_main(_Panel, bpy.types.Panel):
    bl_label = "Tensor Display"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout, settings = self.begin(context)
        row = layout.row()
        row.scale_y = 1.5
        row.operator("lumistack.make", icon="RENDER_STILL")
        self._cost(context, layout)
        row = self.buttons(context, layout)
        row.operator("lumistack.render_views", icon="CAMERA_DATA")
        row.operator("lumistack.look", icon="HIDE_OFF")
        row.operator("lumistack.preview", icon="URL")
        layout.prop(settings, "display_from", expand=True)
        layout.prop(settings, "preset" if settings.display_from == "PRESET" else "file")
        layout.prop(settings, "quality")
        if settings.quality == "CUSTOM":
            column = layout.column(align=True)
            for name in ("percentage", "iterations", "samples"):
                column.prop(settings, name)
        layout.prop(settings, "views_from")
        if settings.views_from == "OWN":
            layout.prop(settings, "views")
        layout.prop(settings, "renderer")
        if settings.renderer != "BLENDER":
            layout.prop(settings, "handover")
        layout.prop(settings, "look")
        if settings.look == "LINEAR":
            layout.prop(settings, "exposure_ev")
        layout.prop(settings, "times")
        layout.prop(settings, "folder")
        if jobs.is_temporary(context.scene):
            self.lines(context, layout.column(align=True), "The file is not saved. The results are deleted when Blender ends", "ERROR")

    def _cost(self, context, layout):
        """Adds the number of renders and the time, or the reason why nothing can be made."""
        column = layout.column(align=True)
        column.scale_y = 0.8
        try:
            found = cost.lines(context.scene, settings_of.display_of(context.scene.lumistack))
        except Exception as error:  # a panel shows every error
            self.lines(context, column, str(error), "ERROR")
            return
        for line in found:
            self.lines(context, column, line)
        held = jobs.shown.get(context.scene.name)
        if held is not None:
            self.lines(context, column, f"Made: {held.score.text()}", "CHECKMARK")
        for warning in jobs.warned.get(context.scene.name, ())[:MOST_WARNINGS]:
            self.lines(context, column, warning, "ERROR")
        layout.operator("lumistack.estimate", icon="TIME")


class LUMISTACK_PT_live(_Panel, bpy.types.Panel):
    bl_label = "Live"
    bl_parent_id = "LUMISTACK_PT_main"

    def draw(self, context):
        layout, settings = self.begin(context)
        session = live.session
        row = layout.row(align=True)
        if session is None:
            row.operator("lumistack.live", text="Attach" if settings.live_run.strip() else "Start Live", icon="PLAY")
            layout.prop(settings, "live_run")
            if lumistack.HAS_PANELS and not settings.live_run.strip():
                layout.prop(settings, "live_show")
        else:
            row.operator("lumistack.live", text="Stop Live" if session.run is None else "Detach", icon="PAUSE", depress=True)
            if session.state.address:
                row.operator("wm.url_open", text="Open Page", icon="URL").url = session.state.address
        column = layout.column(align=True)
        for icon, text in live.status():
            self.lines(context, column, text, icon)


class LUMISTACK_PT_window(_Panel, bpy.types.Panel):
    bl_label = "Window"
    bl_parent_id = "LUMISTACK_PT_main"

    def draw(self, context):
        layout, settings = self.begin(context)
        layout.prop(settings, "window_from")
        if settings.window_from == "DISTANCE":
            layout.prop(settings, "distance")
        if not settings.is_used:
            # The window is computed and drawn only in files that use the extension.
            row = layout.row()
            row.use_property_split = False
            row.prop(settings, "is_used", toggle=True, icon="HIDE_OFF")
        elif overlay.placement(context.scene) is None:
            self.lines(context, layout.column(align=True), overlay.missing[context.scene.name], "ERROR")
        else:
            column = layout.column(align=True)
            for name in ("window_width", "window_height"):
                column.prop(settings, name)
        layout.prop(settings, "window_shift")
        layout.prop(settings, "moved_back_mm")
        layout.prop(settings, "depth_scale")
        row = self.buttons(context, layout)
        row.operator("lumistack.check_depth", icon="DRIVER_DISTANCE")
        row.operator("lumistack.fit_depth", icon="FULLSCREEN_EXIT")
        column = layout.column(heading="Show", align=True)
        for name in ("show_window", "show_depth", "show_cone", "show_picture"):
            column.prop(settings, name)


class LUMISTACK_PT_views(_Panel, bpy.types.Panel):
    bl_label = "Projection, Brightness, Score"
    bl_parent_id = "LUMISTACK_PT_main"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout, settings = self.begin(context)
        layout.prop(settings, "grid")
        if settings.grid == "PERSPECTIVE":
            layout.prop(settings, "distance_mm")
        row = layout.row(heading="Brightness")
        row.prop(settings, "use_brightness", text="")
        held = row.row(align=True)
        held.enabled = settings.use_brightness
        held.prop(settings, "brightness", text="")
        layout.prop(settings, "use_score")


class LUMISTACK_PT_output(_Panel, bpy.types.Panel):
    bl_label = "Output"
    bl_parent_id = "LUMISTACK_PT_main"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout, settings = self.begin(context)
        layout.prop(settings, "output")
        for each in settings_of.fields(settings.output):
            layout.prop(context.scene.lumistack_outputs, each.identifier)


_CLASSES = (LUMISTACK_PT_main, LUMISTACK_PT_live, LUMISTACK_PT_window, LUMISTACK_PT_views, LUMISTACK_PT_output)


def register() -> None:
    for each in _CLASSES:
        bpy.utils.register_class(each)


def unregister() -> None:
    for each in reversed(_CLASSES):
        bpy.utils.unregister_class(each)

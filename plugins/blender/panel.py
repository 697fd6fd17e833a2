# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels in Blender's render properties."""

from __future__ import annotations

import textwrap

import bpy
import lumistack

from . import jobs, live, overlay, settings as settings_of

#: Mean width of a character in pixels; width of an icon and margins in characters.
CHARACTER_PX, MARGIN = 7.0, 8


class _Panel:
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"

    @classmethod
    def poll(cls, context):
        return context.scene is not None

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
        row = layout.row(align=True)
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
        layout.prop(settings, "renderer")
        if settings.renderer != "BLENDER":
            layout.prop(settings, "handover")
        layout.prop(settings, "look")
        if settings.look == "LINEAR":
            layout.prop(settings, "exposure_ev")
        layout.prop(settings, "times")
        layout.prop(settings, "folder")


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
        characters = int(context.region.width / (CHARACTER_PX * context.preferences.system.ui_scale)) - MARGIN
        for icon, text in live.status():
            for number, line in enumerate(textwrap.wrap(text, max(characters, 20))):
                column.label(text=line, icon="BLANK1" if number else icon)


class LUMISTACK_PT_window(_Panel, bpy.types.Panel):
    bl_label = "Window"
    bl_parent_id = "LUMISTACK_PT_main"

    def draw(self, context):
        layout, settings = self.begin(context)
        layout.prop(settings, "window_from")
        if settings.window_from == "DISTANCE":
            layout.prop(settings, "distance")
        if overlay.placement(context.scene) is None:
            layout.label(text=overlay.missing[context.scene.name][:120], icon="ERROR")
        else:
            column = layout.column(align=True)
            for name in ("window_width", "window_height"):
                column.prop(settings, name)
        layout.prop(settings, "window_shift")
        layout.prop(settings, "moved_back_mm")
        layout.prop(settings, "depth_scale")
        row = layout.row(align=True)
        row.operator("lumistack.check_depth", icon="DRIVER_DISTANCE")
        row.operator("lumistack.fit_depth", icon="FULLSCREEN_EXIT")
        column = layout.column(heading="Show", align=True)
        for name in ("show_window", "show_depth", "show_cone", "show_picture"):
            column.prop(settings, name)


class LUMISTACK_PT_views(_Panel, bpy.types.Panel):
    bl_label = "Views"
    bl_parent_id = "LUMISTACK_PT_main"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout, settings = self.begin(context)
        layout.prop(settings, "grid")
        if settings.grid == "PERSPECTIVE":
            layout.prop(settings, "distance_mm")
        for use, name, heading in (("use_views", "views", "Number"), ("use_brightness", "brightness", "Brightness")):
            row = layout.row(heading=heading)
            row.prop(settings, use, text="")
            held = row.row(align=True)
            held.enabled = getattr(settings, use)
            held.prop(settings, name, text="")
        try:
            display = settings_of.display_of(settings)
        except Exception as error:  # a panel shows every error
            layout.label(text=str(error)[:120], icon="ERROR")
            return
        rows, columns, height, width, _ = display.light_field_shape
        layout.label(text=f"{columns} × {rows} views of {width} × {height} pixels")
        held = jobs.shown.get(context.scene.name)
        if held is not None:
            layout.label(text=f"Made: PSNR {held.psnr:.1f} dB")


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

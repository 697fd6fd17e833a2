# SPDX-License-Identifier: GPL-3.0-or-later
"""The settings of a scene: display, window, views, quality, outputs."""

from __future__ import annotations

import functools
import os

import bpy
import lumistack
from bpy.props import BoolProperty, EnumProperty, FloatProperty, FloatVectorProperty, IntProperty, IntVectorProperty, PointerProperty, StringProperty
from lumistack.blender import depth, forms

#: For each quality: percentage of the display's columns and rows, iterations, and paths per pixel of
#: Lumistack's path tracer.
QUALITY = {"DRAFT": (20, 10, 4), "PREVIEW": (50, 25, 16), "FULL": (100, 50, 64)}


@functools.cache
def plugins() -> list[dict]:
    """Returns descriptions of the output plugins that write files."""
    return [plugin for plugin in lumistack.plugins() if plugin["kind"] == "output" and not plugin["presents"]]


@functools.cache
def fields(plugin: str) -> list[forms.Field]:
    return next((forms.fields_of(each) for each in plugins() if each["id"] == plugin), [])


#: Places where a live display is shown. All places except the page need a package that can open
#: windows.
_SHOWN = [("PAGE", "Page", "In the browser")]
if lumistack.HAS_PANELS:
    _SHOWN += [
        ("OUTPUTS", "Panels", "Also on the connected panels, one surface per panel"),
        ("SPAN", "One Surface", "Also on the connected panels, as one surface across all of them"),
        ("WINDOW", "Window", "Also as a preview in a window"),
    ]


def _presets():
    return [(name, name.replace("-", " ").capitalize(), described(lumistack.Display(name))) for name in lumistack.displays()]


def described(display: lumistack.Display) -> str:
    """Returns a sentence about a display, for a tooltip."""
    _, _, rows, columns, _ = display.light_field_shape
    field = display.to_dict()["field"]
    layers = len(display.layer_distances_mm)
    backlight = " over a directional backlight" if display.emission_shape else ""
    parts = [
        f"{layers} layer{'s' if layers > 1 else ''}{backlight}",
        f"{display.frames} frame{'s' if display.frames > 1 else ''}",
        f"{columns} × {rows} pixels of {display.pitch_mm:.3g} mm",
        "viewing zone of " + " × ".join(f"{part:.3g}°" for part in field["fov_deg"]),
    ]
    sharp = display.depth_of_field_mm()
    if sharp is not None:
        parts.append(f"sharp from {depth.place(sharp[0])} to {depth.place(sharp[1])} the display")
    return "; ".join(parts)


def _outputs():
    return [("NONE", "None", "Only the patterns")] + [(each["id"], forms.label(each["id"]), each["doc"]) for each in plugins()]


def _redraw(self, context):
    from . import overlay

    overlay.forget()
    use(self.id_data)
    for window in context.window_manager.windows if context.window_manager else ():
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


def use(scene) -> None:
    """Marks the scene as one that the extension works with: its window is drawn in the 3D view."""
    if not scene.lumistack.is_used:
        scene.lumistack.is_used = True


def _placed(settings):
    from . import overlay

    return overlay.placement(settings.id_data)


def _size(settings, axis: int) -> float:
    placed = _placed(settings)
    return 0.0 if placed is None else placed[1].scale * placed[1].size_mm[axis]


def _set_size(settings, axis: int, value: float) -> None:
    size = _size(settings, axis)
    if size > 0.0 and value > 0.0:
        settings.window_size *= value / size


def _width(settings) -> float:
    return _size(settings, 0)


def _set_width(settings, value: float) -> None:
    _set_size(settings, 0, value)


def _height(settings) -> float:
    return _size(settings, 1)


def _set_height(settings, value: float) -> None:
    _set_size(settings, 1, value)


def _property(each: forms.Field):
    common = {"name": each.label, "description": each.help[:900]}
    match each.kind:
        case "bool":
            return BoolProperty(default=each.default, **common)
        case "int":
            return IntProperty(default=each.default, min=each.least, max=each.most, **common)
        case "float":
            return FloatProperty(default=each.default, min=each.least, max=each.most, **common)
        case "choice":
            items = [(value, forms.label(value), text) for value, text in each.options]
            return EnumProperty(items=items, default=each.default, **common)
        case "file":
            return StringProperty(subtype="FILE_PATH", **common)
        case _:
            return StringProperty(default=each.default or "", **common)


class LumistackOutputs(bpy.types.PropertyGroup):
    """Parameters of all output plugins. The properties are added before the class is registered."""


def _settings_class():
    """Makes the property group of a scene. The package provides its lists of displays and outputs."""
    presets = _presets()
    default = "paper-three-layer" if any(name == "paper-three-layer" for name, *_ in presets) else presets[0][0]
    draw = {"update": _redraw}
    annotations = {
        "display_from": EnumProperty(
            name="Display",
            description="Source of the display's description",
            items=[("PRESET", "Preset", "A display that Lumistack knows"), ("FILE", "File", "A display file (.toml)")],
            **draw,
        ),
        "preset": EnumProperty(name="Preset", description="A display that Lumistack knows", items=presets, default=default, **draw),
        "file": StringProperty(name="File", description="Display file (.toml)", subtype="FILE_PATH", **draw),
        "grid": EnumProperty(
            name="Projection",
            description="Projection of the views",
            items=[
                ("DISPLAY", "As the Display", "The display's own projection"),
                ("OBLIQUE", "Parallel", "Every view is a parallel projection, as from far away"),
                ("PERSPECTIVE", "Eyes", "Every view is seen from an eye in front of the display"),
            ],
            **draw,
        ),
        "distance_mm": FloatProperty(name="Eye Distance (mm)", description="Millimetres from the display to the viewer", default=600.0, min=1.0, max=1e6, **draw),
        "views_from": EnumProperty(
            name="Views",
            description="Number of views that are rendered and from which the patterns are computed",
            items=[
                ("AUTO", "Automatic", "Enough views for a picture that is also correct between the views"),
                ("HALF", "Every Second", "Half of the automatic number on each axis: a quarter of the renders, and a blurred picture between the views"),
                ("OWN", "Own Number", "The number below. Between few views the picture is blurred"),
            ],
            **draw,
        ),
        "views": IntVectorProperty(name="Number", description="Number of views, horizontal and vertical", size=2, default=(5, 5), min=1, max=64, **draw),
        "use_score": BoolProperty(
            name="Score",
            description="Render a few more pictures from directions between the views, and report how well the display shows these directions",
            default=True,
        ),
        "is_used": BoolProperty(name="Draw in 3D View", description="Draw the display's window, and its handles, in the 3D view", default=False),
        "use_brightness": BoolProperty(name="Own Brightness", description="Use the brightness scale below instead of the display's own", **draw),
        "brightness": FloatProperty(name="Brightness", description="Brightness scale: the display emits the target times this factor", default=0.2, min=0.001, max=1.0, **draw),
        "quality": EnumProperty(
            name="Quality",
            description="Pixels, iterations of the solver, and paths of Lumistack's path tracer. If Views is Automatic, a run measures the number of paths instead, except with Custom",
            items=[
                ("DRAFT", "Draft", "A fifth of the display's columns and rows, 10 iterations, 4 paths per pixel and view"),
                ("PREVIEW", "Preview", "Half of the display's columns and rows, 25 iterations, 16 paths per pixel and view"),
                ("FULL", "Full", "All pixels of the display, 50 iterations, 64 paths per pixel and view"),
                ("CUSTOM", "Custom", "The numbers below"),
            ],
            default="PREVIEW",
            **draw,
        ),
        "percentage": IntProperty(name="Pixels", description="Percentage of the display's columns and rows", subtype="PERCENTAGE", default=50, min=1, max=100, **draw),
        "iterations": IntProperty(name="Iterations", description="Iterations of the solver, each of which updates all layers", default=25, min=1, max=10000),
        "samples": IntProperty(name="Paths", description="Paths per pixel and view of Lumistack's path tracer", default=16, min=1, max=65536),
        "window_from": EnumProperty(
            name="Window",
            description="Distance of the window from the camera; by default the window is as wide as the camera's picture at that distance",
            items=[
                ("AUTO", "Automatic", "In the camera's plane of focus; for a camera without focus, at a distance that the visible content determines"),
                ("DISTANCE", "Distance", "At a distance from the camera"),
            ],
            **draw,
        ),
        "distance": FloatProperty(name="Distance", description="Distance from the camera to the window", subtype="DISTANCE", default=10.0, min=1e-4, max=1e6, **draw),
        "window_size": FloatProperty(
            name="Size",
            description="Width of the window, relative to the width of the camera's picture in the window's plane",
            default=1.0, min=0.01, max=100.0, soft_min=0.1, soft_max=4.0, **draw,
        ),  # fmt: skip
        "window_shift": FloatVectorProperty(
            name="Shift",
            description="Offset of the window in its plane from the middle of the camera's picture, to the right and up, in widths of that picture",
            subtype="XYZ", size=2, default=(0.0, 0.0), min=-100.0, max=100.0, soft_min=-2.0, soft_max=2.0, **draw,
        ),  # fmt: skip
        "window_width": FloatProperty(
            name="Width", description="Width of the window; its height follows the display", subtype="DISTANCE", unit="LENGTH", get=_width, set=_set_width
        ),
        "window_height": FloatProperty(
            name="Height", description="Height of the window; its width follows the display", subtype="DISTANCE", unit="LENGTH", get=_height, set=_set_height
        ),
        "moved_back_mm": FloatProperty(
            name="Back (mm)",
            description="Moves the window along its normal, in millimetres of the display; the view from straight ahead stays the same",
            default=0.0, min=-1e5, max=1e5, **draw,
        ),  # fmt: skip
        "depth_scale": FloatProperty(
            name="Depth Scale", description="Factor on parallax: below 1 the scene looks flatter and is sharper", default=1.0, min=0.01, max=10.0, **draw
        ),
        "renderer": EnumProperty(
            name="Renderer",
            description="Program that renders the views",
            items=[
                ("BLENDER", "Blender", "The scene's engine, Cycles or EEVEE, with its settings"),
                ("LUMISTACK", "Lumistack", "Lumistack's path tracer, of the exported scene"),
                ("BOTH", "Both", "Blender's views, and their difference from Lumistack's"),
            ],
        ),
        "handover": EnumProperty(
            name="Hand-over",
            description="Format in which Lumistack's path tracer receives the scene",
            items=[
                ("GLTF", "glTF", "Blender's glTF exporter, with the scene's lights in the units of Cycles"),
                ("USD", "USD", "Blender's USD exporter, including subdivision surfaces"),
                ("BOTH", "Both", "Renders both and reports their difference; the views of the glTF file are used"),
            ],
        ),
        "look": EnumProperty(
            name="Look",
            description="Exposure and tone curve, the same for all views",
            items=[
                ("SCENE", "As in Blender", "View transform, exposure, look and curves of Color Management, for every renderer"),
                ("LINEAR", "Linear", "Radiance times the exposure below; values brighter than white are clipped"),
            ],
        ),
        "exposure_ev": FloatProperty(name="Exposure", description="Exposure in stops: 1 doubles the light", default=0.0, min=-20.0, max=20.0),
        "times": EnumProperty(
            name="Time",
            description="Frames for which patterns are made",
            items=[("CURRENT", "Current Frame", "A still"), ("RANGE", "Frame Range", "The scene's frames; each frame starts with the patterns of the previous frame")],
        ),
        "folder": StringProperty(name="Folder", description="Folder of views, patterns and outputs; // is the folder of the .blend file", subtype="DIR_PATH", default="//lumistack"),
        "live_run": StringProperty(
            name="Attach To", description="Run folder of a `lumistack live` that already runs; its display then shows this scene. Empty: a new `lumistack live` is started", subtype="DIR_PATH"
        ),
        "live_show": EnumProperty(name="Show", description="Where a new live display appears", items=_SHOWN, default="PAGE"),
        "output": EnumProperty(name="Output", description="Additional output besides the patterns", items=_outputs(), default="NONE"),
        "show_window": BoolProperty(name="Window", description="Draw the display's window and its handles in the 3D view", default=True, **draw),
        "show_depth": BoolProperty(name="Depth of Field", description="Draw the depths that the display shows sharply", default=True, **draw),
        "show_cone": BoolProperty(name="Viewing Cone", description="Draw the viewing zone", default=False, **draw),
        "show_picture": BoolProperty(name="Simulated View", description="Show the simulated view on the window in the 3D view", default=True, **draw),
    }
    return type("LumistackSettings", (bpy.types.PropertyGroup,), {"__annotations__": annotations, "__doc__": __doc__})


_registered: list[type] = []


def register() -> None:
    LumistackOutputs.__annotations__ = {each.identifier: _property(each) for plugin in plugins() for each in fields(plugin["id"])}
    for made in (LumistackOutputs, _settings_class()):
        bpy.utils.register_class(made)
        _registered.append(made)
    bpy.types.Scene.lumistack = PointerProperty(type=_registered[1])
    bpy.types.Scene.lumistack_outputs = PointerProperty(type=_registered[0])


def unregister() -> None:
    del bpy.types.Scene.lumistack_outputs
    del bpy.types.Scene.lumistack
    while _registered:
        bpy.utils.unregister_class(_registered.pop())
    plugins.cache_clear()
    fields.cache_clear()


def quality(settings) -> tuple[int, int, int]:
    """Returns the percentage of the display's columns and rows, the iterations, and the paths per pixel."""
    if settings.quality == "CUSTOM":
        return settings.percentage, settings.iterations, settings.samples
    return QUALITY[settings.quality]


def is_automatic(settings) -> bool:
    """Returns true if the path tracer chooses the number of paths per pixel by a measurement, as in
    `lumistack run`. This is so for automatic views, unless the user sets the number."""
    return settings.views_from == "AUTO" and settings.quality != "CUSTOM"


def display_of(settings, is_live: bool = False) -> lumistack.Display:
    """Returns the display with the changes of the settings. Raises the package's error if the display
    is invalid. With `is_live`, Every Second has no effect, since `lumistack live` chooses the automatic
    views."""
    if settings.display_from == "FILE":
        path = bpy.path.abspath(settings.file)
        if not os.path.isfile(path):
            found = f"found none at {path}" if path else "found no path"
            raise ValueError(f"File: expected a display file (.toml), {found}; select a display file, or set Display to Preset")
        display = lumistack.Display(path)
    else:
        display = lumistack.Display(settings.preset)
    described = display.to_dict()
    field = described["field"]
    if settings.grid != "DISPLAY":
        field["projection"] = settings.grid.lower()
        field.pop("distance_mm", None)
        if settings.grid == "PERSPECTIVE":
            field["distance_mm"] = settings.distance_mm
        display = lumistack.Display(described)
    share = quality(settings)[0] / 100.0
    changes: dict[str, object] = {}
    if share < 1.0:
        changes["resolution"] = [max(round(share * pixels), 8) for pixels in field["resolution"]]
    if settings.use_brightness:
        changes["brightness"] = settings.brightness
    if settings.views_from == "OWN":
        changes["views"] = list(settings.views)
    if changes:
        display = lumistack.Display(display, **changes)
    if settings.views_from == "HALF" and not is_live:
        display = lumistack.Display(display, views=_half_of(display))
    return display


def _half_of(display: lumistack.Display) -> object:
    """Returns the argument `views` for every second view."""
    if display.to_dict()["field"]["views"] != "auto":
        rows, columns, *_ = display.light_field_shape
        return [(columns + 1) // 2, (rows + 1) // 2]
    # A step of two views. A step of 0 means a single view.
    return {"step": [2.0 * (slopes[1] - slopes[0]) if len(slopes) > 1 else 0.0 for slopes in map(sorted, display.slopes)]}


def output_parameters(scene, plugin: str) -> dict[str, object]:
    values = scene.lumistack_outputs
    found = {each.identifier: getattr(values, each.identifier) for each in fields(plugin)}
    for each in fields(plugin):
        if each.kind == "file" and found[each.identifier] and not found[each.identifier].lstrip().startswith("{"):
            found[each.identifier] = bpy.path.abspath(found[each.identifier])
    return forms.given(fields(plugin), found)

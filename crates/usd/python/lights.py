"""Reads lights (UsdLux) at one time code. Colour and brightness become one radiance.

`radiance` is colour · colour temperature · intensity · 2^exposure, before any normalization. Sizes
are in the light's space.
"""

import math

from pxr import UsdGeom, UsdLux

from lumistack_usd import materials

KINDS = {
    "DistantLight": "distant",
    "SphereLight": "sphere",
    "RectLight": "rect",
    "DiskLight": "disk",
    "CylinderLight": "cylinder",
    "DomeLight": "dome",
    "DomeLight_1": "dome",
}
SIZES = {
    "distant": {"angle": 0.53},
    "sphere": {"radius": 0.5, "treatAsPoint": False},
    "rect": {"width": 1.0, "height": 1.0},
    "disk": {"radius": 0.5},
    "cylinder": {"radius": 0.5, "length": 1.0, "treatAsLine": False},
    "dome": {},
}
SHAPING = {"shaping:cone:angle": 90.0, "shaping:cone:softness": 0.0, "shaping:focus": 0.0}


def light(prim, writer, time):
    """Returns the entry of a light. None for other prims, for shapes that emit light, and for
    lights of unsupported types."""
    if not prim.HasAPI(UsdLux.LightAPI):
        return None
    name = str(prim.GetTypeName())
    kind = KINDS.get(name)
    if kind is None:
        if prim.IsA(UsdGeom.Gprim):
            return None
        if name in ("GeometryLight", "PortalLight", "PluginLight") or prim.IsA(UsdLux.BoundableLightBase):
            writer.warn(prim.GetPath(), "the light %s is not supported and is left out" % name)
        return None
    entry = dict(emission(prim, writer, time), kind=kind)
    if kind == "distant":
        # The schema gives distant lights another default intensity.
        entry["radiance"] = brightness(prim, time, 50000.0)
    for size, default in SIZES[kind].items():
        entry[size] = number(prim, size, time, default)
    if prim.HasAPI(UsdLux.ShapingAPI):
        shaping = {size.split(":", 1)[1]: number(prim, size, time, default) for size, default in SHAPING.items()}
        if shaping["cone:angle"] < 90.0 or shaping["focus"] > 0.0:
            entry["shaping"] = shaping
        if asset(prim, "shaping:ies:file", time):
            writer.warn(prim.GetPath(), "the light's IES profile is not supported and has no effect")
    if kind in ("rect", "dome"):
        entry["image"] = picture(prim, writer, time)
    if kind == "dome":
        entry["format"] = str(value(prim, "texture:format", time) or "automatic")
        entry["pole_z"] = pole_is_z(prim, name)
    return entry


def emission(prim, writer, time):
    """Returns the part of an entry that all kinds of lights have."""
    for collection in ("lightLink", "shadowLink"):
        roots = prim.GetRelationship("collection:%s:includes" % collection), prim.GetRelationship("collection:%s:excludes" % collection)
        if any(targets and targets.GetTargets() for targets in roots):
            writer.warn(prim.GetPath(), "the light's %s is not supported, so the light illuminates all objects, and all objects cast shadows" % collection)
    filters = prim.GetRelationship("light:filters")
    if filters and filters.GetTargets():
        writer.warn(prim.GetPath(), "the light's filters are not supported and have no effect")
    return {
        "place": str(prim.GetPath()),
        "radiance": brightness(prim, time, 1.0),
        "normalize": bool(value(prim, "normalize", time)),
    }


def mesh_light(prim, writer, time):
    """Returns the emission of a mesh or volume that is a light (`MeshLightAPI`), or None."""
    if not prim.HasAPI(UsdLux.LightAPI):
        return None
    entry = emission(prim, writer, time)
    mode = value(prim, "materialSyncMode", time) or prim.GetAttribute("light:materialSyncMode").Get(time)
    entry["sync"] = str(mode or "materialGlowTintsLight")
    return entry


def brightness(prim, time, default):
    color = value(prim, "color", time)
    color = [float(part) for part in color] if color is not None else [1.0, 1.0, 1.0]
    intensity, exposure = number(prim, "intensity", time, default), number(prim, "exposure", time, 0.0)
    factor = intensity * 2.0 ** max(-126.0, min(exposure, 126.0))
    if value(prim, "enableColorTemperature", time):
        warmth = UsdLux.BlackbodyTemperatureAsRgb(number(prim, "colorTemperature", time, 6500.0))
        color = [part * tint for part, tint in zip(color, warmth)]
    return [max(0.0, part * factor) if math.isfinite(part * factor) else 0.0 for part in color]


def value(prim, name, time):
    """Returns the value of a light's input. In files from before 2021 the input's name lacks the
    prefix `inputs:`."""
    for full in ("inputs:" + name, name):
        attribute = prim.GetAttribute(full)
        if attribute and attribute.HasValue():
            found = attribute.Get(time)
            if found is not None:
                return found
    return None


def number(prim, name, time, default):
    found = value(prim, name, time)
    if isinstance(default, bool):
        return default if found is None else bool(found)
    found = default if found is None else float(found)
    return found if math.isfinite(found) else default


def asset(prim, name, time):
    found = value(prim, name, time)
    return found if found is not None and getattr(found, "path", "") else None


def picture(prim, writer, time):
    """Returns the index of the image of a light's texture. None if the light has no texture, or, after
    a warning, if the texture's file does not exist."""
    found = asset(prim, "texture:file", time)
    if found is None:
        return None
    place = "%s.inputs:texture:file" % prim.GetPath()
    resolved = str(found.resolvedPath)
    if not resolved:
        writer.warn(place, "the picture %s does not exist; the light is shown with its colour only" % found.path)
        return None
    writer.file(resolved)
    return writer.image(resolved, lambda: materials.image_entry(writer, place, found.path, resolved))


def pole_is_z(prim, name):
    """Returns true if the top of a dome's picture is at +z of the light's space instead of +y."""
    if name != "DomeLight_1":
        return False
    axis = prim.GetAttribute("poleAxis").Get()
    if axis in (None, "scene"):
        return UsdGeom.GetStageUpAxis(prim.GetStage()) == UsdGeom.Tokens.z
    return axis == "Z"

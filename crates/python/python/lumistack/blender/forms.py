"""Describes parameters of output plugins as properties of Blender's panel. The description comes
from the schema with which the command line and Python also check the parameters."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

#: Largest value of an integer property of Blender.
MOST_INT = 2**31 - 1

#: Words of names that a label shows in another form.
_WORDS = {"dpi": "DPI", "exr": "OpenEXR", "hci": "HCI", "npz": "NumPy", "png": "PNG", "png8": "PNG, 8 bits", "png16": "PNG, 16 bits"}
_WORDS |= {"a3": "A3", "a4": "A4", "srgb": "sRGB"}
#: Names whose label differs from their words.
_NAMES = {
    "encode": "Encoding",
    "exr_depth": "OpenEXR precision",
    "exr_multi_view": "OpenEXR of all views",
    "hci": "HCI light field",
    "stanford": "Stanford light field",
    "web_simulator": "Web page",
    "16-gen2": "16 inches, 2nd generation",
    "16-gen3-landscape": "16 inches, landscape",
    "16-gen3-portrait": "16 inches, portrait",
    "32-gen3-landscape": "32 inches, landscape",
    "32-gen3-portrait": "32 inches, portrait",
    "65": "65 inches",
}


@dataclass(frozen=True)
class Field:
    """The property of Blender for one parameter of a plugin."""

    #: Name of the parameter.
    name: str
    #: A name that Blender accepts.
    identifier: str
    #: "bool", "int", "float", "choice", "text" or "file".
    kind: str
    label: str
    help: str
    default: Any = None
    least: Any = None
    most: Any = None
    #: (value, help) of every option of a choice.
    options: tuple[tuple[str, str], ...] = field(default=())


def fields_of(plugin: Mapping[str, Any]) -> list[Field]:
    """Returns the properties for the parameters of a plugin. `plugin` is an entry of
    `lumistack.plugins()`."""
    return [_field(plugin["id"], param) for param in plugin.get("params", ())]


def _field(plugin: str, param: Mapping[str, Any]) -> Field:
    name, kind = param["name"], param["kind"]
    # Plugins state "1" as the unit of a plain number; a label does not show it.
    unit = param.get("unit") if param.get("unit") not in (None, "1") else ""
    default, least, most = param.get("default"), param.get("min"), param.get("max")
    if kind == "int":
        default, least, most = (max(min(int(value or 0), MOST_INT), -MOST_INT - 1) for value in (default, least, most))
    if kind == "file":
        default = ""
    return Field(
        name=name,
        identifier=identifier(plugin, name),
        kind=kind,
        label=label(name, unit),
        help=param.get("help", "").rstrip("."),
        default=default,
        least=least,
        most=most,
        options=tuple((option["value"], option.get("help", "")) for option in param.get("options", ())),
    )


def label(name: str, unit: str | None = "") -> str:
    """Returns the label of a name, such as "OpenEXR precision" for "exr_depth". The unit stands in
    brackets, unless the label contains it. The units bits and dots/inch are omitted."""
    if name in _NAMES:
        return _NAMES[name]
    words = name.split("_")
    # The names of some parameters end with their unit.
    ends = {"mm": "mm", "deg": "°", "mb": "MB"}
    if len(words) > 1 and words[-1] in ends:
        unit = ends[words.pop()]
    text = " ".join(_WORDS.get(word, word) for word in words)
    text = text[:1].upper() + text[1:] if words[0] not in _WORDS else text
    is_said = not unit or unit in ("bits", "dots/inch") or unit.casefold() in text.casefold()
    return text if is_said else f"{text} ({unit})"


def identifier(plugin: str, name: str) -> str:
    """Returns the name of a property: letters, digits and underscores, at most 63 characters."""
    return re.sub(r"\W", "_", f"{plugin}_{name}", flags=re.ASCII)[:63]


def given(fields: Sequence[Field], values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the parameters for the plugin: the values that differ from their defaults."""
    changed = {}
    for each in fields:
        value = values[each.identifier]
        if each.kind == "float" and abs(value - each.default) <= 1e-6 * max(abs(each.default), 1e-6):
            # Blender stores single precision, so an unchanged default may differ slightly.
            continue
        if value != each.default:
            changed[each.name] = value
    return changed

"""Exports Blender's active scene as a USD file, in the units of light of Blender's exporter."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

SETTINGS = {
    "selected_objects_only": False,
    "visible_objects_only": False,
    "export_animation": False,
    "export_hair": True,
    "export_uvmaps": True,
    "export_normals": True,
    "export_materials": True,
    "export_subdivision": "BEST_MATCH",
    "export_armatures": False,
    "export_shapekeys": False,
    "use_instancing": True,
    "evaluation_mode": "RENDER",
    "generate_preview_surface": True,
    "generate_materialx_network": False,
    "convert_orientation": False,
    "convert_scene_units": "METERS",
    "convert_world_material": True,
    "export_textures_mode": "NEW",
    "overwrite_textures": True,
    "relative_paths": True,
    "export_custom_properties": False,
}


def is_readable(bpy: Any) -> bool:
    """Returns true if this Python can read USD files. The module bpy hides Blender's own OpenUSD,
    so this function searches for it."""
    if importlib.util.find_spec("pxr") is None:
        version = f"python{sys.version_info[0]}.{sys.version_info[1]}"
        home = Path(bpy.utils.resource_path("LOCAL")) / "python"
        for place in (home / "lib" / version / "site-packages", home / "lib" / "site-packages"):
            if (place / "pxr").is_dir() and str(place) not in sys.path:
                sys.path.append(str(place))
    return importlib.util.find_spec("pxr") is not None


class NoExporter(RuntimeError):
    """This Blender was built without USD."""


def export_scene(bpy: Any, path: str | Path) -> None:
    """Writes the scene at the current frame. The scene's pictures are written to a folder beside
    the file."""
    if not bpy.app.build_options.usd:
        raise NoExporter(f"Blender {bpy.app.version_string} was built without USD; hand the scene over as glTF")
    known = bpy.ops.wm.usd_export.get_rna_type().properties.keys()
    bpy.ops.wm.usd_export(filepath=str(path), **{name: value for name, value in SETTINGS.items() if name in known})

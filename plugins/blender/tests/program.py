# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks the extension in a Blender program of any version from 3.4, with or without support for
extensions:

    blender -b --factory-startup --python-exit-code 1 --python program.py -- FOLDER PLACE

PLACE contains the Python package, as in its wheel, and the extension's source as the package
`lumistack_extension`. Debian's Blender 3.4 supports neither extensions nor `--command`. So this
script imports the extension, and calls its command without a window, as `--command` does.
"""

import os
import sys
import traceback
from pathlib import Path

#: A display of 24 × 15 pixels with 3 × 3 views.
DISPLAY = """name = "three tiny layers"
frames = 2
refresh_hz = 120.0
brightness = 0.5

[backlight]
kind = "uniform"

[field]
resolution = [24, 15]
pitch_mm = 8.0
views = [3, 3]
fov_deg = [24.0, 18.0]
"""
LAYER = """
[[layers]]
d_mm = %.1f
resolution = [24, 15]
pitch_mm = 8.0
"""


def scene_to_show(bpy):
    """Makes a scene: a cube with a noise texture and hair, a plain cube, a lamp and a camera."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 1, False
    cube = bpy.data.objects["Cube"]
    look = bpy.data.materials.new("bark")
    look.use_nodes = True
    noise = look.node_tree.nodes.new("ShaderNodeTexNoise")
    look.node_tree.links.new(noise.outputs["Color"], look.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
    cube.data.materials.clear()
    cube.data.materials.append(look)
    fur = cube.modifiers.new("fur", "PARTICLE_SYSTEM").particle_system.settings
    fur.type, fur.count = "HAIR", 20
    bpy.ops.mesh.primitive_cube_add(location=(3.0, 0.0, 0.0))
    bpy.context.object.name = "plain"
    return scene


def check(bpy, folder, place):
    sys.path[:0] = [str(place)]
    import lumistack
    import lumistack_extension
    from lumistack.blender import unshown
    from lumistack_extension import command

    scene = scene_to_show(bpy)
    lines = "\n".join(unshown.unshown(bpy, scene))
    assert "bark (Noise Texture)" in lines and "hair" in lines and "plain" not in lines.replace("plain colours", ""), lines
    lumistack_extension.register()
    # Save and open the file, as with `blender -b FILE`.
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "shot.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(folder / "shot.blend"), load_ui=False)
    display = folder / "display.toml"
    display.write_text(DISPLAY + "".join(LAYER % depth for depth in (-12.0, 0.0, 12.0)), encoding="utf-8")
    with bpy.context.temp_override(window=None):
        assert not hasattr(bpy.context, "active_object"), "this context is not that of a command"
        # Views by Blender need version 4.2, the oldest that the extension supports. The export also
        # works in older versions.
        for renderer in ("lumistack", "both") if bpy.app.version >= (4, 2) else ("lumistack",):
            out = folder / renderer
            words = ["make", "--display", str(display), "--iterations", "1", "--samples", "1", "--look", "linear", "--renderer", renderer, "-o", str(out)]
            assert command.main(words) == 0, f"{renderer}: the command failed"
            assert b'"plain"' in (out / "scene.glb").read_bytes(), f"{renderer}: the scene was not exported"
            assert lumistack.LayerStack.open(out) is not None
    lumistack_extension.unregister()


def main():
    import bpy

    folder, place = (Path(word).resolve() for word in sys.argv[sys.argv.index("--") + 1 :])
    try:
        check(bpy, folder, place)
        print(f"program: Blender {bpy.app.version_string} as a program, without a window: ok")
        code = 0
    except BaseException:
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


main()

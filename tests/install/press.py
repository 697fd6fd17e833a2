"""Runs the operator of the extension's button in a Blender with the installed extension, and checks the files in FOLDER.

usage: blender --background --python press.py -- FOLDER
"""

import sys
from pathlib import Path

import bpy

folder = Path(sys.argv[sys.argv.index("--") + 1])
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
""" + "".join(f"\n[[layers]]\nd_mm = {d_mm}\nresolution = [24, 15]\npitch_mm = 8.0\n" for d_mm in (-12.0, 0.0, 12.0))
display = folder / "display.toml"
display.write_text(DISPLAY, encoding="utf-8")

scene = bpy.context.scene
scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 1, False
held = scene.lumistack
held.display_from, held.file = "FILE", str(display)
held.quality, held.percentage, held.iterations, held.samples = "CUSTOM", 100, 2, 1
for renderer in ("BLENDER", "LUMISTACK"):
    held.renderer, held.folder = renderer, str(folder / renderer.lower())
    result = bpy.ops.lumistack.make()
    assert result == {"FINISHED"}, f"{renderer}: the button ended with {result}"
    for name in ("layers/stack.json", "target/lightfield.json"):
        assert (folder / renderer.lower() / name).is_file(), f"{renderer}: the button left no {name}"
    print(f"the button makes a display of the views by {renderer}", flush=True)
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "shot.blend"))

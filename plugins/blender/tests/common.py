# SPDX-License-Identifier: GPL-3.0-or-later
"""Helpers of the cases: they install the extension, set up a scene, and read pictures."""

from pathlib import Path

HERE = Path(__file__).resolve().parent


def settings_file(folder):
    import scenes

    path = folder / "anzeige ü.toml"
    path.write_text(scenes.DISPLAY, encoding="utf-8")
    return path


def install(zip_path):
    """Installs the extension as a user does: Preferences > Get Extensions > Install from Disk."""
    import bpy

    result = bpy.ops.extensions.package_install_files(filepath=str(zip_path), repo="user_default", enable_on_install=True)
    assert result == {"FINISHED"}, result
    assert "bl_ext.user_default.lumistack" in bpy.context.preferences.addons.keys()


def disable():
    import bpy

    bpy.ops.preferences.addon_disable(module="bl_ext.user_default.lumistack")


def configure(scene, folder, **values):
    held = scene.lumistack
    held.display_from, held.file = "FILE", str(settings_file(folder))
    held.quality, held.percentage, held.iterations, held.samples = "CUSTOM", 100, 3, 16
    held.look = "LINEAR"
    held.folder = str(folder / "Ausgabe ü")
    for name, value in values.items():
        setattr(held, name, value)
    return Path(held.folder)


def run(scene, **values):
    from bl_ext.user_default.lumistack import jobs

    job = jobs.Job(scene, **values)
    jobs.run_now(job)
    return job


def picture_of(path):
    """Returns the values of an OpenEXR picture, [row, column, channel]."""
    import bpy
    import numpy

    image = bpy.data.images.load(str(path))
    values = numpy.empty(image.size[0] * image.size[1] * image.channels, numpy.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], image.channels)[..., :3]

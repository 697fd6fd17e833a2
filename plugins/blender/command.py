# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `blender -b FILE.blend --command lumistack ...`: does the work of the button without
a window, and ends with an exit code.

Versions of Blender without --command, and scripts, call `main`:

    blender -b FILE.blend --python-expr "import sys; from bl_ext.user_default.lumistack import command; sys.exit(command.main(['make']))"
"""

from __future__ import annotations

import sys

import bpy
import lumistack
from lumistack.blender import command_line, handover

from . import jobs

_handle = None


def main(words: list[str]) -> int:
    """Returns the exit code: 0 after success, 1 after an error, 2 for wrong usage, 130 after an
    interrupt."""
    try:
        asked = command_line.parse(words)
    except command_line.Usage as usage:
        print(usage, file=sys.stderr if usage.code else sys.stdout)
        return usage.code
    try:
        if asked.blend:
            bpy.ops.wm.open_mainfile(filepath=asked.blend, load_ui=False)
        scene = bpy.data.scenes.get(asked.scene) if asked.scene else bpy.context.scene
        if scene is None:
            names = ", ".join(each.name for each in bpy.data.scenes)
            raise ValueError(f"--scene: expected one of the scenes {names}, found {asked.scene!r}")
        for name, value in asked.settings.items():
            setattr(scene.lumistack, name, value)
        for name, value in asked.scene_settings.items():
            setattr(scene, name, value)
        job = jobs.Job(scene, factorize=asked.what == "make")
        # A command has no window, but exporters need one. `in_window` gives the exporters one of
        # the file's windows, which shows the scene that the command requests.
        with handover.in_window(bpy, scene):
            if asked.fit_depth:
                print(jobs.fit_depth(scene, compress=asked.fit_depth == "compress"), flush=True)
            said = command_line.ProgressPrinter(sys.stdout)
            jobs.run_now(job, said)
    except KeyboardInterrupt:
        print("stopped; finished views and patterns are kept", file=sys.stderr)
        return 130
    except (jobs.JobError, lumistack.Error, RuntimeError, TypeError, ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    for warning in job.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    for line in [f"views rendered: {job.rendered}, views kept from earlier runs: {job.kept}", *job.said]:
        print(line)
    return 0


def register() -> None:
    global _handle
    if hasattr(bpy.utils, "register_cli_command"):
        _handle = bpy.utils.register_cli_command("lumistack", main)


def unregister() -> None:
    global _handle
    if _handle is not None:
        bpy.utils.unregister_cli_command(_handle)
        _handle = None

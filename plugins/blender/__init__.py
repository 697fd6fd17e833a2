# SPDX-License-Identifier: GPL-3.0-or-later
"""Lumistack in Blender: the open scene on a tensor display.

What needs no `bpy` is in the Python package `lumistack`, whose wheel comes with the extension; here are the panel, the operators and what Blender
calls.

    settings    what a scene keeps                 operators   what buttons do
    jobs        what is done, step by step         panel       where they stand
    pictures    views from files, simulated ones   overlay     what the 3D view shows
    digest      whether kept views still hold      command     `blender --command lumistack`
"""

from . import command, jobs, operators, overlay, panel, settings

_PARTS = (settings, operators, panel, overlay, command)


def register() -> None:
    done = []
    try:
        for part in _PARTS:
            part.register()
            done.append(part)
    except BaseException:
        for part in reversed(done):
            part.unregister()
        raise


def unregister() -> None:
    jobs.end_all()
    for part in reversed(_PARTS):
        part.unregister()

# SPDX-License-Identifier: GPL-3.0-or-later
"""Lumistack in Blender: patterns of a tensor display for the active scene.

Code that does not need `bpy` is in the Python package `lumistack`, whose wheel is part of the
extension. This package contains the panels, the operators and the functions that Blender calls.

    settings    the settings of a scene             operators   the actions of the buttons
    jobs        the work, step by step              panel       the panels
    pictures    views from files, simulated views   overlay     the drawing in the 3D view
    digest      the validity of kept views          command     `blender --command lumistack`
    live        a display that follows the scene    cost        number of renders, time of a run
"""

from . import command, jobs, live, operators, overlay, panel, settings

_PARTS = (settings, operators, live, panel, overlay, command)


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

# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimates, before the user presses the button, the number of renders and the time of the work.

The time follows from measured rates, seconds per unit of work. The rates are kept only for this
session, since they depend on the scene and the machine.
"""

from __future__ import annotations

import math

import lumistack

from . import settings as settings_of

#: Pairs of the largest number of the score's directions per axis, and the fraction of the viewing
#: zone that these directions span. The first pair is for Blender's views. The second pair is for
#: views of our path tracer, which cost less.
SCORED = ((2, 0.7), (4, 1.0))
#: The panel states the size of light fields that are larger than this.
LARGE_MIB = 1024.0
ENGINES = {"CYCLES": "Cycles", "BLENDER_EEVEE": "EEVEE", "BLENDER_EEVEE_NEXT": "EEVEE", "BLENDER_WORKBENCH": "Workbench"}

_rates: dict[tuple[str, str], float] = {}


def record(scene_name: str, kind: str, seconds: float, work: float) -> None:
    """Records the rate of finished work of a kind: an engine of Blender, "GLTF", "USD",
    "GLTF score", "USD score" or "PATTERNS". `work` is the result of the function `work_of_...` for
    this kind."""
    _rates[scene_name, kind] = seconds / work


def forget() -> None:
    _rates.clear()


def samples_of(scene) -> int | None:
    """Returns the samples per pixel that the scene's engine renders; None if they are not known."""
    engine = scene.render.engine
    if engine == "CYCLES" and hasattr(scene, "cycles"):
        return scene.cycles.samples
    if engine.startswith("BLENDER_EEVEE"):
        return scene.eevee.taa_render_samples
    return None


def work_of_render(scene, pixels: int) -> float:
    """Returns the work of one of Blender's renders, in samples."""
    return float(pixels * (samples_of(scene) or 1))


def work_of_trace(display: lumistack.Display, settings) -> float:
    """Returns the work of our path tracer, in paths. An automatic number of paths is measured for
    each scene, so it is part of the rate."""
    paths = 1 if settings_of.is_automatic(settings) else settings_of.quality(settings)[2]
    return math.prod(display.light_field_shape[:4]) * float(paths)


def work_of_score(display: lumistack.Display) -> float:
    """Returns the work of one of our path tracer's two renders for the score."""
    from . import jobs

    slopes = jobs.between_of(display, SCORED[1])
    return float(len(slopes[0]) * len(slopes[1]) * math.prod(display.light_field_shape[2:4]))


def work_of_patterns(display: lumistack.Display, iterations: int) -> float:
    return math.prod(display.light_field_shape[:4]) * float(display.frames * iterations)


def renders(scene, display: lumistack.Display) -> tuple[int, int]:
    """Returns the number of views, and of Blender's further renders for the score."""
    from . import jobs

    rows, columns, *_ = display.light_field_shape
    more = jobs.between_of(display, SCORED[0]) if scene.lumistack.use_score else ([], [])
    return rows * columns, len(more[0]) * len(more[1])


def frames(scene) -> int:
    if scene.lumistack.times == "CURRENT":
        return 1
    return len(range(scene.frame_start, scene.frame_end + 1, max(scene.frame_step, 1)))


def seconds(scene, display: lumistack.Display) -> float | None:
    """Returns the time of all renders and patterns, seconds; None before the renders were measured.
    Patterns and the path tracer's views for the score count only after they were measured."""
    from . import jobs

    settings = scene.lumistack
    _, _, rows, columns, _ = display.light_field_shape
    total = 0.0
    for renderer in jobs.renderers_of(settings):
        kind = scene.render.engine if renderer == "BLENDER" else renderer
        work = sum(renders(scene, display)) * work_of_render(scene, rows * columns) if renderer == "BLENDER" else work_of_trace(display, settings)
        rate = _rates.get((scene.name, kind))
        if rate is None:
            return None
        total += rate * work
    first = jobs.renderers_of(settings)[0]
    if settings.use_score and first != "BLENDER":
        total += 2.0 * _rates.get((scene.name, f"{first} score"), 0.0) * work_of_score(display)
    total += _rates.get((scene.name, "PATTERNS"), 0.0) * work_of_patterns(display, settings_of.quality(settings)[1])
    return total * frames(scene)


def lines(scene, display: lumistack.Display) -> list[str]:
    """Returns sentences about the cost."""
    settings = scene.lumistack
    view_rows, view_columns, rows, columns, _ = display.light_field_shape
    views, more = renders(scene, display)
    size = f"{view_columns} × {view_rows} views of {columns} × {rows} pixels"
    if settings.renderer == "LUMISTACK":
        paths = "an automatic number of paths" if settings_of.is_automatic(settings) else f"{settings_of.quality(settings)[2]} paths per pixel each"
        found = [f"{size}, {paths}"]
    else:
        engine = ENGINES.get(scene.render.engine, scene.render.engine.replace("_", " ").capitalize())
        samples = samples_of(scene)
        each = f"{engine}, {samples} sample{'s' if samples != 1 else ''} per pixel" if samples else engine
        score = f" and {more} for the score" if more else ""
        found = [size, f"{views}{score} = {views + more} renders by {each}" if more else f"{views} render{'s' if views != 1 else ''} by {each}"]
    if frames(scene) > 1:
        found.append(f"for each of {frames(scene)} frames")
    mib = math.prod(display.light_field_shape) * 4 / 2**20
    if mib > LARGE_MIB:
        found.append(f"{mib / 1024:.1f} GiB of views in memory")
    time_s = seconds(scene, display)
    found.append("Time: unknown until Estimate Time or a first run has measured it" if time_s is None else f"Time: about {duration(time_s)}")
    return found


def duration(time_s: float) -> str:
    if time_s < 90:
        return f"{max(round(time_s), 1)} s"
    if time_s < 90 * 60:
        return f"{round(time_s / 60)} min"
    return f"{time_s / 3600:.1f} h"

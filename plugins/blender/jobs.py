# SPDX-License-Identifier: GPL-3.0-or-later
"""The work of the button, as a generator of steps.

A step is a view that Blender's main thread renders, a wait for work on another thread, or a pause
in which Blender handles events. `operators` does the steps one by one from a timer, so that the
window responds. `command` and a render farm do all steps in one call. Every finished view and every
finished time step is stored in files. A second run skips the views and time steps whose stored
files are still valid.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import lumistack
import numpy
from lumistack.blender import cameras, depth, handover, rig, unshown, usd
from lumistack.blender.views import Views, key_of
from lumistack.blender.work import Work

from . import digest, pictures, settings as settings_of

#: Iterations of every time step after the first. Few suffice, since each time step starts with the
#: previous patterns.
NEXT_ITERATIONS = 5
#: Names of each renderer's views, for messages.
NAMES = {"BLENDER": "Blender's views", "GLTF": "Lumistack's views of the glTF file", "USD": "Lumistack's views of the USD file"}
#: Fraction of clipped values above which a warning is given.
CLIPPED = 0.01


class JobError(Exception):
    """An error of a job; its text is one sentence for the user."""


@dataclass
class Render:
    """A step that renders a view: call `aim`, render the scene with write_still, call `finished`."""

    scene: object
    aim: Callable[[], None]
    finished: Callable[[], None]
    title: str
    share: float


@dataclass
class Wait:
    """A step that waits for work on another thread."""

    work: Work
    title: str
    #: The finished fraction of the job before this work.
    share: float
    #: The work's fraction of the job.
    part: float


@dataclass
class Tick:
    """A step without work, in which Blender can handle events."""

    title: str
    share: float


Step = Render | Wait | Tick


@dataclass
class Shown:
    """The result of a job, for the simulated view."""

    stack: lumistack.LayerStack
    window: cameras.Window
    folder: Path
    psnr: float


@dataclass
class Job:
    """The work of one press of the button; `steps()` generates its steps."""

    scene: object
    factorize: bool = True
    warnings: list[str] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    rendered: int = 0
    kept: int = 0

    def warn(self, place: str, message: str) -> None:
        line = f"{place}: {message}"
        if line not in self.warnings:
            self.warnings.append(line)

    def steps(self) -> Iterator[Step]:
        busy.add(self.scene.name)
        try:
            yield from self._steps()
        finally:
            busy.discard(self.scene.name)

    def _steps(self) -> Iterator[Step]:
        scene, settings = self.scene, self.scene.lumistack
        folder = output_folder(scene)
        rig.remove_leftovers(bpy)
        if settings.times == "CURRENT":
            yield from self._time(folder, None, 0.0, 1.0)
            return
        frames = list(range(scene.frame_start, scene.frame_end + 1, max(scene.frame_step, 1)))
        current, before = scene.frame_current, None
        try:
            for number, frame in enumerate(frames):
                scene.frame_set(frame)
                start = number / len(frames)
                before = yield from self._time(folder / f"t{number + 1:04}", before, start, 1.0 / len(frames))
        finally:
            scene.frame_set(current)

    def _time(self, folder: Path, before: lumistack.LayerStack | None, start: float, part: float):
        """Makes views, light field, patterns and outputs of one time step."""
        # Render the views by every renderer; the views of the first renderer are the target.
        scene, settings = self.scene, self.scene.lumistack
        display = display_of(settings)
        window = window_of(scene, display)
        self._check_depth(display, window)
        folder.mkdir(parents=True, exist_ok=True)
        renderers = renderers_of(settings)
        fields = []
        rendering = 0.6 * part
        for number, renderer in enumerate(renderers):
            share = rendering / len(renderers)
            render = self._views if renderer == "BLENDER" else self._trace
            fields.append((yield from render(renderer, display, window, folder, start + number * share, share)))
        light_field = fields[0]
        for renderer, field in list(zip(renderers, fields))[1:]:
            self.said.append(compared(NAMES[renderer], field, NAMES[renderers[0]], light_field))
        if not self.factorize:
            light_field.save(folder / "target")
            return None
        # Keep the patterns of an earlier run if they have the same key.
        iterations = settings_of.quality(settings)[1]
        key = key_of({"target": hash_of(light_field.radiance), "display": display.to_toml(), "iterations": iterations, "first": before is None})
        stamp = folder / "blender.json"
        kept = kept_patterns(folder, stamp, key)
        output, parameters = settings.output, {} if settings.output == "NONE" else settings_of.output_parameters(scene, settings.output)

        def solve(report):
            stack = kept
            if stack is None:
                stamp.unlink(missing_ok=True)
                light_field.save(folder / "target")
                more = {} if before is None else {"warm_start": before, "solver": "block-exact"}
                updates = iterations if before is None else min(NEXT_ITERATIONS, iterations)
                stack = lumistack.factorize(light_field, display, iterations=updates, callback=report, **more)
                stack.save(folder)
                lumistack.report(stack, light_field, folder, title=scene.name, callback=report)
                write_stamp(stamp, key)
            if output != "NONE":
                lumistack.write(stack, output, folder / "outputs" / "tensor-display" / output, target=light_field, callback=report, **parameters)
            return stack, stack.psnr(light_field)

        # Solve on another thread, and keep the result for the 3D view.
        work = Work(solve).start()
        yield Wait(work, "Patterns", start + rendering, part - rendering)
        stack, psnr = result_of(work)
        self.said.append(f"{folder.name}: PSNR {psnr:.1f} dB, {folder}")
        shown[scene.name] = Shown(stack, window, folder, psnr)
        return stack

    def _check_depth(self, display: lumistack.Display, window: cameras.Window) -> None:
        sentence = depth_sentence(self.scene, display, window)
        if sentence:
            self.warn("depth", f"{sentence}. Fit Depth moves the scene into the sharp range, if there is one")

    def _views(self, _renderer, display, window, folder: Path, start: float, part: float):
        """Renders views by Blender's engine."""
        scene, settings = self.scene, self.scene.lumistack
        slope_x, slope_y = display.slopes
        _, _, rows, columns, _ = display.light_field_shape
        scale = settings.depth_scale
        yield Tick("Looking at the scene", start)
        # The key contains all data that the views depend on.
        key = key_of(
            {
                "digest": digest.digest(scene),
                "frame": scene.frame_current,
                "window": [window.centre, window.right, window.up, window.scale, window.size_mm],
                "slopes": [[scale * slope for slope in slope_x], [scale * slope for slope in slope_y]],
                "distance": display.distance_mm,
                "size": [columns, rows],
            }
        )
        views = Views(folder, len(slope_y), len(slope_x), key)
        missing = views.missing()
        total = len(slope_x) * len(slope_y)
        self.kept += total - len(missing)
        # Render only the missing views.
        depths = rig.depth_range(bpy, scene, window)
        if missing:
            try:
                rig.check_engine(bpy, scene)
            except rig.NoOpenGL as error:
                raise JobError(str(error)) from error
            with rig.Rig(bpy, scene, (columns, rows)) as held:
                for view in missing:
                    slope = (scale * slope_x[view[1]], scale * slope_y[view[0]])
                    camera = cameras.view_camera(window, slope, display.distance_mm, depths)

                    def aim(view=view, camera=camera):
                        held.aim(camera, views.begin(view))

                    done = total - len(views.missing())
                    yield Render(scene, aim, lambda view=view: views.keep(view), f"View {done + 1} of {total}", start + 0.9 * part * done / total)
                    self.rendered += 1
        # Read all views.
        radiance = numpy.empty(display.light_field_shape, numpy.float32)
        for number, view in enumerate(views.all()):
            yield Tick("Reading views", start + part * (0.9 + 0.1 * number / total))
            radiance[view] = self._look(views.path(view))
        return lumistack.LightField(radiance, display=display)

    def _look(self, path: Path) -> numpy.ndarray:
        settings = self.scene.lumistack
        if settings.look == "SCENE":
            return pictures.as_shown(path, self.scene)
        picture = pictures.load(path) * 2.0**settings.exposure_ev
        if (picture > 1.0).mean() > CLIPPED:
            self.warn("look", "more than 1 % of the light is brighter than white and clipped: lower the exposure, or use the scene's look")
        return numpy.clip(picture, 0.0, 1.0)

    def _trace(self, renderer: str, display, window, folder: Path, start: float, part: float):
        """Exports the scene and renders views of it by Lumistack's path tracer."""
        scene, settings = self.scene, self.scene.lumistack
        yield Tick("Exporting the scene", start)
        if renderer == "USD":
            path = folder / "scene.usdc"
            with handover.in_window(bpy, scene):
                usd.export_scene(bpy, path)
            # This call makes Blender's own OpenUSD importable. If Blender has none, another Python
            # reads the file.
            usd.is_readable(bpy)
        else:
            path = folder / "scene.glb"
            handover.export_scene(bpy, path, self.warn, scene)
        for line in unshown.unshown(bpy, scene):
            # USD files contain hair as curves, so hair is not lost.
            if not (renderer == "USD" and line.startswith("hair")):
                self.warn(scene.name, line)
        samples = settings_of.quality(settings)[2]
        linear = settings.look == "LINEAR" or settings.renderer == "BOTH"
        light = {"automatic": False, "automatic_exposure": not linear}
        tone = "linear" if linear else "auto"
        scale, exposure = settings.depth_scale, settings.exposure_ev

        def trace(report):
            loaded = lumistack.Scene(path, light={"automatic": False}, callback=report)
            return lumistack.render(
                # The panel's settings control the depth for both renderers, so the job must not fit
                # the depth.
                loaded, display, window=window.as_job(), fit_depth="off", depth_scale=scale, samples=samples, light=light,
                tone=tone, exposure_ev=exposure, cache=folder / "cache", callback=report,
            )  # fmt: skip

        work = Work(trace).start()
        yield Wait(work, "Path tracing", start, part)
        return result_of(work)


#: The results of this session's jobs, by the scene's name.
shown: dict[str, Shown] = {}
#: Names of the scenes with a running job. Their camera may be a temporary one.
busy: set[str] = set()
_running: list[Work] = []


def result_of(work: Work):
    """Returns the result of finished work, or raises its error on this thread."""
    if work.error is not None:
        raise work.error
    return work.result


def text_of(error: BaseException) -> str:
    """Returns the message of an error. An operator's error contains a whole traceback, whose last
    line is the message."""
    lines = [line for line in str(error).splitlines() if line.strip()]
    is_trace = any(line.startswith("Traceback") or "Python: Traceback" in line for line in lines)
    if not lines:
        return type(error).__name__
    return lines[-1] if is_trace else "\n".join(lines)


def display_of(settings) -> lumistack.Display:
    try:
        return settings_of.display_of(settings)
    except (lumistack.Error, ValueError, OSError) as error:
        raise JobError(str(error)) from error


def window_of(scene, display: lumistack.Display) -> cameras.Window:
    """Returns the window that the scene's settings define."""
    settings = scene.lumistack
    _, _, rows, columns, _ = display.light_field_shape
    size_mm = (columns * display.pitch_mm, rows * display.pitch_mm)
    distance = settings.distance if settings.window_from == "DISTANCE" else None
    try:
        window = rig.window_of(bpy, scene, size_mm, distance)
    except ValueError as error:
        raise JobError(str(error)) from error
    return window.resized(settings.window_size, settings.window_shift).moved_back(settings.moved_back_mm, display.distance_mm)


def depth_sentence(scene, display: lumistack.Display, window: cameras.Window) -> str | None:
    """Returns a warning if the scene is too deep for its display, else None."""
    return depth.sentence(depths_shown(scene, display, window), display.depth_of_field_mm())


def depths_shown(scene, display, window) -> list[float]:
    """Returns the depths at which the display shows the visible content, mm."""
    fit = depth.Fit(0.0, scene.lumistack.depth_scale)
    distance_mm = display.distance_mm
    return [depth.shown_at(z, fit, distance_mm) for z in rig.depths_through(bpy, scene, window, distance_mm)]


def fit_depth(scene, compress: bool) -> str:
    """Moves the window along its normal, and with `compress` also scales depth, so that the display
    shows the scene sharply. Returns a text about the changes."""
    settings = scene.lumistack
    display = display_of(settings)
    range_mm = display.depth_of_field_mm()
    if range_mm is None:
        raise JobError(f"{display.name}: the display cannot show its pixels sharply at any depth")
    settings.moved_back_mm, settings.depth_scale = 0.0, 1.0
    depths = rig.depths_through(bpy, scene, window_of(scene, display), display.distance_mm)
    if not depths:
        raise JobError("nothing is seen through the window")
    fit = depth.best_fit(depths, range_mm, display.distance_mm, compress)
    settings.moved_back_mm, settings.depth_scale = fit.moved_back_mm, fit.depth_scale
    return f"The window moved back by {fit.moved_back_mm:.0f} mm; depth is shown at {100 * fit.depth_scale:.0f} %"


def output_folder(scene) -> Path:
    """Returns the folder of a scene's results."""
    text = scene.lumistack.folder or "//lumistack"
    if text.startswith("//") and not bpy.data.filepath:
        return Path(bpy.app.tempdir) / text[2:]
    return Path(bpy.path.abspath(text))


def hash_of(array: numpy.ndarray) -> str:
    import hashlib

    return hashlib.sha256(numpy.ascontiguousarray(array).data).hexdigest()


def kept_patterns(folder: Path, stamp: Path, key: str) -> lumistack.LayerStack | None:
    """Returns the patterns of an earlier run if they have the key `key`, else None."""
    try:
        if json.loads(stamp.read_text(encoding="utf-8")).get("key") != key:
            return None
        return lumistack.LayerStack.open(folder)
    except (OSError, ValueError, lumistack.Error):
        return None


def write_stamp(stamp: Path, key: str) -> None:
    beside = stamp.with_suffix(".json.new")
    beside.write_text(json.dumps({"key": key}), encoding="utf-8")
    os.replace(beside, stamp)


def renderers_of(settings) -> list[str]:
    """Returns the renderers that the settings select. The views of the first one are the target."""
    found = ["BLENDER"] if settings.renderer in ("BLENDER", "BOTH") else []
    if settings.renderer in ("LUMISTACK", "BOTH"):
        found += ["GLTF", "USD"] if settings.handover == "BOTH" else [settings.handover]
    return found


def compared(our_name: str, ours, their_name: str, theirs) -> str:
    """Describes the difference of two light fields in one line: PSNR and mean values."""
    error = float(numpy.mean((ours.radiance.astype(numpy.float64) - theirs.radiance) ** 2))
    means = [float(each.radiance.mean()) for each in (ours, theirs)]
    psnr = float("inf") if error == 0.0 else -10.0 * numpy.log10(error)
    return f"{our_name} against {their_name}: {psnr:.1f} dB, mean {means[0]:.4f} against {means[1]:.4f}"


def track(work: Work) -> None:
    """Registers work that must end before Blender does."""
    _running.append(work)


def run_now(job: Job, say: Callable[[str, float], None] = lambda *_: None) -> None:
    """Does all steps of a job in this call, for scripts and render farms."""
    walk = job.steps()
    try:
        for step in walk:
            say(step.title, step.share)
            if isinstance(step, Render):
                step.aim()
                bpy.ops.render.render(write_still=True, scene=step.scene.name)
                step.finished()
            elif isinstance(step, Wait):
                track(step.work)
                while not step.work.wait(0.1):
                    stage, share = step.work.progress
                    say(f"{step.title}: {stage}", step.share + step.part * share)
    except BaseException:
        end_all()
        raise
    finally:
        walk.close()


def end_all() -> None:
    """Stops all running work, and waits up to ten seconds for its end."""
    for work in _running:
        work.stop()
    deadline = time.monotonic() + 10.0
    for work in _running:
        work.wait(max(deadline - time.monotonic(), 0.1))
    _running.clear()

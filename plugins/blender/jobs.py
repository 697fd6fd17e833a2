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
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import lumistack
import numpy
from lumistack.blender import between, cameras, depth, handover, rig, unshown, usd
from lumistack.blender.views import Views, key_of
from lumistack.blender.work import Work

from . import cost, digest, pictures, settings as settings_of

#: Largest number of iterations of a time step after the first. Few suffice, since each time step
#: starts with the previous patterns.
NEXT_ITERATIONS = 5
#: Names of each renderer's views, for messages.
NAMES = {"BLENDER": "Blender's views", "GLTF": "Lumistack's views of the glTF file", "USD": "Lumistack's views of the USD file"}
#: Fraction of clipped values above which a warning is given.
CLIPPED = 0.01
#: Stops above the white of a linear view transform at which our path tracer clips the light of a
#: view. Blender's view transforms show all brighter light as white.
BRIGHTEST_EV = 6.0
#: Stage of our path tracer's progress that reports views of an earlier run.
KEPT_STAGE = "kept views"
#: Paths per pixel of each of the two renders with which our path tracer's views are scored.
SCORE_SAMPLES = 12


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
class Patterns:
    """The patterns of a time step, and the key of everything from which they were made."""

    stack: lumistack.LayerStack
    key: str


@dataclass
class Shown:
    """The result of a job, for the simulated view."""

    stack: lumistack.LayerStack
    window: cameras.Window
    folder: Path
    #: The score in directions between the views.
    score: between.Score
    #: The direction halfway between views that is nearest to straight ahead: slopes (x, y).
    beside: tuple[float, float]


@dataclass
class Job:
    """The work of one press of the button; `steps()` generates its steps."""

    scene: object
    factorize: bool = True
    #: True if only a few or small views are rendered, to measure their time.
    probe: bool = False
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
        settings_of.use(scene)
        rig.remove_leftovers(bpy)
        if self.probe:
            yield from self._probe(folder)
            return
        if is_temporary(scene):
            self.warn(
                "folder",
                f"the .blend file is not saved, so the results are in {folder}, which Blender deletes when it ends. To keep the results, save the file or set Folder, and make the display again",
            )
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

    def _time(self, folder: Path, before: Patterns | None, start: float, part: float):
        """Makes views, light field, patterns and outputs of one time step, which starts from the patterns
        `before`. Returns the patterns; None if the job makes none."""
        # Render the views by every renderer; the views of the first renderer are the target.
        scene, settings = self.scene, self.scene.lumistack
        display = display_of(settings)
        window = window_of(scene, display)
        self._check_depth(display, window)
        folder.mkdir(parents=True, exist_ok=True)
        renderers = renderers_of(settings)
        fields, references = [], []
        rendering = 0.6 * part
        for number, renderer in enumerate(renderers):
            share = rendering / len(renderers)
            render = self._views if renderer == "BLENDER" else self._trace
            is_scored = number == 0 and self.factorize and settings.use_score
            light_field, more = yield from render(renderer, display, window, folder, start + number * share, share, is_scored)
            fields.append(light_field)
            references = references or more
        light_field = fields[0]
        for renderer, field in list(zip(renderers, fields))[1:]:
            self.said.append(compared(NAMES[renderer], field, NAMES[renderers[0]], light_field))
        if not self.factorize:
            light_field.save(folder / "target")
            return None
        # Keep the patterns of an earlier run if they have the same key.
        iterations = settings_of.quality(settings)[1]
        key = key_of(
            {
                "target": hash_of(light_field.radiance),
                "display": display.to_toml(),
                "iterations": iterations,
                "before": before and before.key,
                "version": lumistack.__version__,
            }
        )
        stamp = folder / "blender.json"
        kept = kept_patterns(folder, stamp, key)
        output, parameters = settings.output, {} if settings.output == "NONE" else settings_of.output_parameters(scene, settings.output)

        def solve(report):
            stack = kept
            if stack is None:
                stamp.unlink(missing_ok=True)
                light_field.save(folder / "target")
                more = {} if before is None else {"warm_start": before.stack, "solver": "block-exact"}
                updates = iterations if before is None else min(NEXT_ITERATIONS, iterations)
                begin = time.monotonic()
                stack = lumistack.factorize(light_field, display, iterations=updates, callback=report, **more)
                cost.record(scene.name, "PATTERNS", time.monotonic() - begin, cost.work_of_patterns(display, updates))
                stack.save(folder)
                lumistack.report(stack, light_field, folder, title=scene.name, callback=report)
                write_stamp(stamp, key)
            if output != "NONE":
                lumistack.write(stack, output, folder / "outputs" / "tensor-display" / output, target=light_field, callback=report, **parameters)
            scored = [stack.psnr_zone(each, callback=report) for each in references]
            return stack, between.score(scored) if scored else between.UNKNOWN

        # Solve on another thread, and keep the result for the 3D view.
        work = Work(solve).start()
        yield Wait(work, "Patterns", start + rendering, part - rendering)
        stack, score = result_of(work)
        slope_x, slope_y = display.slopes
        beside = between.beside_middle(slope_x), between.beside_middle(slope_y)
        self.said.append(f"{folder.name}: {score.text()}; {folder}")
        shown[scene.name] = Shown(stack, window, folder, score, beside)
        return Patterns(stack, key)

    def _probe(self, folder: Path):
        """Measures the time. Renders at most two views by Blender. Or renders all views and, with
        `use_score`, the pictures for the score by Lumistack's path tracer, with a quarter of the
        columns and rows."""
        settings = self.scene.lumistack
        display = display_of(settings)
        window = window_of(self.scene, display)
        folder.mkdir(parents=True, exist_ok=True)
        if renderers_of(settings)[0] == "BLENDER":
            yield from self._views("BLENDER", display, window, folder, 0.0, 1.0, False)
        else:
            small = lumistack.Display(display, resolution=[max(pixels // 4, 8) for pixels in display.to_dict()["field"]["resolution"]])
            yield from self._trace(renderers_of(settings)[0], small, window_of(self.scene, small), folder / "time", 0.0, 1.0, settings.use_score)
        self.said.append("; ".join(cost.lines(self.scene, display)))

    def _check_depth(self, display: lumistack.Display, window: cameras.Window) -> None:
        sentence = depth_sentence(self.scene, display, window)
        if sentence:
            self.warn("depth", f"{sentence}. The button Fit Depth brings more of the scene into the depths that the display shows sharply, if possible")

    def _views(self, _renderer, display, window, folder: Path, start: float, part: float, is_scored: bool):
        """Renders views by Blender's engine. Returns their light field, and with `is_scored` a list of
        one light field with further directions, which lie between the views."""
        yield Tick("Reading the scene", start)
        scene_digest = digest.digest(self.scene)
        slopes = display.slopes
        more = between_of(display, cost.SCORED[0]) if is_scored else ([], [])
        counts = [len(each[0]) * len(each[1]) for each in (slopes, more)]
        share = part / sum(counts)
        radiance = yield from self._rendered(scene_digest, display, window, slopes, folder, start, share * counts[0], "View")
        if radiance is None:
            return None, []
        references = []
        if counts[1]:
            pictures_between = yield from self._rendered(scene_digest, display, window, more, folder, start + share * counts[0], share * counts[1], "View for the score")
            references.append(light_field_of(pictures_between, display, more))
        return lumistack.LightField(radiance, display=display), references

    def _rendered(self, scene_digest: str, display, window, slopes, folder: Path, start: float, part: float, title: str):
        """Renders the views at the slopes (x, y). Returns their radiance, [view_y, view_x, row, column,
        rgb]; None for a probe."""
        scene, settings = self.scene, self.scene.lumistack
        slope_x, slope_y = slopes
        _, _, rows, columns, _ = display.light_field_shape
        scale = settings.depth_scale
        # The key contains all data that the views depend on.
        key = key_of(
            {
                "digest": scene_digest,
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
        if self.probe:
            # The first render of a scene also loads its data, so the second one is measured too.
            missing = missing[:2]
        # Render only the missing views.
        depths = rig.depth_range(bpy, scene, window)
        if missing:
            try:
                rig.check_engine(bpy, scene)
            except rig.NoOpenGL as error:
                raise JobError(str(error)) from error
            with rig.Rig(bpy, scene, (columns, rows)) as held:
                begin = second = time.monotonic()
                for number, view in enumerate(missing):
                    slope = (scale * slope_x[view[1]], scale * slope_y[view[0]])
                    camera = cameras.view_camera(window, slope, display.distance_mm, depths)

                    def aim(view=view, camera=camera):
                        held.aim(camera, views.begin(view))

                    done = total - len(missing) + number
                    left = f", about {cost.duration(each_s * (len(missing) - number))} left" if number else ""
                    yield Render(scene, aim, lambda view=view: views.keep(view), f"{title} {done + 1} of {total}{left}", start + 0.9 * part * done / total)
                    self.rendered += 1
                    # The first render also loads the scene's data, so its time counts only until a
                    # second render is finished.
                    now = time.monotonic()
                    each_s = (now - second) / number if number else now - begin
                    second = second if number else now
                    cost.record(scene.name, scene.render.engine, each_s, cost.work_of_render(scene, columns * rows))
        if self.probe:
            return None
        # Read all views.
        radiance = numpy.empty((len(slope_y), len(slope_x), rows, columns, 3), numpy.float32)
        for number, view in enumerate(views.all()):
            yield Tick("Reading views", start + part * (0.9 + 0.1 * number / total))
            radiance[view] = self._look(views.path(view))
        return radiance

    def _look(self, path: Path) -> numpy.ndarray:
        settings = self.scene.lumistack
        if settings.look == "SCENE":
            return pictures.as_shown(path, self.scene)
        picture = pictures.load(path) * 2.0**settings.exposure_ev
        if (picture > 1.0).mean() > CLIPPED:
            self.warn("look", "more than 1 % of the pixels' values are brighter than white and are clipped; lower the exposure, or set Look to As in Blender")
        return numpy.clip(picture, 0.0, 1.0)

    def _trace(self, renderer: str, display, window, folder: Path, start: float, part: float, is_scored: bool):
        """Exports the scene and renders views of it by Lumistack's path tracer. Returns their light
        field, and with `is_scored` three light fields with directions between the views: two renders
        with independent noise, and their mean."""
        scene, settings = self.scene, self.scene.lumistack
        yield Tick("Exporting the scene", start)
        folder.mkdir(parents=True, exist_ok=True)
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
        # With "As in Blender" our path tracer gives linear light, to which Blender then applies its
        # colour management. The light is darkened, so that only values above `brightest` are
        # clipped.
        is_shown = settings.look == "SCENE"
        brightest = 2.0 ** (BRIGHTEST_EV - scene.view_settings.exposure) if is_shown else 1.0
        common = {
            # The panel's settings control the depth for both renderers, so the job must not fit the
            # depth.
            "window": window.as_job(), "fit_depth": "off", "depth_scale": settings.depth_scale, "tone": "linear",
            "light": {"automatic": False, "automatic_exposure": False},
            "exposure_ev": -float(numpy.log2(brightest)) if is_shown else settings.exposure_ev,
        }  # fmt: skip
        paths = {"zone_samples": "auto"} if settings_of.is_automatic(settings) else {"samples": settings_of.quality(settings)[2]}
        more = between_of(display, cost.SCORED[1]) if is_scored else ([], [])
        heard: list[str] = []

        def trace(report):
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always", lumistack.LumistackWarning)
                loaded = lumistack.Scene(path, light={"automatic": False}, callback=report)

                def rendered(of, kind, work, name, **more):
                    # A measurement must not find kept views.
                    cache, begin, stages = None if self.probe else folder / name, time.monotonic(), set()

                    def watch(stage, share):
                        stages.add(stage)
                        report(stage, share)

                    made = lumistack.render(loaded, of, **common, **more, cache=cache, callback=watch)
                    if KEPT_STAGE not in stages:
                        cost.record(scene.name, kind, time.monotonic() - begin, work)
                    return made

                fields = [rendered(display, renderer, cost.work_of_trace(display, settings), "cache", **paths)]
                for seed in (1, 2) if is_scored and more[0] else ():
                    for_score, work = display_at(display, more), cost.work_of_score(display)
                    still = {"samples": SCORE_SAMPLES, "denoise": "off", "angular_filter": "point", "seed": seed}
                    fields.append(rendered(for_score, f"{renderer} score", work, f"cache-score-{seed}", **still))
            heard.extend(str(each.message) for each in caught if issubclass(each.category, lumistack.LumistackWarning))
            return fields

        work = Work(trace).start()
        yield Wait(work, "Path tracing", start, 0.8 * part if is_shown else part)
        fields = result_of(work)
        found = [each.radiance for each in fields]
        for line in heard:
            # Skip warnings about depth, which `_check_depth` reports in the words of the panel.
            if not line.startswith("depth:"):
                self.warn(scene.name, line)
        if is_shown:
            total, done = sum(each.shape[0] * each.shape[1] for each in found), 0
            for number, linear in enumerate(found):
                seen = numpy.empty_like(linear)
                for view in numpy.ndindex(linear.shape[:2]):
                    yield Tick("Applying exposure and tone curve", start + part * (0.8 + 0.2 * done / total))
                    seen[view] = pictures.as_shown(linear[view] * brightest, scene)
                    done += 1
                found[number] = seen
        references = [light_field_of(each, display, more) for each in found[1:]]
        if references:
            references.append(light_field_of((found[1] + found[2]) / 2.0, display, more))
        return lumistack.LightField(found[0], display=display) if is_shown else fields[0], references


#: The results of this session's jobs, by the scene's name.
shown: dict[str, Shown] = {}
#: The warnings of the last press of a button, by the scene's name.
warned: dict[str, list[str]] = {}
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


def between_of(display: lumistack.Display, most: tuple[int, float]) -> tuple[list[float], list[float]]:
    """Returns slopes (x, y) between the display's views; empty lists if the display has a single
    view. `most` is the largest number of slopes per axis, and the fraction of the viewing zone that
    they span."""
    slope_x, slope_y = display.slopes
    if len(slope_x) * len(slope_y) == 1:
        return [], []
    return between.directions(slope_x, *most), between.directions(slope_y, *most)


def display_at(display: lumistack.Display, slopes: tuple[list[float], list[float]]) -> lumistack.Display:
    """Returns a display whose views have the given slopes, which are symmetric and at equal
    distances. Only the geometry of its light field is used, not its layers."""
    described = display.to_dict()
    described["backlight"] = {"kind": "uniform"}
    field = described["field"]
    field["views"] = [len(each) for each in slopes]
    # The views are at the centres of equal parts of the zone.
    halves = [max(map(abs, each)) * len(each) / max(len(each) - 1, 1) for each in slopes]
    field["fov_deg"] = [2.0 * float(numpy.degrees(numpy.arctan(half))) for half in halves]
    return lumistack.Display(described)


def light_field_of(radiance: numpy.ndarray, display: lumistack.Display, slopes: tuple[list[float], list[float]]) -> lumistack.LightField:
    """Returns a light field of a display's window with views at the given slopes."""
    more = {} if display.distance_mm is None else {"distance_mm": display.distance_mm}
    return lumistack.LightField(radiance, pitch_mm=display.pitch_mm, slope_x=slopes[0], slope_y=slopes[1], **more)


def display_of(settings, is_live: bool = False) -> lumistack.Display:
    try:
        return settings_of.display_of(settings, is_live)
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
    shows more of the scene sharply. If no fit shows more, nothing changes. Returns a text about the
    changes."""
    settings = scene.lumistack
    settings_of.use(scene)
    display = display_of(settings)
    range_mm = display.depth_of_field_mm()
    if range_mm is None:
        raise JobError(f"{display.name}: expected a display that is sharp at some depth, found none")
    now = depth.Fit(settings.moved_back_mm, settings.depth_scale)
    settings.moved_back_mm, settings.depth_scale = 0.0, 1.0
    fit = None
    try:
        depths = rig.depths_through(bpy, scene, window_of(scene, display), display.distance_mm)
        fit = depths and depth.better_fit(depths, range_mm, display.distance_mm, compress, now)
    finally:
        found = fit or now
        settings.moved_back_mm, settings.depth_scale = found.moved_back_mm, found.depth_scale
    if not depths:
        nothing = "no object is visible through the window: aim the camera at an object, or move the window"
        raise JobError(nothing if rig.has_content(bpy) else "the scene has no visible objects: add an object, or switch one on for renders")
    share = depth.outside([depth.shown_at(z, found, display.distance_mm) for z in depths], range_mm)
    rest = "all visible surfaces are sharp" if share == 0.0 else f"{max(100 * share, 1):.0f} % of the visible surfaces stay blurred"
    if fit is None:
        why = "" if share == 0.0 else ", and no other position of the window or scale of depth makes more of them sharp"
        return f"Nothing changed: {rest}{why}"
    return f"{depth.moved(found)}; {rest}"


def is_temporary(scene) -> bool:
    """Returns true if the scene's results are in a folder that Blender deletes when it ends."""
    return (scene.lumistack.folder or "//").startswith("//") and not bpy.data.filepath


def output_folder(scene) -> Path:
    """Returns the folder of a scene's results."""
    text = scene.lumistack.folder or "//lumistack"
    if is_temporary(scene):
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
    return f"{our_name} against {their_name}: PSNR {psnr:.1f} dB, mean value {means[0]:.4f} against {means[1]:.4f}"


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

# SPDX-License-Identifier: GPL-3.0-or-later
"""A display that follows the scene while it is edited.

    handlers ──▶ session.changed_at
    timer    ──▶ scene-00012.glb ──▶ {"set": {"scene": ..., "window": ...}} ──▶ lumistack live

The session starts `lumistack live`, or attaches to one that runs.
Handlers only record that the scene has changed. A timer exports the scene, since an export in a
handler would call the handler again. Every export writes the whole scene. A rest after every export
limits exports to a third of Blender's time. After this rest, the next export waits until a state
shows the last export, but at most `PATIENCE_S`.
"""

from __future__ import annotations

import atexit
import hashlib
import sys
import time
from pathlib import Path

import bpy
import lumistack
from lumistack.blender import handover, unshown
from lumistack.blender.live import Attached, Files, Live, Program, State, toml_of

from . import jobs, operators, overlay, settings as settings_of

#: Interval of the timer, seconds.
TICK_S = 0.05
#: Longest wait for a state that shows the last export, seconds after the rest. If the scene cannot
#: be shown, this state never arrives.
PATIENCE_S = 2.0
#: Wait after an error, such as a missing camera, before the next attempt, seconds.
RETRY_S = 0.5
#: Time without an export after each export, in units of that export's duration.
REST = 2.0
#: Longest wait for the program to write its run folder when Blender ends, seconds.
END_S = 10.0
#: Our tone curve for each of Blender's view transforms. All other transforms get "agx".
TONES = {"Standard": "linear", "Raw": "linear", "Khronos PBR Neutral": "khronos-neutral"}
#: Settings whose change needs no new state of the display.
_OTHER = {"rna_type", "name", "folder", "output", "renderer", "handover", "times", "iterations", "show_window", "show_depth", "show_cone", "show_picture", "live_run", "live_show", "is_used", "use_score"}
#: Add the settings that are computed from other settings.
_OTHER |= {"window_width", "window_height"}


class Session:
    """A scene that is followed, and the program `lumistack live` that shows it."""

    def __init__(self, scene) -> None:
        """Exports the scene, and starts the program or attaches to one. Raises `jobs.JobError`,
        OSError and the errors of exporters."""
        settings_of.use(scene)
        # Undo replaces the scene's Python object, but this number stays the same.
        self._uid = scene.session_uid
        self.title = scene.name
        # A program to which the session attaches may have another working folder, so the path is
        # absolute.
        folder = jobs.output_folder(scene).absolute()
        self._scenes = Files(folder / "live-scene", "scene", ".glb")
        self._displays = Files(folder / "live-scene", "display", ".toml")
        self._digest = b""
        #: The key of the last call of `_settings`.
        self._key: object = None
        #: The result of the last call of `_settings`.
        self._tables: dict[str, object] = {}
        #: Text and path of the last display file.
        self._display = ("", "")
        #: A text about content that glTF cannot express, or the error of the last export.
        self._lost = ""
        #: `note` is a text for the panel: the last error of the settings or the export, or the
        #: content that glTF cannot express. `reason` is the reason why the session ended.
        self.note = self.reason = ""
        self.export_s = 0.0
        self.exports = 0
        #: Time of the oldest change that is not exported yet; None if there is none.
        self.changed_at: float | None = None
        self.is_exporting = False
        self._asked = False
        self._next = 0.0
        # Run folder of the program to which the session attaches; None if the session starts a
        # program.
        self.run = run_of(scene)
        self._sent = dict(self._settings(scene))
        job = {"scene": self._export(scene), **self._sent}
        self.program: Program
        if self.run is None:
            path = folder / "live-scene" / "job.toml"
            path.write_text(toml_of({"name": scene.name, **job}), encoding="utf-8")
            self.program = Live(words_of(scene, path, folder / "live"), operators.preview_environment())
        else:
            self.program = Attached(self.run)
            # Clear the pose and the importer of the program's own scene, which do not fit this
            # scene.
            self.program.change({"pose": None, "importer": None, **job}, time.monotonic())

    @property
    def state(self) -> State:
        return self.program.state

    def stop(self, reason: str = "") -> None:
        """Requests the end of the program, or of the connection to a program that the session did not
        start. The timer continues to call `step` until this end."""
        self._asked, self.reason = True, reason
        self.program.stop()

    @property
    def is_stopping(self) -> bool:
        return self._asked

    def step(self) -> bool:
        """Sends the changes since the last step. Returns false after the end of the program."""
        state = self.program.state
        if state.code is not None:
            return False
        if self._asked:
            return True
        scene = next((each for each in bpy.data.scenes if each.session_uid == self._uid), None)
        if scene is None:
            self.stop("the scene was deleted")
            return True
        now = time.monotonic()
        is_shown = self.program.is_shown or now > self._next + PATIENCE_S
        # A job replaces the scene's camera while it renders, so exports wait for its end.
        is_busy = scene.name in jobs.busy or bpy.app.is_job_running("RENDER")
        if now < self._next or not is_shown or is_busy:
            return True
        since = self.changed_at or now
        try:
            keys = {key: value for key, value in self._settings(scene).items() if self._sent[key] != value}
            if self.changed_at is not None:
                path = self._export(scene)
                if path is not None:
                    keys["scene"] = path
            self.note = self._lost
        except (jobs.JobError, lumistack.Error, RuntimeError, ValueError, OSError) as error:
            # After an error the page keeps showing the last state.
            self.note = jobs.text_of(error)
            self._next = time.monotonic() + RETRY_S
            return True
        if keys:
            self._sent.update(keys)
            self.program.change(keys, since)
        return True

    def _settings(self, scene) -> dict[str, object]:
        """Returns the tables of the job that follow from the scene's settings and its camera. A
        window whose place was found from objects does not move when the objects move."""
        settings, view = scene.lumistack, scene.view_settings
        values = [(prop.identifier, getattr(settings, prop.identifier)) for prop in settings.bl_rna.properties if prop.identifier not in _OTHER]
        values = [(name, tuple(value) if hasattr(value, "__len__") and not isinstance(value, str) else value) for name, value in values]
        key = (overlay.key_of_camera(scene), values, view.view_transform, view.exposure)
        if key == self._key:
            return self._tables
        display = jobs.display_of(settings, is_live=True)
        window = jobs.window_of(scene, display)
        is_linear = settings.look == "LINEAR"
        # Fix the exposure. An automatic exposure would darken all other objects if a lamp became
        # brighter.
        light = {
            "automatic": False,
            "automatic_exposure": False,
            "exposure_ev": settings.exposure_ev if is_linear else view.exposure,
            "tone": "linear" if is_linear else TONES.get(view.view_transform, "agx"),
        }
        self._tables = {
            "display": {"file": self._display_file(display.to_toml())},
            "window": {**window.as_job(), "fit_depth": "off", "depth_scale": settings.depth_scale},
            "light": light,
            "render": {"engine": "lumistack", "samples": settings_of.quality(settings)[2]},
        }
        self._key = key
        return self._tables

    def _display_file(self, text: str) -> str:
        if self._display[0] != text:
            path = self._displays.next()
            path.write_text(text, encoding="utf-8")
            self._display = (text, str(path))
        return self._display[1]

    def _export(self, scene) -> str | None:
        """Writes the scene to a new file and returns its path; None if it equals the last export."""
        self.changed_at = None
        path, begin = self._scenes.next(), time.monotonic()
        lost = unshown.unshown(bpy, scene)
        self.is_exporting = True
        try:
            handover.export_scene(bpy, path, lambda place, text: lost.append(f"{place}: {text}"), scene)
            # The export changed settings and restored them. Handle these changes now, while
            # `is_exporting` is set, so that they do not start the next export.
            bpy.context.view_layer.update()
        except BaseException as error:
            # The panel shows this error until an export succeeds.
            self._lost = jobs.text_of(error)
            self._scenes.back()
            raise
        finally:
            self.is_exporting = False
            self.export_s = time.monotonic() - begin
            self._next = time.monotonic() + REST * self.export_s
        self.exports += 1
        self._lost = "; ".join(lost)
        digest = hashlib.sha256(path.read_bytes()).digest()
        if digest == self._digest:
            self._scenes.back()
            return None
        self._digest = digest
        return str(path)


def run_of(scene) -> Path | None:
    """Returns the run folder of the program to which the scene's session attaches; None if the
    session starts a program."""
    text = scene.lumistack.live_run.strip()
    return Path(bpy.path.abspath(text)) if text else None


def words_of(scene, job: Path, run: Path) -> list[str]:
    """Returns the command line that starts the program."""
    words = [sys.executable, "-m", "lumistack", "--json", "live", str(job), "-o", str(run)]
    show = scene.lumistack.live_show
    return [*words, *([] if show == "PAGE" else ["--show", show.lower()]), *(["--no-open"] if bpy.app.background else [])]


#: The running session.
session: Session | None = None
#: A line for the panel about the end of the last session.
ended = ""


def start(scene) -> None:
    """Starts to follow a scene. Raises the errors of `Session`."""
    global session, ended
    end_now()
    ended = ""
    session = Session(scene)
    if not bpy.app.timers.is_registered(_tick):
        # A persistent timer also runs after the user has opened another file.
        bpy.app.timers.register(_tick, first_interval=TICK_S, persistent=True)


def stop(reason: str = "") -> None:
    """Requests the end of the session. The run folder stays."""
    if session is not None:
        session.stop(reason)


def end_now() -> None:
    """Ends the session, and waits for the end of its program or connection."""
    global session
    if session is not None:
        session.program.end(END_S)
        session = None


def step() -> bool:
    """Does one step of the session, and records the reason of its end. Returns false without a
    session."""
    global session, ended
    if session is None:
        return False
    if session.step():
        return True
    state = session.state
    reason = f" ({session.reason})" if session.reason else ""
    # If the session was attached, use its own path of the run folder. The program may name its
    # report relative to another working folder.
    place = f"The last state is in {session.run or Path(state.report).parent}"
    if session.is_stopping and session.run is not None:
        ended = f"Detached{reason}: the display in {session.run} keeps its last state"
    elif session.is_stopping:
        ended = f"Live has ended{reason}. {place}" if state.report else f"Live has ended{reason}"
    elif state.report:
        ended = f"Live was ended outside Blender. {place}"
    elif session.run is not None:
        ended = f"lumistack live in {session.run} stopped unexpectedly"
    else:
        ended = f"lumistack live stopped unexpectedly (status {state.code}): {state.problem or 'the program gave no reason'}"
    session = None
    return False


_drawn: object = None


def _tick() -> float | None:
    global _drawn
    goes_on = step()
    lines = status()
    if lines != _drawn:
        _drawn = lines
        for window in bpy.context.window_manager.windows:
            for area in window.screen.areas:
                if area.type == "PROPERTIES":
                    area.tag_redraw()
    return TICK_S if goes_on else None


def status() -> list[tuple[str, str]]:
    """Returns the lines for the panel, each as (icon, text)."""
    if session is None:
        return [("ERROR" if "unexpectedly" in ended else "INFO", ended)] if ended else []
    state = session.state
    if session.is_stopping:
        return [("SORTTIME", "Writes the display's last state")]
    if not state.states:
        lines = [("SORTTIME", f"{session.title}: waits for the first picture")]
    else:
        after = "" if state.latency_s is None else f", the last change was shown after {state.latency_s:.1f} s"
        where = "" if session.run is None else f" in {session.run}"
        lines = [("REC", f"{session.title} is live{where}{after}")]
    lines += [("ERROR", text) for text in (session.note, state.problem) if text]
    return lines


@bpy.app.handlers.persistent
def _changed(scene, depsgraph=None) -> None:
    """Handler for changes of data. A change that only concerns the selection is ignored."""
    if session is None or session.is_exporting:
        return
    updates = () if depsgraph is None else depsgraph.updates
    if any(update.is_updated_transform or update.is_updated_geometry or update.is_updated_shading for update in updates):
        session.changed_at = session.changed_at or time.monotonic()


@bpy.app.handlers.persistent
def _changed_all(*_) -> None:
    """Handler for a change of the frame, undo and redo."""
    if session is not None and not session.is_exporting:
        session.changed_at = session.changed_at or time.monotonic()


@bpy.app.handlers.persistent
def _opens(*_) -> None:
    stop("another file was opened")


_HANDLERS = {"depsgraph_update_post": _changed, "frame_change_post": _changed_all, "undo_post": _changed_all, "redo_post": _changed_all, "load_pre": _opens}


class LUMISTACK_OT_live(bpy.types.Operator):
    """Start or stop a display that follows changes of the scene, rendered by Lumistack's path tracer"""

    bl_idname = "lumistack.live"
    bl_label = "Live"

    @classmethod
    def poll(cls, context):
        return context.scene is not None

    def execute(self, context):
        if session is not None:
            stop()
            return {"FINISHED"}
        try:
            start(context.scene)
        except Exception as error:  # every error is reported to the user
            self.report({"ERROR"}, jobs.text_of(error))
            return {"CANCELLED"}
        return {"FINISHED"}


def register() -> None:
    bpy.utils.register_class(LUMISTACK_OT_live)
    for name, handler in _HANDLERS.items():
        getattr(bpy.app.handlers, name).append(handler)
    atexit.register(end_now)


def unregister() -> None:
    global ended
    end_now()
    ended = ""
    atexit.unregister(end_now)
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    for name, handler in _HANDLERS.items():
        getattr(bpy.app.handlers, name).remove(handler)
    bpy.utils.unregister_class(LUMISTACK_OT_live)

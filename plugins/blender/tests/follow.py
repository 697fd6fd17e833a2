# SPDX-License-Identifier: GPL-3.0-or-later
"""The case in which a page of `lumistack live` follows a scene that changes."""

import os
import signal
import time

from common import configure, disable, install

#: The display of `case_live`: 112 × 70 pixels.
LIVE_DISPLAY_SIZE = "[112, 70]"
#: Seconds without a new state after which the display is regarded as settled.
LIVE_REST = 1.0
#: Largest mean difference of two pictures of a settled display.
LIVE_NOISE = 0.003
#: Longest wait for a picture of a change, seconds. It is long, since the machine may also compile.
LIVE_PATIENCE = 60.0


class LivePage:
    """Reads the states that `lumistack live` sends to its page, as pictures from straight ahead."""

    def __init__(self, session, folder):
        self._address, self._folder = session.state.address, folder

    def picture(self):
        """Returns the picture of the newest state, [row, column, channel]."""
        import json
        import struct
        import urllib.request

        import bpy
        import lumistack
        import numpy

        with urllib.request.urlopen(f"{self._address}.live?after=0&edition=", timeout=30.0) as answer:
            data = answer.read()
        (length,) = struct.unpack_from("<I", data)
        head = json.loads(data[4 : 4 + length])
        preview, at = json.loads(head["preview"]), 4 + length
        masks = {}
        for entry, size in zip(preview["files"], head["files"], strict=True):
            path = self._folder / "mask.png"
            path.write_bytes(data[at : at + size])
            at += size
            image = bpy.data.images.load(str(path))
            image.colorspace_settings.name = "Non-Color"
            values = numpy.empty(image.size[0] * image.size[1] * image.channels, numpy.float32)
            image.pixels.foreach_get(values)
            masks[entry["layer"], entry["frame"]] = values.reshape(image.size[1], image.size[0], image.channels)[::-1, :, :3]
            bpy.data.images.remove(image)
        layers, frames = (1 + max(key[axis] for key in masks) for axis in (0, 1))
        stack = lumistack.LayerStack([numpy.stack([masks[layer, frame] for frame in range(frames)]) for layer in range(layers)], live_display(self._folder))
        return lumistack.simulate(stack)


def live_display(folder):
    import scenes

    path = folder / "live.toml"
    path.write_text(scenes.DISPLAY.replace("[96, 60]", LIVE_DISPLAY_SIZE), encoding="utf-8")
    return path


def case_live(folder, zip_path):
    """The page of `lumistack live` follows lamps, objects, materials, frames, the world and edit
    mode. Without changes nothing is exported. No way to end the display leaves a process."""
    import bpy
    import numpy
    import scenes

    install(zip_path)
    import lumistack
    from bl_ext.user_default.lumistack import live
    from lumistack.blender import handover

    scene = scenes.diffuse()
    scene.view_settings.view_transform = "Standard"
    # Few samples per view, since the case waits until all of them are rendered.
    out = configure(scene, folder, look="SCENE", samples=4)
    scene.lumistack.file = str(live_display(folder))
    objects, materials = bpy.data.objects, bpy.data.materials

    def until(name, is_right):
        """Does steps of the timer until `is_right()` returns true; returns the seconds that it took."""
        begin = time.monotonic()
        while time.monotonic() - begin < LIVE_PATIENCE:
            live.step()
            if is_right():
                return time.monotonic() - begin
            time.sleep(0.01)
        raise AssertionError(f"timeout: no {name}: {live.status()}")

    def begin():
        assert bpy.ops.lumistack.live() == {"FINISHED"}
        until("the page", lambda: live.session.state.address)
        return live.session

    def pid_is_there(pid):
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return False
        return True

    session = begin()
    # If the package cannot open windows, a new display has only the page.
    shown = [item.identifier for item in scene.lumistack.bl_rna.properties["live_show"].enum_items]
    assert shown == ["PAGE", *(["OUTPUTS", "SPAN", "WINDOW"] if lumistack.HAS_PANELS else [])], shown
    for choice in shown:
        scene.lumistack.live_show = choice
        words = live.words_of(scene, out / "job.toml", out / "live")
        assert words[-3:] == (["--show", choice.lower(), "--no-open"] if choice != "PAGE" else ["-o", str(out / "live"), "--no-open"]), words
    scene.lumistack.live_show = "PAGE"
    page = LivePage(session, folder)
    until("a picture without noise", lambda: session.state.psnr > 20.0 and settled(session))
    before = page.picture()
    time.sleep(1.0)
    at_rest = float(numpy.abs(page.picture() - before).mean())
    pictures = {"start": before}
    times = {}

    def follows(name, change, is_right=lambda old, new: True):
        """Makes a change, and waits until the picture differs from the previous one by more than
        noise and `is_right(old, new)` returns true."""
        old = pictures[list(pictures)[-1]]
        moved = float(numpy.abs(page.picture() - old).mean())
        assert moved < LIVE_NOISE, f"{name}: before the change the picture changed by {moved}"
        content = session.state.content
        change()
        bpy.context.view_layer.update()
        seconds = until(name, lambda: session.state.content > content)

        def is_shown():
            pictures[name] = page.picture()
            return numpy.abs(pictures[name] - old).mean() > 3.0 * LIVE_NOISE and is_right(old, pictures[name])

        until(f"the picture of {name}", is_shown)
        times[name] = (seconds, session.state.latency_s)
        until("the rest of the light", lambda: settled(session))
        pictures[name] = page.picture()

    def mean(picture, channel=slice(None)):
        return float(picture[..., channel].mean())

    follows("a lamp", lambda: setattr(objects["area"], "location", (-1.0, 0.2, 1.4)))
    follows("an object", lambda: setattr(objects["Cube"], "location", (-0.5, -1.2, 0.45)))
    clay = materials["clay"].node_tree.nodes["Principled BSDF"].inputs["Base Color"]
    follows("a material", lambda: setattr(clay, "default_value", (0.7, 0.05, 0.05, 1.0)), lambda old, new: mean(new, 1) < 0.95 * mean(old, 1))
    ball = objects["Sphere"]
    for frame, x in ((1, -0.7), (6, 0.9)):
        ball.location.x = x
        ball.keyframe_insert("location", frame=frame)
    bpy.context.view_layer.update()
    until("the keys", lambda: settled(session))
    pictures["keys"] = page.picture()
    for frame in (5, 2, 4, 1, 6):
        follows(f"frame {frame}", lambda frame=frame: scene.frame_set(frame))
    follows("the world", lambda: scenes.background(0.6), lambda old, new: mean(new) > 1.1 * mean(old))
    follows("a deleted object", lambda: objects.remove(objects["Torus"]))
    follows("the exposure", lambda: setattr(scene.view_settings, "exposure", -1.0), lambda old, new: mean(new) < 0.7 * mean(old))
    follows("the camera", lambda: setattr(scene.camera, "location", (-1.0, -4.0, 1.3)))
    # The mesh of an object in edit mode is exported, and the object stays in edit mode.
    cube = objects["Cube"]
    bpy.context.view_layer.objects.active = cube
    bpy.ops.object.mode_set(mode="EDIT")

    def edit():
        import bmesh

        mesh = bmesh.from_edit_mesh(cube.data)
        for vertex in mesh.verts:
            vertex.co *= 1.8
        bmesh.update_edit_mesh(cube.data)

    follows("edit mode", edit)
    assert cube.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")
    # Every export switches on the modifiers that only renders use. These switches, and selections,
    # must not cause exports.
    cube.modifiers.new("smooth", "SUBSURF").render_levels = 2
    bpy.context.view_layer.update()
    until("rest", lambda: settled(session))
    exports, states = session.exports, session.state.content
    for _ in range(20):
        bpy.ops.object.select_all(action="SELECT")
        bpy.ops.object.select_all(action="DESELECT")
        bpy.context.view_layer.update()
        live.step()
        time.sleep(0.05)
    assert (session.exports, session.state.content) == (exports, states), "a selection caused an export"
    # Export the current scene, to compare it with the last state below.
    handover.export_scene(bpy, folder / "now.glb", lambda *_: None, scene)
    # Without a camera the display keeps its last state, and the panel shows a message.
    camera, scene.camera = scene.camera, None
    until("a message about the camera", lambda: any("no camera" in text for _, text in live.status()))
    scene.camera = camera
    until("no message", lambda: not any("no camera" in text for _, text in live.status()))
    until("rest", lambda: settled(session))
    window = session._sent["window"]
    pid = session.program.pid
    assert bpy.ops.lumistack.live() == {"FINISHED"}
    until("the end", lambda: live.session is None)
    assert "Live has ended. The last state is in" in live.ended and str(out / "live") in live.ended, live.ended
    assert not pid_is_there(pid)
    target = lumistack.LightField.open(out / "live" / "target")
    light = {"automatic": False, "automatic_exposure": False, "exposure_ev": -1.0}
    there = lumistack.render(
        lumistack.Scene(folder / "now.glb", light={"automatic": False}), live_display(folder), window={key: window[key] for key in ("from", "centre", "forward", "up", "width")},
        fit_depth="off", samples=64, light=light, tone="linear",
    )  # fmt: skip
    error = float(numpy.mean((target.radiance.astype(numpy.float64) - there.radiance) ** 2))
    assert target.shape == there.shape and -10.0 * numpy.log10(error) > 22.0, error
    attaches(folder, scene, until)
    # The session ends if the program is killed, another file is opened, or the extension is
    # disabled.
    session = begin()
    os.kill(session.program.pid, signal.SIGKILL)
    until("the end", lambda: live.session is None)
    assert "stopped unexpectedly (status -9)" in live.ended and live.status()[0][0] == "ERROR", live.ended
    session = begin()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    until("the end", lambda: live.session is None)
    assert "Live has ended (another file was opened)" in live.ended, live.ended
    scenes.diffuse()
    scene = bpy.context.scene
    configure(scene, folder)
    scene.lumistack.file = str(folder / "none.toml")
    try:
        bpy.ops.lumistack.live()
    except RuntimeError as error:
        assert "none.toml" in str(error), error
    else:
        raise AssertionError("a missing display file gave no error")
    assert live.session is None
    scene.lumistack.file = str(live_display(folder))
    pid = begin().program.pid
    disable()
    assert not pid_is_there(pid)
    slowest = max(times, key=lambda name: times[name][0])
    print("note: seconds:", ", ".join(f"{name} {seconds:.2f}" for name, (seconds, _) in times.items()))
    return f"{len(times)} changes, each shown after {times[slowest][0]:.2f} s at most; an export takes {session.export_s:.2f} s; noise at rest {at_rest:.4f}"


def attaches(folder, scene, until):
    """The extension attaches to a `lumistack live` that already runs. After the end of the
    connection that program keeps its last state."""
    import subprocess
    import sys

    import bpy
    from bl_ext.user_default.lumistack import live, operators

    run, begin = folder / "other", time.monotonic()
    scene.lumistack.live_run = str(run)

    def fails(text):
        try:
            bpy.ops.lumistack.live()
        except RuntimeError as error:
            assert text in str(error), error
        else:
            raise AssertionError(f"no error: {text}")
        assert live.session is None

    fails("expected the run folder of a `lumistack live` that runs, found a folder without the file")
    words = [sys.executable, "-m", "lumistack", "live", "--no-open", str(folder / "now.glb"), "-o", str(run), "--display", scene.lumistack.file]
    other = subprocess.Popen(words, env=operators.preview_environment(), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    try:
        until("the file of the socket", (run / "cache" / "live.json").is_file)
        assert bpy.ops.lumistack.live() == {"FINISHED"}
        # An object, a material, a lamp and the frame change.
        until("the scene", lambda: live.session.program.is_shown and live.session.state.address)
        changes = (
            lambda: setattr(bpy.data.objects["Cube"], "location", (0.3, -1.0, 0.5)),
            lambda: setattr(bpy.data.materials["clay"].node_tree.nodes["Principled BSDF"].inputs["Base Color"], "default_value", (0.1, 0.6, 0.2, 1.0)),
            lambda: setattr(bpy.data.objects["area"], "location", (1.0, -0.3, 1.6)),
            lambda: scene.frame_set(3),
        )
        latencies = []
        for change in changes:
            content = live.session.state.content
            change()
            bpy.context.view_layer.update()
            until("a change", lambda content=content: live.session.state.content > content)
            latencies.append(live.session.state.latency_s)
        assert live.status()[0][1].startswith(f"{scene.name} is live in {run}"), live.status()
        print("note: attached, seconds:", ", ".join(f"{latency:.2f}" for latency in latencies), f"after {time.monotonic() - begin:.1f}")
        assert bpy.ops.lumistack.live() == {"FINISHED"}
        until("the end of the connection", lambda: live.session is None)
        assert live.ended == f"Detached: the display in {run} keeps its last state", live.ended
        assert other.poll() is None
        assert bpy.ops.lumistack.live() == {"FINISHED"}
        other.kill()
        until("the end of the program", lambda: live.session is None)
        assert live.ended == f"lumistack live in {run} stopped unexpectedly", live.ended
        fails("found the folder of a program that has ended")
    finally:
        other.kill()
        other.wait()
        scene.lumistack.live_run = ""


def settled(session):
    """Returns true if no change waits and no new state arrived for `LIVE_REST` seconds."""
    if session.changed_at is not None or not session.program.is_shown:
        return False
    now, states = time.monotonic(), session.state.states
    if getattr(session, "_seen", (None, 0.0))[0] != states:
        session._seen = (states, now)
    return now - session._seen[1] > LIVE_REST

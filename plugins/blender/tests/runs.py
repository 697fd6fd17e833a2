# SPDX-License-Identifier: GPL-3.0-or-later
"""Cases that run jobs: from the first installation to errors, interruptions and the command."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

from common import HERE, configure, disable, install, picture_of, run, settings_file
from pictures import grown, hit_masks, light_fields


def case_lifecycle(folder, zip_path):
    """The extension leaves no data in Blender when it is disabled, and when it is enabled and disabled
    again. Blender exits by itself."""
    import bpy

    def traces():
        found = [name for name in dir(bpy.types) if "lumistack" in name.lower()]
        found += [name for name in ("lumistack", "lumistack_outputs") if hasattr(bpy.types.Scene, name)]
        found += [name for name in dir(bpy.ops.lumistack)]
        for name in dir(bpy.app.handlers):
            held = getattr(bpy.app.handlers, name)
            if isinstance(held, list):
                found += [str(each) for each in held if "lumistack" in getattr(each, "__module__", "")]
        return found

    assert not traces(), traces()
    install(zip_path)
    there = traces()
    assert {"lumistack", "lumistack_outputs", "LUMISTACK_PT_main", "make", "fit_depth"} <= set(there), there
    import lumistack

    assert ".local" in lumistack.__file__, lumistack.__file__
    for _ in range(2):
        disable()
        assert not traces(), traces()
        bpy.ops.preferences.addon_enable(module="bl_ext.user_default.lumistack")
        assert sorted(traces()) == sorted(there)
    disable()
    assert not traces(), traces()
    return "ends by itself"


def case_make(folder, zip_path):
    """The button makes patterns, an output, a report and the simulated view. A second press renders
    nothing."""
    import bpy
    import numpy
    import scenes

    install(zip_path)
    import lumistack
    from bl_ext.user_default.lumistack import jobs, operators, overlay, pictures

    scene = scenes.diffuse()
    scene.cycles.samples = 4
    out = configure(scene, folder, grid="PERSPECTIVE", output="images", look="SCENE", iterations=8)
    scene.lumistack_outputs.images_png8 = False
    scene.lumistack_outputs.images_npz = True
    before = sorted(held.name for held in bpy.data.objects), scene.render.filepath, scene.render.image_settings.file_format, scene.camera
    job = run(scene)
    after = sorted(held.name for held in bpy.data.objects), scene.render.filepath, scene.render.image_settings.file_format, scene.camera
    assert before == after, "the job changed the scene"
    # Besides the 9 views, Blender renders 4 directions between them for the score.
    assert (job.rendered, job.kept) == (13, 0)
    for name in ("display.toml", "layers/stack.json", "report.html", "target/lightfield.json", "outputs/tensor-display/images/stack.npz"):
        assert (out / name).is_file(), name
    assert not list((out / "outputs/tensor-display/images").glob("*.png"))
    held = jobs.shown[scene.name]
    assert held.score.directions == 4 and 10.0 < held.score.worst < held.score.psnr_zone < 40.0, held.score
    assert held.score.text() in " ".join(job.said) and "PSNR" not in " ".join(job.said), job.said
    # The score is for directions that the solver did not use, so it is below the PSNR of the
    # solver's views.
    own = held.stack.psnr(lumistack.LightField.open(out / "target"))
    assert held.score.psnr_zone < own - 1.0, (held.score, own)
    # The button shows a picture from between the views, not the one from straight ahead.
    step = held.stack.display.slopes[0][2] - held.stack.display.slopes[0][1]
    assert abs(held.beside[0] - step / 2) < 1e-9 and held.beside[1] > 0.0, held.beside
    scene.lumistack.folder = str(folder / "button")
    assert bpy.ops.lumistack.make() == {"FINISHED"}
    image = bpy.data.images[pictures.SHOWN]
    pixels = numpy.empty(96 * 60 * 4, numpy.float32)
    image.pixels.foreach_get(pixels)
    shown = lumistack.simulate(jobs.shown[scene.name].stack, slope=held.beside)
    assert numpy.allclose(pixels.reshape(60, 96, 4)[::-1, :, :3], shown, atol=1e-6)
    scene.lumistack.folder = str(out)
    run(scene)
    held = jobs.shown[scene.name]
    assert bpy.ops.lumistack.look() == {"FINISHED"}
    image = bpy.data.images[pictures.SHOWN]
    assert tuple(image.size) == (96, 60) and image.is_float
    pixels = numpy.empty(96 * 60 * 4, numpy.float32)
    image.pixels.foreach_get(pixels)
    straight = lumistack.simulate(held.stack)
    assert numpy.allclose(pixels.reshape(60, 96, 4)[::-1, :, :3], straight, atol=1e-6)
    operators.show_view(scene, (0.15, 0.0))
    image.pixels.foreach_get(pixels)
    assert abs(pixels.reshape(60, 96, 4)[::-1, :, :3] - straight).max() > 0.05, "the view from the right equals the one from the middle"
    assert operators.finished_folder(scene) == out
    lines = overlay.lines_of(scene)
    assert [len(ends) for _, ends in lines] == [8, 24]
    # A second run keeps views and patterns.
    start = (out / "layers/stack.json").stat().st_mtime_ns
    job = run(scene)
    assert (job.rendered, job.kept) == (0, 13) and (out / "layers/stack.json").stat().st_mtime_ns == start
    # Write every output with its default parameters.
    from bl_ext.user_default.lumistack import settings

    count = 0
    for plugin in settings.plugins():
        scene.lumistack.output = plugin["id"]
        try:
            run(scene)
        except lumistack.PluginError as error:
            assert "expected a display" in str(error), error
            print(f"note: {plugin['id']} refuses this display: {error}")
            continue
        written = [each for each in (out / "outputs/tensor-display" / plugin["id"]).rglob("*") if each.is_file()]
        assert written, plugin["id"]
        print(f"note: {plugin['id']}: {len(written)} files")
        count += 1
    assert count >= 3
    scene.lumistack.output = "images"
    # A visible change makes the views invalid.
    bpy.data.materials["clay"].node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.1, 0.9, 0.1, 1.0)
    job = run(scene, factorize=False)
    assert job.rendered == 9
    return held.score.text()


def case_views(folder, zip_path):
    """The panel states the number of views and of renders before a run, and the number is right."""
    import bpy
    import scenes

    install(zip_path)
    import lumistack
    from bl_ext.user_default.lumistack import cost, jobs, settings as settings_of

    scene = scenes.diffuse()
    scene.cycles.samples = 7
    held = scene.lumistack
    # By default the button uses as many views as the command.
    held.preset, held.quality = "paper-three-layer", "PREVIEW"
    shape = lumistack.Display("paper-three-layer", resolution=(420, 262)).light_field_shape
    assert settings_of.display_of(held).light_field_shape == shape == (13, 13, 262, 420, 3)
    lines = cost.lines(scene, settings_of.display_of(held))
    assert lines == ["13 × 13 views of 420 × 262 pixels", "169 and 4 for the score = 173 renders by Cycles, 7 samples per pixel", "Time: unknown until Estimate Time or a first run has measured it"], lines
    held.views_from = "HALF"
    half = settings_of.display_of(held)
    assert half.light_field_shape[:2] == (7, 7) and all(
        abs(a - b) < 1e-9 for a, b in zip(half.slopes[0], lumistack.Display("paper-three-layer", resolution=(420, 262)).slopes[0][::2], strict=True)
    )
    held.use_score = False
    assert "49 renders by Cycles, 7 samples per pixel" in cost.lines(scene, half)
    held.views_from, held.views = "OWN", (3, 2)
    assert settings_of.display_of(held).light_field_shape[:2] == (2, 3)
    # A live display chooses its automatic views itself.
    held.views_from = "AUTO"
    assert settings_of.display_of(held, is_live=True).to_dict()["field"]["views"] == "auto"
    # Slopes of the directions for the score are halfway between views, for every kind of display.
    for name in lumistack.displays():
        display = lumistack.Display(name)
        for most in cost.SCORED:
            slopes = jobs.between_of(display, most)
            views = jobs.display_at(display, slopes).slopes
            for axis in range(2):
                assert all(abs(a - b) < 1e-9 for a, b in zip(sorted(slopes[axis]), sorted(views[axis]), strict=True)), (name, slopes, views)
                apart = [min(abs(slope - view) for view in display.slopes[axis]) for slope in slopes[axis]]
                step = abs(display.slopes[axis][1] - display.slopes[axis][0])
                assert all(abs(each - step / 2) < 1e-9 for each in apart), (name, apart, step)
    # A measurement gives the time; the views that it renders are kept.
    out = configure(scene, folder, use_score=False)
    held.views_from = "AUTO"
    assert bpy.ops.lumistack.estimate() == {"FINISHED"}
    views = next(out.glob("views-*"))
    assert len(list(views.iterdir())) == 2
    assert "Time: about" in cost.lines(scene, settings_of.display_of(held))[-1]
    before = cost.seconds(scene, settings_of.display_of(held))
    scene.cycles.samples = 70
    assert abs(cost.seconds(scene, settings_of.display_of(held)) / before - 10.0) < 1e-6
    scene.cycles.samples = 7
    job = run(scene, factorize=False)
    assert (job.rendered, job.kept) == (7, 2)
    # Our path tracer is measured by small views.
    held.renderer = "LUMISTACK"
    assert cost.lines(scene, settings_of.display_of(held))[-1] == "Time: unknown until Estimate Time or a first run has measured it"
    assert bpy.ops.lumistack.estimate() == {"FINISHED"}
    assert "Time: about" in cost.lines(scene, settings_of.display_of(held))[-1]
    # With automatic views our path tracer chooses the number of paths, as for the command.
    assert not settings_of.is_automatic(held)
    held.quality, held.use_score = "DRAFT", True
    assert settings_of.is_automatic(held)
    run(scene)
    # Kept views take no time, so they are no measurement.
    before = cost.seconds(scene, settings_of.display_of(held))
    run(scene, factorize=False)
    assert cost.seconds(scene, settings_of.display_of(held)) == before
    assert jobs.shown[scene.name].score.directions == 4, jobs.shown[scene.name].score
    return jobs.shown[scene.name].score.text()


def case_animation(folder, zip_path):
    """A range of frames gives one folder per time step. A second run renders only missing views. The
    patterns of a frame are computed again if those of the frame before it have changed."""
    import bpy
    import scenes

    install(zip_path)
    scene = scenes.silhouettes()
    scene.cycles.samples = 1
    held = bpy.data.objects["Cube"]
    held.keyframe_insert("location", frame=1)
    held.location.x += 0.4
    held.keyframe_insert("location", frame=3)
    scene.frame_start, scene.frame_end = 1, 3
    scene.frame_set(2)
    out = configure(scene, folder, times="RANGE", views_from="OWN", views=(2, 1), use_score=False)
    job = run(scene)
    assert job.rendered == 6 and scene.frame_current == 2
    assert sorted(each.name for each in out.iterdir()) == ["t0001", "t0002", "t0003"]
    shutil.rmtree(next((out / "t0003").glob("views-*")))
    job = run(scene)
    assert (job.rendered, job.kept) == (2, 4)

    def times():
        return [(each / "layers/stack.json").stat().st_mtime_ns for each in sorted(out.iterdir())]

    # Only the first frame changes, but the patterns of all later frames begin with its patterns.
    before = times()
    for frame, hidden in ((1, True), (2, False)):
        held.hide_render = hidden
        held.keyframe_insert("hide_render", frame=frame)
    job = run(scene)
    assert (job.rendered, job.kept) == (2, 4)
    after = times()
    assert all(new > old for new, old in zip(after, before, strict=True)), (before, after)
    run(scene)
    assert times() == after
    return ""


def case_faults(folder, zip_path):
    """Missing or wrong parts of a scene give errors that name them. An orthographic camera works, and
    Fit Depth mends depth that does not fit."""
    import bpy
    import scenes

    install(zip_path)
    from bl_ext.user_default.lumistack import jobs
    from mathutils import Matrix

    def fails(part, scene):
        try:
            run(scene, factorize=False)
        except jobs.JobError as error:
            assert part in str(error), error
            print("note:", error)
        else:
            raise AssertionError(f"no error with {part}")

    scene = scenes.silhouettes()
    configure(scene, folder)
    scene.camera = None
    fails("the scene has no camera", scene)
    assert bpy.ops.lumistack.check_depth.poll()
    held = scenes.camera("pano")
    held.data.type = "PANO"
    fails("pano: expected a perspective or an orthographic camera, found pano", scene)
    scene.camera = bpy.data.objects["Cube"]
    fails("Cube: expected a camera, found an object of type mesh", scene)
    away = scenes.camera("away")
    away.data.dof.use_dof = False
    away.rotation_euler = (3.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    fails("away: the camera sees no object", scene)
    scene.lumistack.file = str(folder / "no such.toml")
    scene.camera = bpy.data.objects["camera"]
    fails("no such.toml", scene)
    scene.lumistack.file = ""
    fails("File: expected a display file (.toml), found no path; select a display file, or set Display to Preset", scene)
    # In a scene without objects the camera is not at fault.
    scene = scenes.empty()
    configure(scene, folder)
    scenes.camera().data.dof.use_dof = False
    fails("the scene has no visible objects", scene)
    scenes.add("cube", scenes.material("gone"), size=0.5, location=(-0.35, 0.7, 0.25)).hide_render = True
    bpy.context.view_layer.update()
    scene.camera.data.dof.use_dof = True
    # Blender deletes the results of a file that is not saved.
    assert not bpy.data.filepath and not jobs.is_temporary(scene)
    scene.lumistack.folder = "//results"
    assert jobs.is_temporary(scene)
    warned = [line for line in run(scene, factorize=False).warnings if line.startswith("folder")]
    assert len(warned) == 1 and str(jobs.output_folder(scene)) in warned[0] and "deletes" in warned[0], warned
    # Cycles and Lumistack agree for an orthographic camera.
    scene = scenes.empty()
    scenes.shapes(scenes.material("white", (1.0, 1.0, 1.0), glow=1.0))
    scenes.camera(orthographic=True)
    configure(scene, folder, views_from="OWN", views=(1, 1))
    scene.cycles.samples = 1
    ours, theirs = light_fields(scene, folder, "OBLIQUE")
    assert not (hit_masks(ours) & ~grown(hit_masks(theirs))).any() and 0.1 < hit_masks(ours).mean() < 0.4
    # Depth that does not fit gives a warning; after Fit Depth there is no warning.
    scene.lumistack.moved_back_mm = -200.0
    warned = [line for line in run(scene, factorize=False).warnings if line.startswith("depth")]
    assert warned, "no warning, although the scene lies behind the depth of field"
    print("note:", warned[0])
    assert bpy.ops.lumistack.fit_depth() == {"FINISHED"}
    assert not run(scene, factorize=False).warnings
    # A far backdrop stays blurred; the scene in front of it is fitted as without the backdrop.
    before = scene.lumistack.moved_back_mm, scene.lumistack.depth_scale
    wall = scenes.add("plane", bpy.data.materials["white"], size=4000.0)
    wall.matrix_world = scene.camera.matrix_world @ Matrix.Translation((0.0, 0.0, -900.0))
    bpy.context.view_layer.update()
    scene.lumistack.moved_back_mm, scene.lumistack.depth_scale = 300.0, 1.0
    text = jobs.fit_depth(scene, True)
    print("note:", text)
    assert text.startswith("The window moved ") and "stay blurred" in text
    fitted = scene.lumistack.moved_back_mm, scene.lumistack.depth_scale
    assert fitted[1] > 0.5 * before[1] and abs(fitted[0] - before[0]) < 100.0, (fitted, before)
    # If no fit is better, nothing changes.
    again = jobs.fit_depth(scene, True)
    print("note:", again)
    assert again.startswith("Nothing changed: ") and (scene.lumistack.moved_back_mm, scene.lumistack.depth_scale) == fitted
    return f"fitted: back by {scene.lumistack.moved_back_mm:.1f} mm, depth {scene.lumistack.depth_scale:.2f}"


def case_handover(folder, zip_path):
    """The command reads .blend files with linked libraries, existing and missing pictures, names with
    non-ASCII letters, instances and modifiers."""
    import bpy
    import numpy
    import scenes

    install(zip_path)
    place = folder / "Szenen ü é 日本"
    place.mkdir()
    scenes.empty()
    made = scenes.add("cube", scenes.material("rot", (0.9, 0.1, 0.1)), size=0.7)
    made.name = "Würfel"
    made.modifiers.new("Fläche", "SUBSURF").render_levels = 2
    made.modifiers["Fläche"].levels = 0
    bpy.ops.wm.save_as_mainfile(filepath=str(place / "bücherei.blend"))
    scene = scenes.diffuse()
    with bpy.data.libraries.load(str(place / "bücherei.blend"), link=True) as (there, here):
        here.objects = [name for name in there.objects if name == "Würfel"]
    scene.collection.objects.link(here.objects[0])
    look = bpy.data.materials["clay"]
    picture = bpy.data.images.new("muster", 8, 8)
    picture.filepath_raw, picture.file_format = str(place / "muster é.png"), "PNG"
    picture.save()
    texture = look.node_tree.nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.load(str(place / "muster é.png"))
    look.node_tree.links.new(texture.outputs["Color"], look.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
    for number in range(2):
        held = bpy.data.objects.new("group", None)
        held.instance_type = "COLLECTION"
        scene.collection.objects.link(held)
        held.location = (number, 2.0, 0.0)
        if number == 0:
            group = bpy.data.collections.new("stones")
            group.objects.link(bpy.data.objects["Cube"])
        held.instance_collection = group
    path = place / "szene 東京.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.file.make_paths_relative()
    bpy.ops.wm.save_mainfile()

    import lumistack as package

    home = str(Path(package.__file__).parent.parent)
    # A script in place of Blender writes a line at each start, so that starts can be counted.
    starts, counting = folder / "starts", folder / "python-that-counts"
    starts.touch()
    counting.write_text(f'#!/bin/sh\necho >> "{starts}"\nexec "{sys.executable}" "$@"\n', encoding="utf-8")
    counting.chmod(0o755)

    def started():
        count = len(starts.read_text().splitlines())
        starts.write_text("")
        return count

    def lumistack(*words, code=0):
        program = os.environ.get("LUMISTACK_PROGRAM")
        done = subprocess.run(
            [*([program] if program else [sys.executable, "-m", "lumistack"]), *map(str, words)], capture_output=True, text=True, env={**os.environ, "LUMISTACK_BLENDER": str(counting), "PYTHONPATH": home}
        )
        assert done.returncode == code, (words, done.stdout, done.stderr)
        return done.stdout + done.stderr

    said = lumistack("info", path)
    assert started() == 1
    print("note:", " | ".join(said.split("\n"))[:600])
    assert "is missing" not in said, said
    assert "camera" in said and "rot" in said and "environment: yes" in said and "engine: CYCLES" in said, said
    # `shapes` is the number of triangles of the sphere, the cube, the cone and the torus. The
    # linked cube adds 6 · 16 quads: 2 levels of subdivision, since the viewport's level, 0, has no
    # effect.
    shapes = 48 * 22 * 2 + 96 + 12 + 78 + 48 * 12 * 2
    print("note:", [line for line in said.split("\n") if "triangles" in line], shapes)
    said = lumistack("render", path, "--display", settings_file(folder), "--resolution", "48x30", "--samples", "16", "-o", folder / "aus")
    assert (folder / "aus" / "lightfield.json").is_file() and started() == 1
    # Without a change Blender is not started again, even if a library has a new time stamp.
    lumistack("render", path, "--display", settings_file(folder), "--resolution", "48x30", "--samples", "16", "-o", folder / "aus")
    assert started() == 0
    os.utime(place / "bücherei.blend")
    lumistack("render", path, "--display", settings_file(folder), "--resolution", "48x30", "--samples", "16", "-o", folder / "aus")
    assert started() == 0, "a new time stamp alone started Blender"
    lumistack("render", path, "--display", settings_file(folder), "--resolution", "48x30", "--samples", "16", "--time", "1", "-o", folder / "aus")
    assert started() == 1
    # Cycles renders the same view through the same window.
    common = ["--display", settings_file(folder), "--resolution", "48x30"]
    said = lumistack("render", path, *common, "--engine", "blender", "-o", folder / "cycles")
    pictures = [picture_of(folder / name / "view_00_00.exr") for name in ("aus", "cycles")]
    apart = abs(pictures[0].mean() / pictures[1].mean() - 1.0)
    alike = float(numpy.corrcoef(pictures[0].ravel(), pictures[1].ravel())[0, 1])
    print(f"note: our path tracer and Cycles on the command line: means differ by {100 * apart:.1f} %, correlation {alike:.3f}")
    # The two renders differ by noise and by their automatic exposure. A wrong window or a mirrored
    # picture would differ more.
    assert apart < 0.12 and alike > 0.85
    # A missing picture and a missing library are reported.
    (place / "muster é.png").unlink()
    (place / "bücherei.blend").unlink()
    said = lumistack("info", path)
    assert "muster é.png is missing" in said and "bücherei.blend is missing" in said, said
    # A file that is no .blend file, and invalid settings, are errors.
    (place / "kaputt.blend").write_bytes(b"not a blend file, though it says so")
    said = lumistack("info", place / "kaputt.blend", code=1)
    assert "kaputt.blend" in said and "Traceback" not in said, said
    print("note:", said.strip())
    said = lumistack("render", path, "--variant", "a=b", "-o", folder / "aus2", code=1)
    assert "pose.variant" in said, said
    return ""


def gltf_of(path):
    """Returns the JSON of a .glb file."""
    import json
    import struct

    held = Path(path).read_bytes()
    (length,) = struct.unpack_from("<I", held, 12)
    return json.loads(held[20 : 20 + length])


def case_beyond(folder, zip_path):
    """Content that glTF cannot express is reported. Then the file's own engine renders the scene,
    unless the job selects another one."""
    import bpy
    import numpy
    import scenes

    install(zip_path)
    scene = scenes.beyond()
    scene.cycles.samples = 8
    path = folder / "wald.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))

    import lumistack as package

    environment = {**os.environ, "LUMISTACK_BLENDER": sys.executable, "PYTHONPATH": str(Path(package.__file__).parent.parent)}

    def lumistack(*words):
        program = os.environ.get("LUMISTACK_PROGRAM")
        words = [*([program] if program else [sys.executable, "-m", "lumistack"]), *map(str, words)]
        done = subprocess.run(words, capture_output=True, text=True, env=environment)
        assert done.returncode == 0, (words, done.stdout, done.stderr)
        return done.stdout + done.stderr

    named = ["bark (Color Ramp, Noise Texture)", "chalk (Diffuse BSDF)", "hair that", "Sphere", "volumes that", "smoke"]
    said = lumistack("info", path)
    assert all(name in said for name in named), said
    assert "clay (" not in said and "floor (" not in said, said
    common = ["--display", settings_file(folder), "--resolution", "48x30", "--samples", "16"]
    fields = {}
    for engine in ("auto", "blender", "lumistack"):
        said = lumistack("render", path, *common, *(["--engine", engine] if engine != "auto" else []), "-o", folder / engine)
        print("note:", engine, " | ".join(line for line in said.split("\n") if "warning" in line))
        fields[engine] = picture_of(folder / engine / "view_01_01.exr")
        assert all(name in said for name in named) == (engine != "blender"), said
        assert ("own engine, CYCLES, renders" in said) == (engine == "auto"), said
    assert (fields["auto"] == fields["blender"]).all(), "the default did not use the file's own engine"
    assert numpy.abs(fields["auto"] - fields["lumistack"]).mean() > 0.01
    # glTF cannot express smoke, so the mesh of its domain must not be exported as a white box.
    nodes = {node.get("name") for node in gltf_of(next((folder / "lumistack").rglob("*.glb")))["nodes"]}
    assert "smoke" not in nodes and "Cube" in nodes, nodes
    return ""


def case_resume(folder, zip_path):
    """A run that was killed during view 5 of 9 continues with view 5."""
    import bpy
    import scenes

    scene = scenes.silhouettes()
    scene.cycles.samples = 1
    path = folder / "szene ü.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    words = [sys.executable, str(HERE / "cases.py"), "inside", "command", str(zip_path), str(folder / "inner")]
    (folder / "inner").mkdir()
    settings_file(folder / "inner")
    environment = {**os.environ, "CASE_BLEND": str(path), "BLENDER_USER_RESOURCES": str(folder / "inner" / "user")}
    killed = subprocess.run(words, env={**environment, "CASE_KILL": "5"}, capture_output=True, text=True)
    assert killed.returncode == -signal.SIGKILL, killed
    views = next((folder / "inner" / "aus").glob("views-*"))
    names = sorted(each.name for each in views.iterdir())
    assert names == ["unfinished_view_01_01.exr", "view_00_00.exr", "view_00_01.exr", "view_00_02.exr", "view_01_00.exr"], names
    stamps = {name: (views / name).stat().st_mtime_ns for name in names if name.startswith("view")}
    again = subprocess.run(words, env={**environment, "CASE_KILL": "0"}, capture_output=True, text=True)
    assert again.returncode == 0, again.stdout + again.stderr
    assert "views rendered: 5, views kept from earlier runs: 4" in again.stdout, again.stdout
    assert all((views / name).stat().st_mtime_ns == stamp for name, stamp in stamps.items())
    assert len(list(views.iterdir())) == 9
    return ""


def case_command(folder, zip_path):
    """A part of `case_resume`, which runs this function in two processes. The first process kills
    itself."""
    import bpy

    install(zip_path)
    from bl_ext.user_default.lumistack import command

    bpy.ops.wm.open_mainfile(filepath=os.environ["CASE_BLEND"])
    kill, count = int(os.environ["CASE_KILL"]), 0

    def begin(*_):
        nonlocal count
        count += 1
        if count == kill:
            Path(bpy.context.scene.render.filepath).write_bytes(b"half a picture")
            os.kill(os.getpid(), signal.SIGKILL)

    bpy.app.handlers.render_pre.append(begin)
    code = command.main(["views", "-o", str(folder / "aus"), "--display", str(settings_file(folder)), "--look", "linear"])
    sys.stdout.flush()
    os._exit(code)


def case_headless(folder, zip_path):
    """The command of the extension gives the right exit codes, files and messages."""
    import bpy
    import scenes

    install(zip_path)
    from bl_ext.user_default.lumistack import command

    scene = scenes.silhouettes()
    scene.cycles.samples = 1
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "szene.blend"))
    display = str(settings_file(folder))
    common = ["--display", display, "--views", "2x1", "--pixels", "50", "--iterations", "2", "--look", "linear"]
    assert command.main(["make", *common, "-o", str(folder / "a"), "--plugin", "quilt"]) == 0
    assert list((folder / "a" / "outputs" / "tensor-display" / "quilt").iterdir())
    assert command.main(["make", *common, "-o", str(folder / "b"), "--renderer", "both", "--samples", "4", "--blend", str(folder / "szene.blend")]) == 0
    assert (folder / "b" / "scene.glb").is_file()
    # Run without a window, as `blender --command` does; then there is no active object either.
    with bpy.context.temp_override(window=None):
        assert not hasattr(bpy.context, "active_object"), "this context is not that of a command"
        for renderer in ("lumistack", "both"):
            out = folder / f"no window {renderer}"
            assert command.main(["make", *common, "-o", str(out), "--renderer", renderer, "--samples", "4"]) == 0
            assert (out / "scene.glb").stat().st_size > 10_000
        other = bpy.data.scenes.new("other")
        other.collection.objects.link(bpy.data.objects["Cube"])
        other.camera = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
        other.camera.location = (0.35, -0.7, 4.0)
        other.collection.objects.link(other.camera)
        assert command.main(["make", *common, "-o", str(folder / "other"), "--renderer", "lumistack", "--samples", "1", "--scene", "other"]) == 0
    names = {node.get("name") for node in gltf_of(folder / "other" / "scene.glb")["nodes"]}
    assert "Cube" in names and "Torus" not in names, names
    # The quality is that of the panel: a fifth of the pixels in each direction.
    assert command.main(["views", "--display", display, "--quality", "draft", "--views", "half", "--look", "linear", "-o", str(folder / "draft")]) == 0
    import lumistack

    assert lumistack.LightField.open(folder / "draft" / "target").shape == (2, 2, 12, 19, 3)
    assert command.main(["--help"]) == 0
    assert command.main(["bake"]) == 2
    assert command.main(["make", "--scene", "none", "-o", str(folder / "c")]) == 1
    assert command.main(["make", "--display", "no-such-display", "-o", str(folder / "c")]) == 1
    assert command.main(["make", "--blend", str(folder / "none.blend"), "-o", str(folder / "c")]) == 1
    bpy.context.scene.camera = None
    assert command.main(["make", *common, "-o", str(folder / "c")]) == 1
    return ""


def case_digest(folder, zip_path):
    """The digest changes if data change on which views depend, and only then."""
    import bpy
    import scenes

    install(zip_path)
    from bl_ext.user_default.lumistack import digest

    scene = scenes.diffuse()
    scenes.every_kind(folder)
    path = folder / "d.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.open_mainfile(filepath=str(path))
    scene = bpy.context.scene
    first = digest.digest(scene)
    assert first == digest.digest(scene)
    bpy.ops.wm.open_mainfile(filepath=str(path))
    assert digest.digest(bpy.context.scene) == first, "the same file gave another digest"
    scene = bpy.context.scene
    objects, materials = bpy.data.objects, bpy.data.materials
    nodes, many = materials["clay"].node_tree.nodes, materials["many"].node_tree.nodes
    cube, sphere = objects["Cube"].data, objects["Sphere"].data
    layer = scene.view_layers[0]

    def attribute(data, name, kind, value):
        setattr(data.attributes[name].data[0], kind, value)
        data.update_tag()

    def shade_edge():
        sphere.edges[0].use_edge_sharp = True
        sphere.update()

    def curve_point():
        many["curves"].mapping.curves[3].points[0].location = (0.0, 0.4)
        many["curves"].mapping.update()
        materials["many"].node_tree.update_tag()

    def stroke():
        points = scenes.stroke_of(objects["pencil"].data)
        points.foreach_set("vector" if hasattr(points[0], "vector") else "co", [0.5] * 3 * len(points))
        objects["pencil"].data.update_tag()

    changes = {
        "an object moves": lambda: setattr(objects["Cube"], "location", (1.0, 0.0, 0.0)),
        "a vertex moves": lambda: attribute(cube, "position", "vector", (0.3, 0.3, 0.3)),
        "smooth faces": lambda: sphere.polygons.foreach_set("use_smooth", [True] * len(sphere.polygons)) or sphere.update(),
        "a sharp edge": shade_edge,
        "custom normals": lambda: sphere.normals_split_custom_set_from_vertices([(0.0, 0.0, 1.0)] * len(sphere.vertices)),
        "a vertex colour": lambda: attribute(cube, "paint", "color", (0.9, 0.1, 0.1, 1.0)),
        "another attribute": lambda: attribute(cube, "wear", "value", 0.7),
        "coordinates of a texture": lambda: attribute(cube, "UVMap", "vector", (0.2, 0.1)),
        "a light": lambda: setattr(bpy.data.lights["area"], "energy", 31.0),
        "a light's settings for Cycles": lambda: setattr(bpy.data.lights["area"].cycles, "max_bounces", 3),
        "a colour": lambda: setattr(nodes["Principled BSDF"].inputs["Base Color"], "default_value", (0.1, 0.2, 0.3, 1.0)),
        "a point of a curve": curve_point,
        "a color ramp": lambda: setattr(many["ramp"].color_ramp, "interpolation", "CONSTANT"),
        "the value of an output": lambda: setattr(many["value"].outputs[0], "default_value", 0.4),
        "a muted link": lambda: setattr(materials["many"].node_tree.links[0], "is_muted", True),
        "a picture's colour space": lambda: setattr(bpy.data.images["picture"].colorspace_settings, "name", "Non-Color"),
        "the mapping of a texture": lambda: setattr(many["image"].texture_mapping, "translation", (0.1, 0.0, 0.0)),
        "a material of geometry nodes": lambda: setattr(bpy.data.node_groups["paint"].nodes["set"].inputs["Material"], "default_value", materials["clay"]),
        "points of geometry nodes": lambda: setattr(bpy.data.node_groups["dots"].nodes["points"].inputs["Radius"], "default_value", 0.2),
        "hair curves": lambda: attribute(objects["curls"].data, "position", "vector", (0.1, 0.1, 0.5)),
        "a particle system's hair": lambda: setattr(bpy.data.particles[0], "hair_length", 0.5),
        "a stroke of Grease Pencil": stroke,
        "the world": lambda: scenes.background(0.3),
        "samples": lambda: setattr(scene.cycles, "samples", 7),
        # Use Solidify, since Bevel may round texture coordinates differently at each evaluation.
        "a modifier": lambda: objects["Cube"].modifiers.new("thick", "SOLIDIFY"),
        "a modifier only in renders": lambda: setattr(objects["Cone"].modifiers["smooth"], "render_levels", 1),
        "hidden in renders": lambda: setattr(objects["Torus"], "hide_render", True),
        "visible by reflection": lambda: setattr(objects["floor"], "visible_glossy", False),
        "the compositor": lambda: scenes.compositor(0.5),
        "a node of the compositor": lambda: scenes.compositor(0.7),
        "an override of a view layer": lambda: setattr(layer, "material_override", materials["floor"]),
        "a holdout of a view layer": lambda: setattr(layer.layer_collection.children["kinds"], "holdout", True),
        "a new object": lambda: scenes.add("cube", materials["clay"], size=0.1),
    }
    seen = {first}
    for name, change in changes.items():
        change()
        bpy.context.view_layer.update()
        found = digest.digest(scene)
        assert found not in seen, name
        seen.add(found)
    # Views do not depend on selections, on the active slot, or on a render that is finished.
    last = found
    scene.render.resolution_percentage = 4
    for same in (
        lambda: cube.vertices.foreach_set("select", [False] * len(cube.vertices)),
        lambda: bpy.ops.object.select_all(action="DESELECT"),
        lambda: setattr(objects["Cube"], "active_material_index", 0),
        lambda: bpy.ops.render.render(),
    ):
        same()
        bpy.context.view_layer.update()
        assert digest.digest(scene) == last
    return f"{len(changes)} changes"

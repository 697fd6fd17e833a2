"""Runs in the user's Blender, or in a Python with the module bpy: opens a .blend file and exports
it.

    blender -b --python-exit-code 1 --python blend.py -- FOLDER
    python blend.py -- FOLDER

FOLDER contains request.json. The script exports scene.glb there, or renders the views that the
request lists, or only lists the file's contents. It writes answer.json last. The modules of the
Python package `lumistack.blender` do the work; the request contains their source.
"""

import json
import os
import sys
import types

#: The oldest supported version of Blender.
OLDEST = (4, 2, 0)


def main():
    folder = sys.argv[sys.argv.index("--") + 1]
    with open(os.path.join(folder, "request.json"), encoding="utf-8") as file:
        request = json.load(file)
    # Report every failure in answer.json. The failure's kind states if another Blender may read the
    # file.
    answer = {"warnings": [], "files": []}
    try:
        import bpy

        answer["blender"] = bpy.app.version_string
        answer["program"] = bpy.app.binary_path or bpy.__file__
        if bpy.app.version < OLDEST:
            raise Unfit("Blender %s; 4.2 is the oldest supported version" % bpy.app.version_string)
        work(bpy, request, folder, answer)
    except ImportError as error:
        answer["error"] = {"kind": "bpy", "message": "Python %s without bpy (%s)" % (sys.version.split()[0], error)}
    except Unfit as error:
        answer["error"] = {"kind": "bpy", "message": str(error)}
    except Refused as error:
        answer["error"] = {"kind": "scene", "message": str(error)}
    except Exception as error:
        text = str(error).strip().replace("Error: ", "", 1)
        answer["error"] = {"kind": "other", "message": "%s: %s" % (type(error).__name__, text)}
    # Write the answer under another name first, so that an incomplete answer is never read.
    written = os.path.join(folder, "answer.json.new")
    with open(written, "w", encoding="utf-8") as file:
        json.dump(answer, file)
    os.replace(written, os.path.join(folder, "answer.json"))
    sys.stdout.flush()
    sys.stderr.flush()
    # Exit without Python's shutdown, in which Blender as a module may hang or crash.
    if "bpy" not in sys.modules or sys.modules["bpy"].app.module:
        os._exit(0)


class Unfit(Exception):
    """The error that this Blender cannot read the file; another Blender may be able to."""


class Refused(Exception):
    """The error that Blender cannot open the file, or cannot render its views."""


def work(bpy, request, folder, answer):
    modules = package(request["modules"])
    # Open the file; scripts in it do not run.
    try:
        bpy.ops.wm.open_mainfile(filepath=request["path"], load_ui=False, use_scripts=False)
    except RuntimeError as error:
        raise Refused(str(error).replace("Error: ", "", 1).strip().splitlines()[0]) from error
    scene = bpy.context.scene
    rate = scene.render.fps / scene.render.fps_base
    # List the scenes, frames and other files of the .blend file, and the content that an export
    # loses.
    answer["contents"] = {
        "scenes": [each.name for each in bpy.data.scenes],
        "frames": [scene.frame_start, scene.frame_end],
        "frames_per_second": rate,
        "engine": scene.render.engine,
    }
    answer["files"], answer["missing"] = modules["handover"].files_of(bpy)
    answer["untracked"] = modules["handover"].untracked(bpy)
    lost = answer["contents"]["lost"] = modules["unshown"].unshown(bpy, scene)
    if request["contents_only"]:
        return
    if lost and request["views"] is None:
        # The caller may request a render by Blender instead, so check that the engine can render.
        try:
            modules["rig"].check_engine(bpy, scene)
        except modules["rig"].NoOpenGL as error:
            answer["contents"]["unfit"] = str(error)
    modules["rig"].remove_leftovers(bpy)
    # Set the time: the requested time, or the time of the saved frame.
    if request["time_s"] is not None:
        frame = scene.frame_start + request["time_s"] * rate
        whole = int(frame // 1)
        scene.frame_set(whole, subframe=frame - whole)
    else:
        scene.frame_set(scene.frame_current, subframe=scene.frame_subframe)
    if "io_scene_gltf2" not in bpy.context.preferences.addons:
        import addon_utils

        addon_utils.enable("io_scene_gltf2")

    def warn(place, message):
        answer["warnings"].append([place, message])

    if request["views"] is None:
        modules["handover"].export_scene(bpy, os.path.join(folder, "scene.glb"), warn)
    else:
        render(bpy, scene, modules, request["views"], folder)


def render(bpy, scene, modules, asked, folder):
    """Renders one picture per requested view; a picture is renamed when it is complete."""
    cameras, rig = modules["cameras"], modules["rig"]
    try:
        rig.check_engine(bpy, scene)
    except rig.NoOpenGL as error:
        raise Refused(str(error)) from error
    window = cameras.window_of_job(asked["window"], tuple(asked["size_mm"]))
    depths = rig.depth_range(bpy, scene, window)

    def todo():
        for number, slope in enumerate(asked["slopes"]):
            camera = cameras.view_camera(window, slope, asked["distance_mm"], depths)
            path = os.path.join(folder, "view_%05d.exr" % number)

            def finished(number=number, path=path):
                os.replace(path, os.path.join(folder, "done_%05d.exr" % number))

            yield camera, path, finished

    rig.render_views(bpy, scene, asked["resolution"], todo())


def package(sources):
    """Makes a Python package of the modules in the request. Returns the modules by name."""
    name = "_lumistack_handover"
    parent = types.ModuleType(name)
    parent.__path__ = []
    sys.modules[name] = parent
    made = {}
    for module, source in sources:
        made[module] = types.ModuleType(name + "." + module)
        made[module].__package__ = name
        sys.modules[name + "." + module] = made[module]
        exec(compile(source, "<lumistack %s>" % module, "exec"), made[module].__dict__)
    return made


main()

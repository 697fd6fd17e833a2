"""Renders the view of `cargo xtask bench render` in Mitsuba 3, `llvm_ad_rgb`. `view.py` describes the requests.

Mitsuba compiles its kernels with the system's LLVM library. LLVM before version 16 fails on machines with AVX-512, so this
script uses the newest library that it finds. On Debian `apt-get install libllvm19` installs one. DRJIT_LIBLLVM_PATH
selects another.
"""
import glob
import os
import re
import sys
import time


def newest_llvm():
    found = {}
    for pattern in ("/usr/lib/*/libLLVM*.so*", "/usr/lib/llvm-*/lib/libLLVM*.so*", "/usr/lib64/libLLVM*.so*", "/opt/homebrew/opt/llvm/lib/libLLVM*.dylib"):
        for path in glob.glob(pattern):
            version = re.findall(r"\d+", os.path.basename(os.path.realpath(path)))
            if version:
                found[int(version[0])] = path
    return found[max(found)] if found else None


if "DRJIT_LIBLLVM_PATH" not in os.environ and newest_llvm():
    os.environ["DRJIT_LIBLLVM_PATH"] = newest_llvm()

import mitsuba as mi  # noqa: E402  this import reads DRJIT_LIBLLVM_PATH
import numpy as np  # noqa: E402

mi.set_variant("llvm_ad_rgb")

import drjit as dr  # noqa: E402  after the variant is chosen
import view  # noqa: E402

v = view.View(sys.argv[1])


def mesh(about, index):
    positions, triangles, uvs = v.arrays(about)
    picture = v.image(about)
    if picture:
        # Mitsuba reads 8-bit files as sRGB and makes them linear
        color = {"type": "bitmap", "filename": picture, "wrap_mode": "repeat"}
    else:
        color = {"type": "rgb", "value": about["color"]}
    props = mi.Properties()
    props["bsdf"] = mi.load_dict({"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": color}})
    props["face_normals"] = True
    shape = mi.Mesh(f"mesh_{index}", len(positions), len(triangles), has_vertex_normals=False, has_vertex_texcoords=True, props=props)
    params = mi.traverse(shape)
    params["vertex_positions"] = mi.Float(np.ravel(positions))
    params["faces"] = mi.UInt32(np.ravel(triangles).astype(np.uint32))
    params["vertex_texcoords"] = mi.Float(np.ravel(uvs))
    params.update()
    return shape


def light():
    corner, (u, w) = np.array(v.light["corner"]), np.array(v.light["edges"])
    # Mitsuba's rectangle is [-1, 1]² and faces +z
    to_world = np.eye(4)
    to_world[:3, 0], to_world[:3, 1] = u / 2, w / 2
    to_world[:3, 2] = np.cross(u, w) / np.linalg.norm(np.cross(u, w))
    to_world[:3, 3] = corner + (u + w) / 2
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": [v.light["radiance"]] * 3}}
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.0] * 3}}
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f(to_world), "emitter": emitter, "bsdf": black}


def camera(about):
    eye, backward = np.array(about["eye"]), np.array(about["backward"])
    right, up = about["shift"]
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": float(np.degrees(about["fov_x_rad"])),
        # fractions of the picture's width to the right, and of its height downwards
        "principal_point_offset_x": right,
        "principal_point_offset_y": -up * v.cols / v.rows,
        "near_clip": 1e-3 * float(np.linalg.norm(eye)),
        "far_clip": 1e4 * float(np.linalg.norm(eye)),
        "to_world": mi.ScalarTransform4f().look_at(eye, eye - backward, about["up"]),
        "film": {"type": "hdrfilm", "width": v.cols, "height": v.rows, "rfilter": {"type": "box"}, "pixel_format": "rgb"},
    }


scene = mi.load_dict({
    "type": "scene",
    "light": light(),
    "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [v.sky] * 3}},
    **{f"mesh_{i}": mesh(about, i) for i, about in enumerate(v.meshes)},
})
samplers = ("multijitter", "independent")
sensors = {}


def sensor(sampler, view):
    """Makes a camera at its first use."""
    if (sampler, view) not in sensors:
        sensors[sampler, view] = mi.load_dict(camera(v.cameras[view]) | {"sampler": {"type": sampler, "sample_count": 16}})
    return sensors[sampler, view]


# max_depth counts the segments of a path. The path has the camera's segment, one for every bounce
# after the first hit, and one to the light.
integrator = mi.load_dict({"type": "path", "max_depth": view.BOUNCES_AFTER_FIRST_HIT + 2, "rr_depth": 1000})


def render(sampler, samples, seed, view):
    of_view = sensor(sampler, view)
    dr.sync_thread()
    start, cpu = time.perf_counter(), time.process_time()
    picture = mi.render(scene, sensor=of_view, integrator=integrator, spp=samples, seed=seed)
    dr.eval(picture)
    dr.sync_thread()
    seconds, cpu_s = time.perf_counter() - start, time.process_time() - cpu
    return seconds, cpu_s, np.array(picture)


for name in samplers:
    # this render compiles the kernel, so that later times do not include the compilation
    render(name, 4, 1, 0)
view.serve(f"Mitsuba {mi.__version__} llvm_ad_rgb", list(samplers), render)

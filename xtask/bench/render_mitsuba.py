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


def camera():
    eye, backward = np.array(v.camera["eye"]), np.array(v.camera["backward"])
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": float(np.degrees(v.camera["fov_x_rad"])),
        "near_clip": 1e-3 * float(np.linalg.norm(eye)),
        "far_clip": 1e4 * float(np.linalg.norm(eye)),
        "to_world": mi.ScalarTransform4f().look_at(eye, eye - backward, v.camera["up"]),
        "film": {"type": "hdrfilm", "width": v.cols, "height": v.rows, "rfilter": {"type": "box"}, "pixel_format": "rgb"},
    }


scene = mi.load_dict({
    "type": "scene",
    "light": light(),
    "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [v.sky] * 3}},
    **{f"mesh_{i}": mesh(about, i) for i, about in enumerate(v.meshes)},
})
sensors = {
    sampler: mi.load_dict(camera() | {"sampler": {"type": sampler, "sample_count": 16}}) for sampler in ("multijitter", "independent")
}
# max_depth counts the segments of a path. The path has the camera's segment, one for every bounce
# after the first hit, and one to the light.
integrator = mi.load_dict({"type": "path", "max_depth": view.BOUNCES_AFTER_FIRST_HIT + 2, "rr_depth": 1000})


def render(sampler, samples, seed):
    dr.sync_thread()
    start = time.perf_counter()
    picture = mi.render(scene, sensor=sensors[sampler], integrator=integrator, spp=samples, seed=seed)
    dr.eval(picture)
    dr.sync_thread()
    seconds = time.perf_counter() - start
    return seconds, np.array(picture)


for name in sensors:
    # this render compiles the kernel, so that later times do not include it
    render(name, 4, 1)
view.serve(f"Mitsuba {mi.__version__} llvm_ad_rgb", list(sensors), render)

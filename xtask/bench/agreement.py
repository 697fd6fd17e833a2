"""Renders the scenes of `cargo xtask bench agreement` with Mitsuba 3, and tests whether Lumistack's pictures have the same means.

usage: agreement.py FOLDER

Each renderer makes several independent pictures of every scene, called batches. Three tests compare them:

- Welch's t of the two means per pixel and channel, two-sided
- the mean over all pixels of a picture
- the mean of t^2 over pixels (grey), which detects small differences in many pixels

If both renderers are correct, a run of this script still fails by chance with the probability FALSE_ALARM_RATE. Each test
gets this rate divided by the number of tests (Bonferroni). A relative difference of SYSTEMATIC is allowed, for two reasons:
float32, and the masking-shadowing term, where Mitsuba multiplies the terms of both directions and Lumistack uses the joint term.
"""

import json
import math
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")

FALSE_ALARM_RATE = 1e-3
SYSTEMATIC = 1e-3
TESTS_PER_SCENE = 3


def incomplete_beta(a, b, x):
    """Computes the regularized incomplete beta function by Lentz's continued fraction."""
    if x <= 0.0 or x >= 1.0:
        return min(max(x, 0.0), 1.0)
    if x > (a + 1.0) / (a + b + 2.0):
        return 1.0 - incomplete_beta(b, a, 1.0 - x)
    front = math.exp(math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b) + a * math.log(x) + b * math.log1p(-x)) / a
    c, d, result = 1.0, 0.0, 1.0
    for k in range(400):
        m = k // 2
        if k == 0:
            numerator = 1.0
        elif k % 2 == 0:
            numerator = m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m))
        else:
            numerator = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))
        d = 1.0 / max(1.0 + numerator * d, 1e-300) if 1.0 + numerator * d > 0 else 1.0 / min(1.0 + numerator * d, -1e-300)
        c = 1.0 + numerator / c
        change = c * d
        result = result * change if k else d
        if k and abs(change - 1.0) < 1e-12:
            break
    return front * result


def t_p(t, freedom):
    """Returns the probability of a |t| larger than `t` by chance, by Student's distribution."""
    return incomplete_beta(0.5 * freedom, 0.5, freedom / (freedom + t * t))


def mesh(path, bsdf, emitter):
    corners = np.fromfile(path, np.float32).reshape(-1, 5)
    properties = mi.Properties()
    properties["face_normals"] = True
    properties["bsdf"] = bsdf
    if emitter is not None:
        properties["emitter"] = emitter
    counts = {"vertex_count": len(corners), "face_count": len(corners) // 3}
    result = mi.Mesh(path.stem, **counts, props=properties, has_vertex_texcoords=True)
    parameters = mi.traverse(result)
    parameters["vertex_positions"] = np.ascontiguousarray(corners[:, :3]).ravel()
    parameters["vertex_texcoords"] = np.ascontiguousarray(corners[:, 3:]).ravel()
    parameters["faces"] = np.arange(len(corners), dtype=np.uint32)
    parameters.update()
    return result


def rgb(value):
    return {"type": "rgb", "value": value}


def surface(part, folder):
    kind, value = part["kind"], part["value"]
    if kind == "conductor":
        if value == 0.0:
            return {"type": "twosided", "bsdf": {"type": "conductor", "material": "none"}}
        conductor = {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": value}
        return {"type": "twosided", "bsdf": conductor}
    if kind == "dielectric":
        if value == 0.0:
            return {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
        return {"type": "roughdielectric", "distribution": "ggx", "alpha": value, "int_ior": 1.5, "ext_ior": 1.0}
    if kind == "textured":
        texels = np.fromfile(folder / "floor.f32", np.float32)
        side = math.isqrt(len(texels) // 3)
        bitmap = mi.Bitmap(texels.reshape(side, side, 3))
        reflectance = {"type": "bitmap", "bitmap": bitmap, "raw": True, "filter_type": "bilinear", "wrap_mode": "repeat"}
        return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}
    color = [0.0, 0.0, 0.0] if kind == "light" else value
    diffuse = {"type": "diffuse", "reflectance": rgb(color)}
    return diffuse if kind == "light" else {"type": "twosided", "bsdf": diffuse}


def load(folder):
    spec = json.loads((folder / "scene.json").read_text())
    camera = mi.ScalarTransform4f().look_at(origin=[0, 0, 50], target=[0, 0, 0], up=[0, 1, 0])
    film = {"type": "hdrfilm", "width": spec["size"], "height": spec["size"], "pixel_format": "rgb"}
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": spec["max_bounces"] + 1, "rr_depth": 1000},
        "sensor": {
            "type": "orthographic",
            "to_world": camera,
            "near_clip": 1.0,
            "far_clip": 200.0,
            "film": {**film, "rfilter": {"type": "box"}, "component_format": "float32"},
            "sampler": {"type": "independent", "sample_count": spec["samples"]},
        },
    }
    for index, part in enumerate(spec["parts"]):
        emitter = None
        if part["kind"] == "light":
            emitter = mi.load_dict({"type": "area", "radiance": rgb(part["value"])})
        bsdf = mi.load_dict(surface(part, folder))
        scene[f"mesh_{index}"] = mesh(folder / f"mesh_{index}.f32", bsdf, emitter)
    if isinstance(spec["sky"], str):
        texels = np.fromfile(folder / spec["sky"], np.float32)
        height = math.isqrt(len(texels) // 6)
        scene["sky"] = {"type": "envmap", "bitmap": mi.Bitmap(texels.reshape(height, 2 * height, 3))}
    elif spec["sky"] is not None:
        scene["sky"] = {"type": "constant", "radiance": rgb([spec["sky"]] * 3)}
    return spec, mi.load_dict(scene)


def compare(ours, theirs):
    """Compares two stacks of batches. Returns the relative difference of their means, and the largest |t| of all pixels and
    channels. Also returns the probabilities p of the largest |t|, of the picture's mean and of the mean of t^2."""
    count = len(ours)

    def t_of(a, b):
        difference = a.mean(0) - b.mean(0)
        granted = SYSTEMATIC * np.maximum(np.abs(b.mean(0)), 1e-3)
        error = np.sqrt((a.var(0, ddof=1) + b.var(0, ddof=1)) / count)
        excess = np.maximum(np.abs(difference) - granted, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            # without noise (error 0), t is 0 if the difference is at most SYSTEMATIC, and otherwise
            # infinite
            return np.where(excess > 0.0, excess / error, 0.0), error, difference

    freedom = count - 1
    t, _, _ = t_of(ours, theirs)
    largest = float(t.max())
    p_largest = min(1.0, t_p(largest, freedom) * t.size)
    picture = lambda stack: stack.mean((1, 2, 3))[:, None]
    t_mean, _, _ = t_of(picture(ours), picture(theirs))
    p_mean = t_p(float(t_mean[0]), freedom)
    grey_ours, grey_theirs = ours.mean(3), theirs.mean(3)
    grey_t, error, difference = t_of(grey_ours, grey_theirs)
    noisy = error > 0.0
    squares = (difference[noisy] / error[noisy]) ** 2 * (grey_t[noisy] > 0.0)
    full = 2 * freedom
    expected, variance = full / (full - 2), 2 * full * full * (full - 1) / ((full - 2) ** 2 * (full - 4))
    z = (squares.mean() - expected) / math.sqrt(variance / max(squares.size, 1))
    p_squares = 0.5 * math.erfc(max(z, 0.0) / math.sqrt(2.0)) * (1.0 if z > 0 else 2.0)
    return ours.mean() / theirs.mean() - 1.0, largest, p_largest, p_mean, p_squares


def main():
    root = Path(sys.argv[1])
    folders = sorted(path for path in root.iterdir() if (path / "scene.json").exists())
    limit = FALSE_ALARM_RATE / (TESTS_PER_SCENE * len(folders))
    failed = False
    print(f"Mitsuba {mi.__version__}; a p below {limit:.1e} fails; by chance this happens in one run of {1 / FALSE_ALARM_RATE:.0f}")
    print(f"{'scene':30} {'mean':>9} {'largest t':>10} {'p pixels':>10} {'p mean':>10} {'p squares':>10}")
    for folder in folders:
        spec, scene = load(folder)
        shape = (spec["batches"], spec["size"], spec["size"], 3)
        ours = np.fromfile(folder / "ours.f32", np.float32).reshape(shape).astype(np.float64)
        batches = [mi.render(scene, spp=spec["samples"], seed=1000 + k) for k in range(spec["batches"])]
        theirs = np.stack([np.array(batch, dtype=np.float64) for batch in batches])
        np.save(folder / "theirs.npy", theirs.astype(np.float32))
        mean, largest, *ps = compare(ours, theirs)
        bad = not all(p >= limit for p in ps)
        failed |= bad
        print(f"{folder.name:30} {100 * mean:+8.3f}% {largest:10.2f} " + " ".join(f"{p:10.2g}" for p in ps) + ("  FAILED" if bad else ""), flush=True)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()

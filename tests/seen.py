"""An independent model of the seen picture and of psnr_zone: DESIGN's geometry written out for single rays, many of them per pixel.

usage: seen.py RUN [RAYS_PER_AXIS]   (a run of a scene with tone = "linear"; nearest, drop; any pitch, offset, projection and backlight)

Prints psnr_zone and psnr_zone_worst_tenth as this model finds them.
"""
import glob
import json
import sys
import tomllib

import numpy as np
import OpenEXR

run, fine = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 20
display = tomllib.load(open(f"{run}/display.toml", "rb"))
report = json.load(open(f"{run}/report.json"))
beta, views = report["brightness"], report["views"]
rows, cols, pitch = views["rows"], views["cols"], views["pitch_mm"]
distance = views["distance_mm"]
layers = [np.load(f"{run}/layers/layer_{n}.npy").astype(np.float64) for n in range(len(display["layers"]))]
lenslets = display["backlight"] if display.get("backlight", {}).get("kind", "uniform") != "uniform" else None
emission = np.load(f"{run}/layers/emission.npy").astype(np.float64) if lenslets else None


def picture(direction, half):
    (path,) = glob.glob(f"{run}/cache/views/zone-*/direction_{direction:02}-{half}.exr")
    with OpenEXR.File(path) as file:
        channels = file.channels()
        rgb = channels["RGB"].pixels if "RGB" in channels else np.stack([channels[c].pixels for c in "RGB"], -1)
    return np.clip(rgb.astype(np.float64) * report["scene"]["exposure"], 0, 1)


def axis(centre_slope, offset, count, sign):
    """Where the rays of one axis pass z = 0, and their slopes."""
    x = sign * (np.arange(count) + offset - (count - 1) / 2) * pitch
    slope = np.full(count, centre_slope) if distance is None else (distance * centre_slope - x) / distance
    return x, slope


def index(x, slope, part, count, sign, side):
    """Which pixel of a layer a ray meets, and whether it does."""
    place = sign * (x + part["d_mm"] * slope - part.get("offset_mm", [0, 0])[side]) / part["pitch_mm"]
    found = np.floor(place + count / 2).astype(int)
    return found.clip(0, count - 1), (found >= 0) & (found < count)


def meets(slope, offset, side):
    """Where the rays of one axis meet every part, and whether they meet all."""
    count, sign = ((cols, 1), (rows, -1))[side]
    x, slopes = axis(slope[side], offset, count, sign)
    sizes = [values.shape[2 - side] for values in layers] + ([emission.shape[4 - side]] if lenslets else [])
    parts = display["layers"] + ([lenslets] if lenslets else [])
    found = [index(x, slopes, part, size, sign, side) for part, size in zip(parts, sizes)]
    return [place for place, _ in found], np.all([inside for _, inside in found], axis=0), slopes


def share(slope, side):
    """Share of the width of every pixel whose rays meet all parts: of many rays, since one axis alone is cheap."""
    many = 2000
    return np.mean([meets(slope, (i + 0.5) / many - 0.5, side)[1] for i in range(many)], axis=0)


def seen(slope):
    total, count = np.zeros((rows, cols, 3)), np.zeros((rows, cols))
    offsets = (np.arange(fine) + 0.5) / fine - 0.5
    across = [meets(slope, offset, 0) for offset in offsets]
    for r, inside_y, slope_y in (meets(slope, offset, 1) for offset in offsets):
        for c, inside_x, slope_x in across:
            valid, light = inside_y[:, None] & inside_x[None], 1.0
            for n, values in enumerate(layers):
                light = light * values[:, r[n]][:, :, c[n]]
            if lenslets:
                bins_y, bins_x = emission.shape[1:3]
                half = np.tan(np.radians(lenslets["fov_deg"]) / 2)
                bx = np.floor(bins_x / 2 * (1 + slope_x / half[0])).astype(int)
                by = np.floor(bins_y / 2 * (1 - slope_y / half[1])).astype(int)
                lit = ((by >= 0) & (by < bins_y))[:, None] & ((bx >= 0) & (bx < bins_x))[None]
                bx, by = bx.clip(0, bins_x - 1), by.clip(0, bins_y - 1)
                light = light * emission[:, by[:, None], bx[None], r[-1][:, None], c[-1][None]] * lit[None, :, :, None]
            total += light.mean(0) * valid[..., None]
            count += valid
    return total / np.maximum(count, 1)[..., None] / beta, np.outer(share(slope, 1), share(slope, 0))


errors = []
for number, direction in enumerate(report["zone"]["directions"]):
    found, counts = seen(direction["slope"])
    scored = counts >= 0.5
    a, b = picture(number, "a"), picture(number, "b")
    assert int(scored.sum()) == direction["pixels"], (number, scored.sum(), direction)
    errors.append(((found - a) * (found - b))[scored].mean())
errors = np.sort(errors)[::-1]
worst = errors[: -(-len(errors) // 10)].mean()
print(-10 * np.log10(errors.mean()), -10 * np.log10(worst))

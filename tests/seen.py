"""Computes seen pictures by an independent model: it traces many rays per pixel, each through the nearest pixel of every layer.

usage: seen.py RUN [RAYS_PER_PIXEL_AND_AXIS]

RUN is the folder of a run of a scene. The job must have tone = "linear", and its display must have nearest sampling and ignore rays
that miss a layer ("drop"). Pitch, offset, projection and backlight may have any values.
Prints psnr_zone and psnr_zone_worst_tenth of this model.
"""
import glob
import json
import sys
import tomllib

import numpy as np
import OpenEXR

run, many = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 2000
display = tomllib.load(open(f"{run}/display.toml", "rb"))
report = json.load(open(f"{run}/report.json"))
beta, views = report["brightness"], report["views"]
rows, cols, pitch = views["rows"], views["cols"], views["pitch_mm"]
distance = views["distance_mm"]
layers = [np.load(f"{run}/layers/layer_{n}.npy").astype(np.float64) for n in range(len(display["layers"]))]
lenslets = display["backlight"] if display.get("backlight", {}).get("kind", "uniform") != "uniform" else None
emission = np.load(f"{run}/layers/emission.npy").astype(np.float64) if lenslets else None
# the parts of the display: all layers, and a backlight of lenslets, each with its [columns, rows]
parts = [(part, (values.shape[2], values.shape[1])) for part, values in zip(display["layers"], layers)]
parts += [(lenslets, (emission.shape[4], emission.shape[3]))] if lenslets else []


def picture(direction, half):
    (path,) = glob.glob(f"{run}/cache/views/zone-*/direction_{direction:02}-{half}.exr")
    with OpenEXR.File(path) as file:
        channels = file.channels()
        rgb = channels["RGB"].pixels if "RGB" in channels else np.stack([channels[c].pixels for c in "RGB"], -1)
    return np.clip(rgb.astype(np.float64) * report["scene"]["exposure"], 0, 1)


def runs(slope, side):
    """Traces `many` rays per pixel along one axis; `side` is 0 for x, 1 for y.

    Neighbouring rays that read the same pixels of all parts (the layers and a backlight of
    lenslets) form a group, called a run. Only the first ray of a run is traced further. Returns
    three arrays. The array places[part, run, pixel] states the pixel of the part that a run reads.
    With a backlight of lenslets, the last part is the angular bin. The array shares[run, pixel] has
    the run's fraction of the pixel's width. The array inside[run, pixel] is true if the run hits
    all parts.
    """
    count, sign = ((cols, 1), (rows, -1))[side]
    offset = ((np.arange(many) + 0.5) / many - 0.5)[:, None]
    x = sign * (np.arange(count) + offset - (count - 1) / 2) * pitch
    slopes = np.full_like(x, slope[side]) if distance is None else (distance * slope[side] - x) / distance
    places = []
    for part, size in parts:
        at = sign * (x + part["d_mm"] * slopes - part.get("offset_mm", [0, 0])[side]) / part["pitch_mm"]
        places.append(np.floor(at + size[side] / 2).astype(int))
    if lenslets:
        bins = emission.shape[2 - side]
        half = np.tan(np.radians(lenslets["fov_deg"][side]) / 2)
        places.append(np.floor(bins / 2 * (1 + sign * slopes / half)).astype(int))
    places = np.stack(places)
    change = np.any(places[:, 1:] != places[:, :-1], axis=0)
    number = np.concatenate([np.zeros((1, count), int), np.cumsum(change, axis=0)])
    total = number.max() + 1
    shares = np.stack([(number == k).mean(0) for k in range(total)])
    first = np.stack([np.argmax(number == k, axis=0) for k in range(total)])
    chosen = np.take_along_axis(places, np.broadcast_to(first, (len(places), *first.shape)), axis=1)
    inside = np.all([(chosen[n] >= 0) & (chosen[n] < size[side]) for n, (_, size) in enumerate(parts)], axis=0)
    return chosen, shares, inside


def seen(slope):
    (across, width, inside_x), (down, height, inside_y) = runs(slope, 0), runs(slope, 1)
    total, count = np.zeros((rows, cols, 3)), np.zeros((rows, cols))
    for i in range(len(height)):
        for j in range(len(width)):
            weight = np.outer(height[i] * inside_y[i], width[j] * inside_x[j])
            light = 1.0
            for n, values in enumerate(layers):
                r, c = down[n, i].clip(0, values.shape[1] - 1), across[n, j].clip(0, values.shape[2] - 1)
                light = light * values[:, r][:, :, c]
            if lenslets:
                bins_y, bins_x, lens_rows, lens_cols = emission.shape[1:5]
                r, c = down[-2, i].clip(0, lens_rows - 1), across[-2, j].clip(0, lens_cols - 1)
                by, bx = down[-1, i], across[-1, j]
                lit = ((by >= 0) & (by < bins_y))[:, None] & ((bx >= 0) & (bx < bins_x))[None]
                by, bx = by.clip(0, bins_y - 1), bx.clip(0, bins_x - 1)
                light = light * emission[:, by[:, None], bx[None], r[:, None], c[None]] * lit[None, :, :, None]
            total += light.mean(0) * weight[..., None]
            count += weight
    return total / np.maximum(count, 1e-9)[..., None] / beta, count


errors = []
for number, direction in enumerate(report["zone"]["directions"]):
    found, counts = seen(direction["slope"])
    a, b = picture(number, "a"), picture(number, "b")
    # pixels that were not rendered are NaN
    scored = (counts >= 0.5) & ~np.isnan(a[..., 0])
    assert int(scored.sum()) == direction["pixels"], (number, scored.sum(), direction)
    errors.append(((found - a) * (found - b))[scored].mean())
errors = np.sort(errors)[::-1]
worst = errors[: -(-len(errors) // 10)].mean()
print(-10 * np.log10(errors.mean()), -10 * np.log10(worst))

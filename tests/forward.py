"""Computes psnr_view of a run from its .npy files by an independent forward model. A ray reads the nearest pixel of each layer.

usage: forward.py TARGET.npy LAYERS_DIR D1,D2,... PITCH_MM FOV_X FOV_Y BRIGHTNESS

The display must have a uniform backlight, oblique views and nearest sampling, and ignore rays that miss a layer ("drop").
Prints psnr_view and psnr_raw.
"""
import sys
import numpy as np

target, layers = np.load(sys.argv[1]).astype(np.float64), sys.argv[2]
distances = [float(d) for d in sys.argv[3].split(",")]
pitch, fov, beta = float(sys.argv[4]), np.radians([float(a) for a in sys.argv[5:7]]), float(sys.argv[7])
masks = [np.load(f"{layers}/layer_{n}.npy") for n in range(len(distances))]
Ay, Ax, H, W, _ = target.shape
error, count = 0.0, 0
for ay in range(Ay):
    for ax in range(Ax):
        sx = (ax - (Ax - 1) / 2) * (2 / Ax) * np.tan(fov[0] / 2)
        sy = -(ay - (Ay - 1) / 2) * (2 / Ay) * np.tan(fov[1] / 2)
        emitted, valid = 1.0, np.ones((H, W), bool)
        for d, mask in zip(distances, masks):
            c = np.floor(np.arange(W) + d * sx / pitch + 0.5).astype(int)
            r = np.floor(np.arange(H) - d * sy / pitch + 0.5).astype(int)
            valid &= ((r >= 0) & (r < H))[:, None] & ((c >= 0) & (c < W))[None]
            emitted = emitted * mask[:, r.clip(0, H - 1)][:, :, c.clip(0, W - 1)]
        difference = (emitted.mean(0) / beta - target[ay, ax])[valid]
        error, count = error + (difference**2).sum(), count + difference.size
psnr_view = -10 * np.log10(error / count)
print(psnr_view, psnr_view - 20 * np.log10(beta))

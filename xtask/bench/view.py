"""The scene and the requests that the peers of `cargo xtask bench render` share. Peers are other renderers, which are compared with Lumistack.

The script of a peer renders views of a scene with diffuse surfaces. Its argument is a folder with

    scene.json          meshes, cameras, sky and rectangle light; a flag for a light that must be exact
    N_positions.npy     vertices of mesh N in the world, N_triangles.npy its indices, N_uvs.npy texture coordinates (v downwards)
    image_N.png         textures, sRGB

The script answers requests. A request is one line of text with fields separated by tabs; an answer is one line of JSON:

    render SAMPLER SAMPLES SEED VIEW FILE    writes the picture of camera VIEW to FILE as linear float32 [row][col][rgb]; answers {"seconds": time for
                                             the paths, "cpu_s": processor time of all threads for the paths}

The lens of a camera is shifted by `shift`, [right, up] in widths of the picture. So the middle of the picture shows content this far from the camera's axis.

All renderers trace paths of 4 bounces after the first hit, without Russian roulette or clamping, and use a box filter.
"""
import json
import sys

import numpy as np

BOUNCES_AFTER_FIRST_HIT = 4


class View:
    def __init__(self, folder):
        self.folder = folder
        with open(f"{folder}/scene.json") as file:
            about = json.load(file)
        self.cameras, self.sky, self.light = about["cameras"], about["sky"], about["light"]
        self.cols, self.rows = about["pixels"]
        self.meshes = about["meshes"]
        self.exact = about["exact"]

    def arrays(self, mesh):
        """Reads positions, triangles and texture coordinates of a mesh."""
        return [np.load(f"{self.folder}/{mesh['files']}_{what}.npy") for what in ("positions", "triangles", "uvs")]

    def image(self, mesh):
        """Returns the path of the texture, or None."""
        return None if mesh["image"] is None else f"{self.folder}/image_{mesh['image']}.png"


def serve(name, samplers, render):
    """Answers requests until standard input ends. `render(sampler, samples, seed, view)` returns the time of the paths, their processor time,
    both in seconds, and the picture."""
    answer({"name": name, "samplers": samplers})
    for line in sys.stdin:
        _, sampler, samples, seed, view, path = line.rstrip("\n").split("\t")
        seconds, cpu_s, picture = render(sampler, int(samples), int(seed), int(view))
        np.save(path, np.ascontiguousarray(picture[:, :, :3], dtype=np.float32))
        answer({"seconds": seconds, "cpu_s": cpu_s})


def answer(message):
    print("\n" + json.dumps(message), flush=True)

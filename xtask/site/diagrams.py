"""Diagrams and charts of the documentation as SVG; pictures.py calls the functions of `DIAGRAMS`.

An SVG has its own style sheet, so that it follows the reader's choice of light or dark colours.
"""

import html
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
#: The colours of build.py, with accents.
STYLE = """
svg { color-scheme: light dark; --ink: #1b1f24; --paper: #fff; --line: #8b949e; --soft: #f3f5f7; --blue: #0a58ca; --pale: #dbe8fb; --orange: #b35900; }
@media (prefers-color-scheme: dark) { svg { --ink: #e6e9ec; --paper: #14171a; --line: #7d8790; --soft: #1d2226; --blue: #7db2ff; --pale: #1f3350; --orange: #ffb366; } }
text { font: 14px system-ui, sans-serif; fill: var(--ink); }
.small { font-size: 12px; }
.code { font-family: ui-monospace, monospace; font-size: 12.5px; }
.bold { font-weight: 600; }
.orange { fill: var(--orange); } .blue { fill: var(--blue); }
.paper { fill: var(--paper); }
.box { fill: var(--soft); stroke: var(--line); } .data { fill: var(--pale); stroke: var(--blue); } .plain { fill: none; stroke: var(--line); }
.arrow { fill: none; stroke: var(--ink); stroke-width: 1.5; marker-end: url(#tip); }
.line { stroke: var(--line); stroke-width: 1.2; fill: none; } .ray { stroke: var(--orange); stroke-width: 1.6; fill: none; } .axis { stroke: var(--ink); fill: none; }
.dash { stroke-dasharray: 5 4; }
.tip { fill: var(--ink); }
.bar { fill: var(--blue); } .bar2 { fill: var(--orange); }
.wedge { fill: var(--pale); stroke: none; opacity: .8; }
"""


class Drawing:
    """An SVG with a title, which screen readers speak."""

    def __init__(self, width: int, height: int, title: str) -> None:
        self.size, self.title, self.parts = (width, height), title, []

    def add(self, tag: str, kind: str, text: str = "", **attributes: object) -> None:
        named = " ".join(f'{key.replace("_", "-")}="{value:g}"' if isinstance(value, float) else f'{key.replace("_", "-")}="{value}"' for key, value in attributes.items())
        self.parts.append(f'<{tag} class="{kind}" {named}>{html.escape(text)}</{tag}>' if text else f'<{tag} class="{kind}" {named}/>')

    def text(self, x: float, y: float, text: str, kind: str = "", anchor: str = "middle") -> None:
        self.add("text", kind, text, x=x, y=y, text_anchor=anchor)

    def box(self, x: float, y: float, width: float, height: float, *lines: str, kind: str = "box") -> None:
        """Draws a box with centred lines: the first is bold, the others are small."""
        self.add("rect", kind, x=x, y=y, width=width, height=height, rx=6)
        top = y + height / 2 + 5 - 8.5 * (len(lines) - 1)
        for number, line in enumerate(lines):
            self.text(x + width / 2, top + 17 * number, line, "small" if number else "bold")

    def arrow(self, *points: tuple[float, float], label: str = "", kind: str = "arrow") -> None:
        self.add("polyline", kind, points=" ".join(f"{x:g},{y:g}" for x, y in points))
        if label:
            (x, y), (u, v) = points[0], points[1]
            self.text((x + u) / 2, (y + v) / 2 - 6, label, "small code")

    def line(self, x: float, y: float, u: float, v: float, kind: str = "line") -> None:
        self.add("line", kind, x1=x, y1=y, x2=u, y2=v)

    def write(self, path: Path) -> None:
        width, height = self.size
        tip = '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto"><path class="tip" d="M0,0 L8,4 L0,8 z"/></marker></defs>'
        head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" role="img"><title>{html.escape(self.title)}</title>'
        body = "\n".join([head, f"<style>{STYLE}</style>", tip, f'<rect class="paper" width="{width}" height="{height}" rx="6"/>', *self.parts, "</svg>\n"])
        path.write_text(body, encoding="utf-8")
        print(f"{path.relative_to(ROOT)}: {width} × {height}, {len(body) // 1000} kB")


def architecture(path: Path) -> None:
    d = Drawing(900, 330, "The journey of the data, from a scene file to pictures")
    for x, lines, kind in (
        (15, ("scene files", ".gltf .usd .blend", ".ply .obj"), "plain"),
        (205, ("Scene", "meshes, materials,", "lights, splats"), "data"),
        (395, ("LightField", "views × rows × cols", "× RGB, 0 to 1"), "data"),
        (585, ("LayerStack", "frames × layers ×", "rows × cols × RGB"), "data"),
        (775, ("outputs", "pictures, films,", "page, panels"), "plain"),
    ):
        d.box(x, 90, 110 if x in (15, 775) else 125, 72, *lines, kind=kind)
    for x, u, label in ((125, 205, "gltf, usd"), (330, 395, ""), (520, 585, ""), (710, 775, "plugins")):
        d.arrow((x, 126), (u - 2, 126), label=label)
    d.text(362, 72, "pathtracer, splats", "small code")
    d.line(362, 78, 362, 120)
    d.text(552, 72, "factorizer", "small code")
    d.line(552, 78, 552, 120)
    d.box(395, 12, 125, 44, "given views", "quilt, .npy, folders", kind="plain")
    d.arrow((457, 56), (457, 88))
    d.box(205, 216, 470, 48, "Display", "layers, backlight and frames, in mm; its RayMap: where rays hit layers")
    d.arrow((695, 162), (695, 283))
    for x in (267, 457, 647):
        d.arrow((x, 216), (x, 164))
    d.text(262, 196, "window", "small", "end")
    d.text(452, 196, "rays", "small", "end")
    d.text(642, 196, "rays", "small", "end")
    d.box(585, 285, 125, 36, "seen pictures", kind="data")
    d.arrow((647, 264), (647, 283))
    d.box(775, 285, 110, 36, "report", kind="plain")
    d.arrow((710, 303), (773, 303))
    d.text(575, 300, "forward model: light that", "small", "end")
    d.text(575, 315, "the patterns emit to an eye", "small", "end")
    d.write(path)


def ci(path: Path) -> None:
    d = Drawing(900, 300, "Steps of cargo xtask ci: which ones run side by side")
    d.box(15, 115, 110, 70, "format", "layers, words")
    d.box(165, 60, 150, 70, "fetch", "dependencies,", "packages")
    d.box(165, 170, 150, 70, "build, clippy, docs", "wasm32")
    d.box(365, 20, 300, 70, "web", "in browsers; then USD versions,", "workflows, site")
    d.box(365, 115, 300, 70, "plugins", "as libraries; then python,", "blender")
    d.box(365, 210, 300, 70, "tests", "cargo test; then panels,", "on compositors without hardware")
    d.box(715, 115, 160, 70, "stalls", "alone: it counts", "refreshes of panels")
    for y in (95, 205):
        d.arrow((125, 150), (145, 150), (145, y), (163, y))
        d.arrow((315, y), (340, y), (340, 150), (363, 150))
    for y in (55, 245):
        d.arrow((340, 150), (340, y), (363, y))
        d.arrow((665, y), (690, y), (690, 150), (713, 150))
    d.arrow((665, 150), (713, 150))
    d.write(path)


def display(path: Path) -> None:
    d = Drawing(820, 380, "A display file in a side view: layers, backlight, field of view and views")
    zero, scale, middle = 330, 2.0, 190
    d.add("polygon", "wedge", points=f"{zero},{middle} 790,{middle - 100} 790,{middle + 100}")
    d.add("rect", "box", x=130, y=60, width=26, height=260, rx=3)
    d.text(143, 48, "[backlight]", "code")
    for at, name in ((-40, "rear layer"), (0, "middle layer"), (40, "front layer")):
        x = zero + scale * at
        for row in range(16):
            d.add("rect", "data", x=x - 5, y=70 + 15 * row, width=10, height=15)
        d.text(x, 48 if at else 62, f"d_mm = {at}", "code")
    d.line(zero, 68, zero, 345, "line dash")
    d.text(zero, 362, "z = 0: display plane", "small")
    d.line(zero - 2 * 40, 330, zero, 330, "axis")
    d.text(zero - 40, 346, "gap 40 mm", "small")
    d.line(60, middle, 800, middle, "line dash")
    d.text(700, middle + 16, "z, to the viewer", "small")
    for number in range(5):
        y = middle + 100 * (number - 2) / 2
        d.arrow((zero, middle), (770, middle + (y - middle) * 440 / 460), kind="ray")
        d.add("circle", "orange", cx=775, cy=middle + (y - middle) * 445 / 460, r=4)
    d.text(795, 82, "views = [5, 5]", "code", "end")
    d.text(795, 308, "fov_deg = [20, 20]", "code", "end")
    d.text(470, 84, "pitch_mm", "code", "start")
    d.arrow((468, 80), (zero + 88, 92))
    d.text(470, 350, "frames = 6: six masks in turn", "code", "start")
    d.write(path)


def terms(path: Path) -> None:
    d = Drawing(820, 384, "A ray through the layers, with the terms of the glossary")
    zero, middle = 400, 200
    d.add("rect", "wedge", x=220, y=70, width=320, height=250)
    d.text(230, 338, "depth of field: detail is kept", "small", "start")
    for x, name in ((320, "layer 0"), (400, "layer 1"), (480, "layer 2")):
        for row in range(14):
            d.add("rect", "data", x=x - 6, y=80 + 16 * row, width=12, height=16)
        d.text(x, 60, name, "bold")
    d.line(zero, 66, zero, 355, "line dash")
    d.text(zero, 368, "display plane, z = 0", "small")
    d.line(320, 44, 400, 44, "axis")
    d.text(360, 38, "gap", "small")
    slope = -0.22
    y = lambda x: middle + slope * (x - zero)  # noqa: E731
    d.arrow((90, y(90)), (760, y(760)), kind="ray")
    d.add("circle", "orange", cx=90, cy=y(90), r=6)
    d.text(90, y(90) + 24, "scene point", "small")
    d.text(90, y(90) + 39, "at depth z < 0", "small")
    d.text(765, y(760) - 10, "eye", "bold")
    d.text(640, y(760) + 62, "slope s = rise / run", "small", "start")
    for x in (320, 400, 480):
        d.add("circle", "orange", cx=x, cy=y(x), r=4)
    d.text(500, 262, "the ray hits layer n at x + d_n · s", "small", "start")
    d.arrow((498, 257), (486, y(480) + 8))
    d.text(500, 290, "mask: the values of a layer in one frame", "small", "start")
    d.arrow((498, 286), (488, 280))
    d.line(zero, middle, 760, middle, "line dash")
    d.text(556, 110, "pixel pitch p", "small", "start")
    d.arrow((554, 106), (488, 103))
    d.write(path)


def plugins(path: Path) -> None:
    d = Drawing(860, 250, "The four kinds of plugins, and the data between them")
    d.box(15, 35, 115, 60, "importer", "obj, splats")
    d.box(170, 35, 115, 60, "scene", "as glTF", kind="data")
    d.box(170, 155, 115, 60, "source", "test_views")
    d.box(330, 95, 115, 60, "light field", kind="data")
    d.box(490, 95, 115, 60, "node", "tensor_display,", "parallax_barrier")
    d.box(645, 35, 100, 60, "layer stack", kind="data")
    d.box(645, 155, 100, 60, "output", "images, quilt,", "panels")
    d.text(805, 178, "files,", "small")
    d.text(805, 194, "or a panel", "small")
    d.arrow((130, 65), (168, 65))
    d.arrow((285, 65), (387, 65), (387, 93))
    d.text(300, 57, "path tracer", "small", "start")
    d.arrow((285, 185), (387, 185), (387, 157))
    d.arrow((445, 125), (488, 125))
    d.arrow((605, 125), (624, 125), (624, 65), (643, 65))
    d.arrow((695, 95), (695, 153))
    d.arrow((410, 155), (410, 232), (695, 232), (695, 217))
    d.arrow((745, 185), (775, 185))
    d.write(path)


def farm(path: Path) -> None:
    d = Drawing(880, 300, "Units of a sequence of two time steps, and the units that each one needs")
    d.box(15, 120, 95, 50, "place", "window, depth")
    for step, top in ((1, 20), (2, 165)):
        for number in range(3):
            d.box(165, top + 40 * number, 130, 34, f"trace/{number + 1}-of-3", kind="data")
            d.arrow((110, 145), (138, 145), (138, top + 17 + 40 * number), (163, top + 17 + 40 * number))
            d.arrow((295, top + 17 + 40 * number), (345, top + 57))
        d.box(347, top + 32, 95, 50, "expose", f"t000{step}")
        d.box(487, top + 32, 95, 50, "factorize", f"t000{step}")
        d.box(627, top + 32, 95, 50, "results", f"t000{step}")
        d.arrow((442, top + 57), (485, top + 57))
        d.arrow((582, top + 57), (625, top + 57))
        d.arrow((722, top + 57), (752, top + 57), (752, 145), (778, 145))
    d.arrow((535, 102), (535, 195))
    d.text(542, 152, "start of the next time step", "small", "start")
    d.arrow((395, 102), (395, 195))
    d.text(388, 152, "exposure", "small", "end")
    d.box(780, 120, 85, 50, "finish", "checks all")
    d.write(path)


def live(path: Path) -> None:
    d = Drawing(880, 250, "The three threads of a live display, and the mailboxes between them")
    d.box(15, 30, 150, 50, "files", "scene, job, light field", kind="plain")
    d.box(15, 100, 150, 50, "standard input", "settings, time", kind="plain")
    d.box(15, 170, 150, 50, "viewers", "tracker, mouse, page", kind="plain")
    d.box(235, 65, 130, 60, "renderer", "1, 1, 2, 4, ... paths", "per pixel and view")
    d.box(480, 65, 130, 60, "solver", "moves and improves", "the patterns")
    d.box(725, 65, 135, 60, "display", "page, window,", "panels")
    d.arrow((165, 55), (200, 55), (200, 88), (233, 88))
    d.arrow((165, 125), (200, 125), (200, 102), (233, 102))
    d.arrow((365, 95), (478, 95))
    d.arrow((610, 95), (723, 95))
    d.arrow((165, 195), (545, 195), (545, 127))
    d.text(422, 84, "light field", "small")
    d.text(422, 112, "newest only", "small blue")
    d.text(667, 84, "state", "small")
    d.text(667, 112, "newest only", "small blue")
    d.text(355, 188, "rays to the predicted positions of the eyes", "small")
    d.text(480, 235, "no thread waits for the next one; a value that a newer one replaces is skipped", "small")
    d.write(path)


def gpu(path: Path) -> None:
    """Draws the speeds in the table of docs/GPU.md as bars."""
    rows = re.findall(r"^\|([^|]*)\| `(\w+)`[^|]*\| (\d+) \| (\d+) \|", (ROOT / "docs/GPU.md").read_text(), re.M)
    assert len(rows) == 4, "docs/GPU.md: expected four rows of speeds, found another number"
    d = Drawing(760, 330, "Iterations per second of a graphics processor and of a processor")
    most, left, top = max(float(row[2]) for row in rows), 170, 50
    d.text(left, 28, "iterations per second", "bold", "start")
    d.add("rect", "bar", x=400, y=17, width=14, height=14)
    d.text(420, 29, "NVIDIA H200", "small", "start")
    d.add("rect", "bar2", x=530, y=17, width=14, height=14)
    d.text(550, 29, "16 cores of an Intel Xeon", "small", "start")
    for number, (size, solver, device, cores) in enumerate(rows):
        if size.strip():
            pixels, views, frames = size.split(", ")
            d.text(left, top + 18, f"{pixels}, {views}, {frames}", "small", "start")
            top += 28
        d.text(left - 10, top + 23, solver, "code", "end")
        for offset, value, kind in ((0, device, "bar"), (18, cores, "bar2")):
            width = 500 * float(value) / most
            d.add("rect", kind, x=left, y=top + offset, width=round(width, 1), height=15)
            d.text(left + width + 6, top + offset + 12, value, "small", "start")
        top += 48 + (14 if number == 1 else 0)
    d.write(path)


def zone(path: Path, runs: dict[str, tuple[list[tuple[float, float, float]], float, dict[str, Any]]]) -> None:
    """Draws the PSNR of seen pictures in the directions of the zone, as coloured discs over the views of the solver."""
    d = Drawing(760, 430, "PSNR of seen pictures over the viewing zone, with few views and with views at native slopes")
    values = [psnr for points, _, _ in runs.values() for _, _, psnr in points]
    low, high = math.floor(min(values)), math.ceil(max(values))
    most = max(max(abs(x), abs(y)) for points, _, _ in runs.values() for x, y, _ in points) * 1.08
    blue, yellow = (38, 52, 122), (250, 214, 72)

    def colour(value: float) -> str:
        part = (value - low) / (high - low)
        return "#" + "".join(f"{round(a + part * (b - a)):02x}" for a, b in zip(blue, yellow))

    for number, (label, (points, score, grid)) in enumerate(runs.items()):
        centre, middle, half = 190 + 380 * number, 205, 150
        d.text(centre, 28, f"{label}: {score:.1f} dB", "bold")
        d.add("rect", "plain", x=centre - half, y=middle - half, width=2 * half, height=2 * half)
        for x in grid["slope_x"]:
            for y in grid["slope_y"]:
                at = (centre + half * x / most, middle - half * y / most)
                d.line(at[0] - 4, at[1], at[0] + 4, at[1])
                d.line(at[0], at[1] - 4, at[0], at[1] + 4)
        for x, y, psnr in points:
            d.add("circle", "plain", cx=round(centre + half * x / most, 1), cy=round(middle - half * y / most, 1), r=9, style=f"fill:{colour(psnr)}")
        d.text(centre, 374, "slope of the direction, left to right", "small")
    for step in range(60):
        d.add("rect", "", x=280 + 3.4 * step, y=392, width=3.6, height=12, style=f"fill:{colour(low + (high - low) * step / 59)}")
    d.text(272, 403, f"{low} dB", "small", "end")
    d.text(492, 403, f"{high} dB", "small", "start")
    d.text(380, 422, "disc: PSNR of the seen picture in a direction; cross: a view of the solver", "small")
    d.write(path)


def stack(path: Path) -> None:
    d = Drawing(860, 330, "A stack of three panels: polarizers, panels and spacers between the backlight and the eye")
    d.add("rect", "bar2", x=30, y=60, width=22, height=200, rx=3, opacity=0.55)
    d.text(41, 285, "backlight", "small")
    for number in range(4):
        x = 95 + 190 * number
        d.add("rect", "box", x=x, y=60, width=12, height=200)
        upright = number % 2 == 0
        for row in range(9):
            y = 72 + 21 * row
            d.line(x + 6, y, x + 6, y + 13, "axis") if upright else d.line(x + 1, y + 6, x + 11, y + 6, "axis")
        d.text(x + 6, 285, "polarizer", "small")
        d.text(x + 6, 301, "upright" if upright else "level", "small")
        if number < 3:
            panel = x + 55
            d.add("rect", "data", x=panel, y=60, width=26, height=200)
            for row in range(1, 12):
                d.line(panel, 60 + 200 * row / 12, panel + 26, 60 + 200 * row / 12)
            d.text(panel + 13, 48, f"layer {number}", "bold")
            if number < 2:
                d.add("rect", "plain dash", x=panel + 34, y=66, width=90, height=14)
                d.add("rect", "plain dash", x=panel + 34, y=240, width=90, height=14)
                d.text(panel + 79, 100, "spacers", "small")
                d.line(panel + 13, 28, panel + 203, 28, "axis")
                d.text(panel + 108, 22, "gap", "small")
    d.arrow((55, 160), (800, 160), kind="ray")
    d.text(825, 165, "eye", "bold")
    d.text(430, 322, "each panel turns the polarization; the next polarizer turns this into the transmittance of the layer", "small")
    d.write(path)


DIAGRAMS: dict[str, Callable[[Path], None]] = {
    "architecture": architecture, "ci": ci, "display": display, "terms": terms, "plugins": plugins, "farm": farm,
    "live": live, "gpu": gpu, "stack": stack,
}  # fmt: skip

"""Makes the pictures of the documentation anew in docs/pictures: pictures.py LUMISTACK WORK [NAME...]

NAME is the name of a picture without its extension; without names all pictures are made. Runs and renders are in
WORK, and later calls use them again. LUMISTACK needs a build with the feature panels. The pictures also need Chromium
(LUMISTACK_CHROMIUM names it), Node.js with the packages of web/, pdftoppm, sway and grim, and for `usd` a Python with
OpenUSD (LUMISTACK_PYTHON). The Python that runs this program needs the package `lumistack`, NumPy, Pillow and OpenEXR.
This program also makes the diagrams of diagrams.py.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy
import OpenEXR
from PIL import Image, ImageDraw, ImageFont

import diagrams

ROOT = Path(__file__).resolve().parents[2]
OUT = ROOT / "docs/pictures"
LUMISTACK, WORK = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
SCENES = ROOT / "scenes"
#: Colours of sheets; they suit light and dark pages.
PAPER, INK = (29, 34, 38), (230, 233, 236)
#: Largest file of a picture, bytes.
MOST = 61_000
#: Jobs of runs that several pictures use.
JOBS = {
    "still-life": """scene = {scenes}/still-life/still-life.gltf
display = { preset = "paper-three-layer", resolution = [240, 150], frames = 6 }
render = { zone_samples = 300 }
window = { fit_depth = "compress" }
[[outputs]]
plugin = "web_simulator"
params = { title = "Still life" }
[[outputs]]
plugin = "images"
params = { sheet = true }
[[outputs]]
plugin = "quilt"
params = { columns = 4, rows = 3 }
""",
    "film": """scene = {scenes}/letters/letters.gltf
display = { preset = "fig4-three-layer-static", resolution = [420, 262] }
render = { zone_samples = 100 }
[[outputs]]
plugin = "transparencies"
params = { paper = "tight" }
""",
}


def lumistack(*words: object, program: object = LUMISTACK) -> str:
    done = subprocess.run([str(program), *map(str, words)], cwd=WORK, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"lumistack {' '.join(map(str, words))}:\n{done.stderr}")
    return done.stdout


def run(name: str) -> Path:
    """Returns the folder of a run of a job of `JOBS`."""
    (WORK / "jobs").mkdir(exist_ok=True)
    job = WORK / "jobs" / f"{name}.toml"
    lines = [f"scene = {json.dumps(str(SCENES) + line.split('{scenes}')[1])}" if "{scenes}" in line else line for line in JOBS[name].splitlines()]
    job.write_text("\n".join(lines) + "\n")
    lumistack("run", job, "-o", WORK / name)
    return WORK / name


def baselines() -> Path:
    lumistack("run", SCENES / "sweeps/baselines.toml", "-o", WORK / "baselines")
    return WORK / "baselines/nodes"


def srgb(linear: numpy.ndarray) -> Image.Image:
    linear = numpy.clip(numpy.asarray(linear, numpy.float64), 0, 1)
    codes = numpy.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return Image.fromarray((codes * 255 + 0.5).astype(numpy.uint8))


def views(name: str, scene: Path, *options: object) -> list[Image.Image]:
    """Returns rendered views of a scene, row by row."""
    display = () if "--display" in options else ("--display", "paper-three-layer")
    lumistack("render", scene, *display, "--denoise", "guided", "-o", WORK / name, *options)
    found = []
    for path in sorted((WORK / name).glob("view_*.exr")):
        channels = OpenEXR.File(str(path)).channels()
        picture = channels["RGB"].pixels if "RGB" in channels else numpy.stack([channels[c].pixels for c in "RGB"], -1)
        found.append(srgb(picture))
    return found


def simulate(folder: Path, view: str = "0,0") -> Image.Image:
    path = WORK / "simulated.png"
    lumistack("simulate", folder, "--view", view, "-o", path)
    with Image.open(path) as picture:
        return picture.convert("RGB")


def mask(folder: Path, layer: int, frame: int = 0) -> Image.Image:
    """Returns the mask of a layer in a frame as a picture. For the layer -1 it returns the emission of the backlight."""
    if layer < 0:
        emission = numpy.load(folder / "layers/emission.npy")[frame]
        bins_y, bins_x, rows, cols = emission.shape[:4]
        # the panel behind the lens array: each lenslet covers all of its bins
        emission = emission.transpose(2, 0, 3, 1, *range(4, emission.ndim))
        return srgb(emission.reshape(rows * bins_y, cols * bins_x, *emission.shape[4:]))
    return srgb(numpy.load(folder / f"layers/layer_{layer}.npy")[frame])


def sheet(name: str, rows: list[list[tuple[Image.Image, str]]], width: int, quality: int = 82, nearest: bool = False) -> None:
    """Writes pictures in rows, with labels below them. The pictures of a row have equal heights, and every row is `width` pixels wide."""
    font, gap, below = ImageFont.load_default(15), 10, 26
    parts, top = [], gap
    for row in rows:
        room = width - gap * (len(row) + 1)
        height = round(room / sum(picture.width / picture.height for picture, _ in row))
        left = gap
        for picture, label in row:
            size = (round(height * picture.width / picture.height), height)
            way = Image.Resampling.NEAREST if nearest and size[0] >= picture.width else Image.Resampling.LANCZOS
            parts.append((picture.convert("RGB").resize(size, way), label, left, top))
            left += size[0] + gap
        top += height + (below if any(label for _, label in row) else gap)
    whole = Image.new("RGB", (width, top), PAPER)
    pen = ImageDraw.Draw(whole)
    for picture, label, left, y in parts:
        whole.paste(picture, (left, y))
        pen.text((left + picture.width / 2, y + picture.height + 4), label, fill=INK, font=font, anchor="ma")
    save(name, whole, quality)


def save(name: str, picture: Image.Image, quality: int = 82) -> None:
    path = OUT / f"{name}.jpg"
    while True:
        picture.convert("RGB").save(path, quality=quality, optimize=True, progressive=True)
        if path.stat().st_size <= MOST or quality < 40:
            break
        quality -= 6
    print(f"{path.relative_to(ROOT)}: {picture.width} × {picture.height}, {path.stat().st_size // 1000} kB")


def screenshot(address: str, width: int, height: int) -> Image.Image:
    path = WORK / "screenshot.png"
    chromium = shutil.which(os.environ.get("LUMISTACK_CHROMIUM", "chromium")) or "chromium"
    subprocess.run(["node", ROOT / "xtask/site/shot.mjs", chromium, address, str(width), str(height), path], check=True)
    with Image.open(path) as picture:
        return picture.convert("RGB")


def first_hour() -> None:
    # the report states the time of the run, so no result may be cached
    shutil.rmtree(WORK / "still-life", ignore_errors=True)
    folder = run("still-life")
    save("first-hour", screenshot(f"file://{folder}/report.html", 1000, 1092).resize((750, 819), Image.Resampling.LANCZOS), 80)


def scenes() -> None:
    names = ["still-life/still-life.gltf", "letters/letters.gltf", "glass/glass.gltf", "dandelion/dandelion.spz"]
    size = ("--views", "1x1", "--resolution", "320x200", "--samples", 64)
    made = [(views(Path(name).stem, SCENES / name, *size)[0], Path(name).stem) for name in names]
    sheet("scenes", [made[:2], made[2:]], 680)


def glass() -> None:
    size = ("--views", "2x1", "--resolution", "360x225", "--samples", 48)
    left, right = views("glass-2", SCENES / "glass/glass.gltf", *size)
    sheet("gltf", [[(left, "from the left"), (right, "from the right")]], 760)


def usd() -> None:
    size = ("--views", "1x1", "--resolution", "240x150", "--samples", 128)
    pair = [views(f"usd-{kind}", SCENES / f"still-life/still-life.{kind}", *size)[0] for kind in ("gltf", "usda")]
    one, other = (numpy.asarray(picture, numpy.int16) for picture in pair)
    difference = Image.fromarray(numpy.clip(8 * numpy.abs(one - other), 0, 255).astype(numpy.uint8))
    sheet("usd", [[(pair[0], "still-life.gltf"), (pair[1], "still-life.usda"), (difference, "difference, 8 times")]], 760)


def splats() -> None:
    sides = {"-40,10": "from the left", "0,0": "from the front", "40,10": "from the right"}
    size = ("--views", "1x1", "--resolution", "240x150", "--samples", 1)
    made = [(views(f"dandelion {side}", SCENES / "dandelion/dandelion.spz", "--look-from", side, *size)[0], text) for side, text in sides.items()]
    sheet("splats", [made], 760)


def zone() -> None:
    """Draws the score of each direction of the zone, with five by five views and with the automatic number of views."""
    runs = {}
    for label, count in (("5 × 5 views", "5x5"), ("automatic views", "auto")):
        folder = WORK / f"zone-{count}"
        lumistack(
            "run", SCENES / "still-life/still-life.gltf", "--display", "paper-three-layer", "--frames", 6, "--resolution", "210x131",
            "--fit-depth=compress", "--zone-samples", 400, "--views", count, "-o", folder,
        )  # fmt: skip
        report = json.loads((folder / "report.json").read_text())
        grid = json.loads((folder / "target/lightfield.json").read_text())
        points = [(*entry["slope"], entry["psnr"]) for entry in report["zone"]["directions"]]
        runs[label] = (points, report["psnr_zone"], grid)
    diagrams.zone(OUT / "zone.svg", runs)


def viewer() -> None:
    page = run("still-life") / "outputs/tensor-display/web_simulator/preview.html"
    save("viewer", screenshot(f"file://{page}#mode=compare&comparison=slider&x=0.07&y=0.03", 900, 600), 78)


def web_simulator() -> None:
    page = run("still-life") / "outputs/tensor-display/web_simulator/preview.html"
    save("web_simulator", screenshot(f"file://{page}#mode=exploded&x=0.1&y=0.05", 900, 600), 78)


def python() -> None:
    """Shows objects of the package as a notebook shows them."""
    code = """import lumistack
display = lumistack.Display("paper-three-layer", resolution=(240, 150), views=(5, 5), frames=4)
light_field = lumistack.render(SCENE, display, zone_samples=200)
stack = light_field.factorize(iterations=10)
print(light_field._repr_html_())
print("<hr>")
print(stack._repr_html_())
"""
    code = code.replace("SCENE", repr(str(SCENES / "still-life/still-life.gltf")))
    html = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    page = WORK / "python.html"
    page.write_text(f'<meta charset="utf-8"><style>body {{ font: 15px system-ui; margin: 16px; background: #fff }}</style>{html}')
    save("python", trimmed(screenshot(f"file://{page}", 470, 900)), 80)


def trimmed(picture: Image.Image) -> Image.Image:
    """Returns the picture without empty rows at its bottom."""
    rows = numpy.asarray(picture.convert("L"))
    last = numpy.flatnonzero((rows != rows[-1, -1]).any(axis=1))[-1]
    return picture.crop((0, 0, picture.width, min(picture.height, int(last) + 17)))


def older(name: str, node: str, layers: dict[int, str], frame: int = 0) -> None:
    """Shows patterns of a node of scenes/sweeps/baselines.toml in one frame, and the picture that an eye sees."""
    folder = baselines() / node
    row = [(mask(folder, layer, frame), text) for layer, text in layers.items()]
    sheet(name, [[*row, (simulate(folder, "3.3,0"), "seen from 3.3° right")]], 860, nearest=True)


def parallax_barrier() -> None:
    older("parallax_barrier", "parallax-barrier-9-frames", {0: "rear layer, frame 1", 1: "front layer, frame 1"})


def two_layer_nmf() -> None:
    older("two_layer_nmf", "two-layer-nmf-6-frames", {0: "rear layer, frame 1", 1: "front layer, frame 1"})


def log_tomography() -> None:
    older("log_tomography", "three-layers-static-tomography", {0: "rear layer", 1: "middle layer", 2: "front layer"})


def tensor_display() -> None:
    older("tensor_display", "three-layers-6-frames", {0: "rear, frame 1", 1: "middle, frame 1", 2: "front, frame 1"})


def integral_imaging() -> None:
    older("integral_imaging", "integral-imaging", {-1: "panel behind the lens array"})


def directional_sequence() -> None:
    older("directional_sequence", "directional-sequence-9-frames", {-1: "backlight, frame 1", 0: "layer, frame 1"})


def images() -> None:
    folder = run("still-life") / "outputs/tensor-display/images"
    with Image.open(folder / "sheet.png") as picture:
        whole = picture.convert("RGB")
    # the masks of the first two frames
    whole = whole.crop((0, 0, whole.width, round(0.66 * whole.width)))
    save("images", whole.resize((640, round(640 * whole.height / whole.width)), Image.Resampling.LANCZOS), 76)


def quilt() -> None:
    [path] = (run("still-life") / "outputs/tensor-display/quilt").glob("*.png")
    with Image.open(path) as picture:
        save("quilt", picture.convert("RGB").resize((800, round(800 * picture.height / picture.width)), Image.Resampling.LANCZOS), 76)


def film_pages() -> list[Image.Image]:
    [path] = (run("film") / "outputs/tensor-display/transparencies").glob("*.pdf")
    for old in WORK.glob("film-page-*"):
        old.unlink()
    subprocess.run(["pdftoppm", "-r", "40", "-png", path, WORK / "film-page"], check=True)
    return [Image.open(page).convert("RGB") for page in sorted(WORK.glob("film-page-*"))]


def transparencies() -> None:
    pages = film_pages()
    named = list(zip(pages, ["assembly", "test chart", "rear film", "middle film", "front film"], strict=True))
    sheet("transparencies", [named[:2], named[2:]], 800)


def test_views() -> None:
    made = []
    for pattern in ("numbers", "cards"):
        job = WORK / "jobs" / f"{pattern}.toml"
        job.parent.mkdir(exist_ok=True)
        job.write_text(
            f'source = {{ plugin = "test_views", params = {{ pattern = "{pattern}", depth_mm = 70 }} }}\n'
            'display = { preset = "paper-three-layer", resolution = [160, 100], views = [3, 3], frames = 2 }\n'
            'factorize = { iterations = 2 }\n[[outputs]]\nplugin = "images"\nfrom = "light_field"\n'
        )
        folder = WORK / f"test-{pattern}"
        lumistack("run", job, "-o", folder)
        paths = sorted((folder / "outputs").rglob("view_*.png"))
        made.append([(Image.open(paths[index]), f"{pattern}: view {index % 3}, {index // 3}") for index in (3, 4, 5)])
    sheet("test_views", made, 760)


def teapot_obj() -> Path:
    """Writes the teapot of the still life as an OBJ file with its material."""
    document = json.loads((SCENES / "still-life/still-life.gltf").read_text())
    data = (SCENES / "still-life/still-life.bin").read_bytes()

    def values(index: int) -> numpy.ndarray:
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        kind = {5126: "<f4", 5125: "<u4", 5123: "<u2"}[accessor["componentType"]]
        count = accessor["count"] * {"SCALAR": 1, "VEC2": 2, "VEC3": 3}[accessor["type"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        return numpy.frombuffer(data, kind, count, start).reshape(accessor["count"], -1)

    [mesh] = [mesh for mesh in document["meshes"] if "teapot" in mesh.get("name", "").lower()]
    part = mesh["primitives"][0]
    lines = ["mtllib teapot.mtl", "usemtl brass"]
    for mark, key in (("v", "POSITION"), ("vn", "NORMAL"), ("vt", "TEXCOORD_0")):
        table = values(part["attributes"][key]).astype(float)
        if mark == "vt":
            table = numpy.stack([table[:, 0], 1 - table[:, 1]], -1)
        lines += [" ".join([mark, *(f"{value:.6g}" for value in row)]) for row in table]
    for triangle in values(part["indices"]).reshape(-1, 3) + 1:
        lines.append("f " + " ".join(f"{i}/{i}/{i}" for i in triangle))
    folder = WORK / "obj"
    folder.mkdir(exist_ok=True)
    (folder / "teapot.obj").write_text("\n".join(lines) + "\n")
    (folder / "teapot.mtl").write_text("newmtl brass\nKd 0.85 0.62 0.25\nPr 0.35\nPm 0.0\n")
    return folder / "teapot.obj"


def obj() -> None:
    path = teapot_obj()
    sides = {"-50,15": "from the left", "0,25": "from above", "50,15": "from the right"}
    size = ("--views", "1x1", "--resolution", "240x150", "--samples", 64)
    made = [(views(f"teapot {side}", path, "--look-from", side, *size)[0], text) for side, text in sides.items()]
    sheet("obj", [made], 760)


def panels() -> None:
    """Shows three outputs of a session without hardware, with their layers and with test patterns."""
    outputs = [f"HEADLESS-{number}" for number in (1, 2, 3)]
    display = WORK / "three.toml"
    display.unlink(missing_ok=True)
    words = ["--gaps-mm", "40,40", "--panel-resolution", "480x300", "--panel-pitch-mm", "1", "--panel-pixels", "2", "--views", "3x3", "--frames", "1"]
    lumistack("display", "new", display, *words, "--outputs", ",".join(outputs), "--refresh-hz", "60", "--no-questions")
    lumistack("run", SCENES / "still-life/still-life.gltf", "--display", display, "--zone-samples", 200, "-o", WORK / "panels")
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        places = [f"output {output} resolution 480x300 position {480 * i},0\n" for i, output in enumerate(outputs)]
        (folder / "config").write_text("default_border none\n" + "".join(places))
        folder.chmod(0o700)
        words = ["sway", "-c", str(folder / "config")]
        if os.getuid() == 0:
            # sway refuses to run as root
            shutil.chown(folder, "nobody")
            words = ["setpriv", "--reuid=nobody", "--regid=nogroup", "--clear-groups", "--", *words]
        base = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY")}
        base |= {"XDG_RUNTIME_DIR": name, "WLR_BACKENDS": "headless", "WLR_HEADLESS_OUTPUTS": "3", "WLR_LIBINPUT_NO_DEVICES": "1", "WLR_RENDERER": "pixman"}
        with subprocess.Popen(words, env=base, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as server:
            deadline = time.monotonic() + 20
            while not (found := [path for path in folder.glob("wayland-*") if path.suffix != ".lock"]) and time.monotonic() < deadline:
                time.sleep(0.1)
            env = base | {"WAYLAND_DISPLAY": found[0].name, "XDG_SESSION_TYPE": "wayland"}
            shown = {"the masks": [WORK / "panels"], "identify": [display, "--pattern", "identify"], "crosshairs": [display, "--pattern", "crosshairs"]}
            for label, words in shown.items():
                with subprocess.Popen([LUMISTACK, "show", *map(str, words)], env=env, cwd=WORK, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as show:
                    time.sleep(4)
                    path = folder / "shot.png"
                    subprocess.run(["grim", "-s", "1", path], env=env, check=True)
                    show.terminate()
                with Image.open(path) as picture:
                    whole = picture.convert("RGB")
                rows.append([(whole.crop((480 * i, 0, 480 * i + 480, 300)), f"{label}, layer {i}") for i in range(3)])
            server.terminate()
    sheet("panels", rows, 800)


def outputs() -> None:
    """Shows a mask, a quilt and the page of one run, and a film of another run."""
    folder = run("still-life") / "outputs/tensor-display"
    [quilted] = (folder / "quilt").glob("*.png")
    page = screenshot(f"file://{folder}/web_simulator/preview.html", 900, 600)
    film = film_pages()[2]
    masks = Image.open(folder / "images/layer_1_frame_00.png")
    sheet("outputs", [[(masks, "a mask (images)"), (Image.open(quilted), "quilt")], [(film, "film (transparencies)"), (page, "web_simulator")]], 700)


PICTURES: dict[str, Callable[[], None]] = {
    "first-hour": first_hour, "scenes": scenes, "gltf": glass, "usd": usd, "splats": splats, "zone": zone, "viewer": viewer,
    "web_simulator": web_simulator, "python": python, "parallax_barrier": parallax_barrier, "two_layer_nmf": two_layer_nmf,
    "log_tomography": log_tomography, "tensor_display": tensor_display, "integral_imaging": integral_imaging,
    "directional_sequence": directional_sequence, "images": images, "quilt": quilt, "transparencies": transparencies,
    "test_views": test_views, "obj": obj, "panels": panels, "outputs": outputs,
}  # fmt: skip


def main() -> None:
    names = sys.argv[3:] or [*PICTURES, *diagrams.DIAGRAMS]
    WORK.mkdir(parents=True, exist_ok=True)
    OUT.mkdir(exist_ok=True)
    for name in names:
        if name in PICTURES:
            PICTURES[name]()
        elif name in diagrams.DIAGRAMS:
            diagrams.DIAGRAMS[name](OUT / f"{name}.svg")
        else:
            sys.exit(f"expected one of {', '.join([*PICTURES, *diagrams.DIAGRAMS])}, found {name}")


if __name__ == "__main__":
    main()

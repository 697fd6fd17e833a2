"""Parses the words after `blender -b FILE.blend --command lumistack` into settings of the
extension."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from typing import Any, NoReturn, TextIO

#: A line is printed whenever the progress has grown by this fraction of the stage.
WORTH_A_LINE = 0.02


class Usage(Exception):
    """The command line is wrong (code 2), or requests help (code 0). The text is the message."""

    def __init__(self, text: str, code: int) -> None:
        super().__init__(text)
        self.code = code


@dataclass(frozen=True)
class Asked:
    """The requested work."""

    #: "make" or "views".
    what: str
    blend: str | None
    scene: str | None
    #: "move" or "compress"; None if depth is not fitted.
    fit_depth: str | None
    #: Values of the extension's settings, `Scene.lumistack`.
    settings: dict[str, Any] = field(default_factory=dict)
    #: Values of Blender's own settings of the scene.
    scene_settings: dict[str, Any] = field(default_factory=dict)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise Usage(f"{self.format_usage()}lumistack: {message}", 2)

    def print_help(self, file: Any = None) -> None:
        raise Usage(self.format_help(), 0)


def _pair(text: str) -> tuple[int, int]:
    parts = text.replace("×", "x").split("x")
    if len(parts) != 2 or not all(part.isdigit() and int(part) > 0 for part in parts):
        raise argparse.ArgumentTypeError(f"expected two whole numbers such as 5x5, found {text}")
    return int(parts[0]), int(parts[1])


def _views(text: str) -> tuple[str, tuple[int, int] | None]:
    """Returns the values of the settings `views_from` and `views`."""
    if text in ("auto", "half"):
        return text.upper(), None
    try:
        return "OWN", _pair(text)
    except argparse.ArgumentTypeError as error:
        raise argparse.ArgumentTypeError(f"expected auto, half, or two whole numbers such as 5x5, found {text}") from error


def _frames(text: str) -> tuple[int, int]:
    first, dots, last = text.partition("..")
    try:
        found = (int(first), int(last if dots else first))
    except ValueError:
        found = (1, 0)
    if found[0] > found[1]:
        raise argparse.ArgumentTypeError(f"expected a range of frames such as 1..24, found {text}")
    return found


def parse(words: list[str]) -> Asked:
    """Parses the words of the command line. Raises `Usage`."""
    parser = _Parser(prog="blender -b FILE.blend --command lumistack", description="Makes patterns of a scene. Settings without a flag are taken from the file.")
    parser.add_argument("what", nargs="?", choices=["make", "views"], default="make", help="patterns and outputs (make), or the views alone (views)")
    parser.add_argument("--blend", metavar="FILE", help="another .blend file to open")
    parser.add_argument("--scene", metavar="NAME", help="name of a scene in the file")
    parser.add_argument("-o", "--output", metavar="DIR", dest="folder", help="folder for all results")
    parser.add_argument("--display", metavar="PRESET|FILE", help="name of a built-in display, or path of a display file")
    parser.add_argument("--grid", choices=["display", "oblique", "perspective"], help="parallel views, or views from eyes")
    parser.add_argument("--distance-mm", type=float, metavar="MM", help="distance of the eyes from the display; implies --grid perspective")
    parser.add_argument("--views", type=_views, metavar="auto|half|HxV", help="number of views: auto (enough that the picture is also correct between the views), half (half as many per axis as auto), or HxV")
    parser.add_argument("--score", action=argparse.BooleanOptionalAction, help="render a few views more, and score the display between its views")
    parser.add_argument("--quality", choices=["draft", "preview", "full"], help="quality, as in the panel; determines pixels, iterations and paths")
    parser.add_argument("--brightness", type=float, metavar="B", help="brightness scale, above 0 and at most 1")
    parser.add_argument("--pixels", type=int, metavar="PERCENT", help="percentage of the display's columns and rows that is used")
    parser.add_argument("--iterations", type=int, metavar="N", help="iterations of the solver")
    parser.add_argument("--samples", type=int, metavar="N", help="paths per pixel of Lumistack's path tracer")
    parser.add_argument("--renderer", choices=["blender", "lumistack", "both"], help="program that renders the views")
    parser.add_argument("--look", choices=["scene", "linear"], help="exposure and tone curve: as Blender shows the scene, or linear")
    parser.add_argument("--exposure", type=float, metavar="EV", help="exposure in stops, with --look linear")
    parser.add_argument("--window-distance", type=float, metavar="D", help="distance from the camera to the window, scene units")
    parser.add_argument("--window-size", type=float, metavar="F", help="width of the window, divided by the width of the camera's picture in the window's plane")
    parser.add_argument("--handover", choices=["gltf", "usd", "both"], help="format in which Lumistack's path tracer gets the scene")
    parser.add_argument("--fit-depth", choices=["move", "compress"], help="bring the scene into the display's depth of field: move the window, or also compress the depth")
    parser.add_argument("--frames", type=_frames, metavar="A..B", help="a range of frames, such as 1..24; every frame gets its own patterns")
    parser.add_argument("--plugin", metavar="ID", help="output plugin")
    found = parser.parse_args(words)
    # Convert the words to the extension's settings.
    settings: dict[str, Any] = {}
    for name, value in (
        ("folder", found.folder),
        ("grid", found.grid and found.grid.upper()),
        ("distance_mm", found.distance_mm),
        ("views_from", found.views and found.views[0]),
        ("views", found.views and found.views[1]),
        ("use_score", found.score),
        ("quality", found.quality and found.quality.upper()),
        ("brightness", found.brightness),
        ("percentage", found.pixels),
        ("iterations", found.iterations),
        ("samples", found.samples),
        ("renderer", found.renderer and found.renderer.upper()),
        ("look", found.look and found.look.upper()),
        ("exposure_ev", found.exposure),
        ("distance", found.window_distance),
        ("window_size", found.window_size),
        ("handover", found.handover and found.handover.upper()),
        ("output", found.plugin),
    ):
        if value is not None:
            settings[name] = value
    # Some settings of the extension have an effect only together with another setting. A flag for
    # the first setting also sets the other setting.
    if found.display is not None:
        is_file = found.display.endswith(".toml")
        settings["display_from"] = "FILE" if is_file else "PRESET"
        settings["file" if is_file else "preset"] = found.display
    if "distance_mm" in settings and settings.setdefault("grid", "PERSPECTIVE") != "PERSPECTIVE":
        parser.error(f"--distance-mm: expected --grid perspective, which has eyes at a distance, found --grid {found.grid}")
    if "brightness" in settings:
        settings["use_brightness"] = True
    if {"percentage", "iterations", "samples"} & settings.keys():
        if "quality" in settings:
            parser.error("--quality: expected either --quality, or --pixels, --iterations and --samples, found both")
        settings["quality"] = "CUSTOM"
    if "distance" in settings:
        settings["window_from"] = "DISTANCE"
    scene_settings: dict[str, Any] = {}
    if found.frames is not None:
        settings["times"] = "RANGE"
        scene_settings = {"frame_start": found.frames[0], "frame_end": found.frames[1]}
    return Asked(found.what, found.blend, found.scene, found.fit_depth, settings, scene_settings)


class ProgressPrinter:
    """Prints progress: a line at the beginning of every stage, then a line after every two per cent
    of the stage (`WORTH_A_LINE`)."""

    def __init__(self, file: TextIO) -> None:
        self._file, self._last = file, ("", -1.0)

    def __call__(self, title: str, share: float) -> None:
        stage = title.split(":")[0]
        if stage == self._last[0] and share < self._last[1] + WORTH_A_LINE:
            return
        self._last = (stage, share)
        print(f"{100 * share:3.0f} %  {title}", file=self._file, flush=True)

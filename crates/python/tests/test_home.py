"""Light fields and patterns with other Python libraries: indices, DLPack, xarray, notebooks, plots,
progress."""

from __future__ import annotations

import base64
import io
import math
import os
import re
import subprocess
import sys
import types
import warnings
import zlib
from pathlib import Path
from typing import Any

import matplotlib
import numpy
import pytest
import xarray
from matplotlib import pyplot
from numpy.typing import NDArray
from PIL import Image

import lumistack
from lumistack import _progress, _show

matplotlib.use("agg")


def test_a_light_field_is_indexed_as_its_array(light_field: lumistack.LightField) -> None:
    array = light_field.radiance
    assert len(light_field) == 3 and light_field.ndim == 5 and light_field.dtype == numpy.float32
    assert numpy.array_equal(light_field[0, 2], array[0, 2])
    assert numpy.shares_memory(light_field[0, 2], array)
    assert numpy.array_equal(light_field[..., 1], array[..., 1])
    assert [row.shape for row in light_field] == [array.shape[1:]] * 3
    with pytest.raises(IndexError):
        light_field[3]


class Tensor:
    """A tensor that has DLPack's methods, and no other protocol for arrays."""

    def __init__(self, array: NDArray[Any]) -> None:
        self.array = array

    def __dlpack__(self, **options: Any) -> Any:
        return self.array.__dlpack__(**options)

    def __dlpack_device__(self) -> Any:
        return self.array.__dlpack_device__()


class OnADevice(Tensor):
    def __dlpack__(self, **options: Any) -> Any:
        raise BufferError("the tensor is on a device")

    def __dlpack_device__(self) -> Any:
        return 2, 0


def test_dlpack_goes_in_without_a_copy(radiance: NDArray[numpy.float32], display: lumistack.Display) -> None:
    taken = lumistack.LightField(Tensor(radiance), display=display)  # type: ignore[arg-type]
    assert numpy.shares_memory(taken.radiance, radiance)
    with pytest.raises(TypeError, match="radiance: expected an array in the processor's memory, found OnADevice"):
        lumistack.LightField(OnADevice(radiance), display=display)  # type: ignore[arg-type]


def test_dlpack_goes_out(light_field: lumistack.LightField) -> None:
    taken = numpy.from_dlpack(light_field)
    assert numpy.array_equal(taken, light_field.radiance)
    if tuple(map(int, numpy.__version__.split(".")[:2])) >= (2, 1):
        assert numpy.shares_memory(taken, light_field.radiance) and not taken.flags.writeable
    # A library of the older protocol, which has no read-only memory, gets a copy.
    capsule = light_field.__dlpack__()
    assert "dltensor" in repr(capsule)


def test_xarray_has_the_axes_with_their_places(light_field: lumistack.LightField) -> None:
    data = light_field.to_xarray()
    assert isinstance(data, xarray.DataArray)
    assert data.dims == ("view_y", "view_x", "row", "col", "rgb")
    assert numpy.shares_memory(data.values, light_field.radiance)
    assert data.slope_x.values.tolist() == light_field.slope_x
    # The display has 24 × 16 pixels of 1 mm, and y points up.
    assert data.x_mm.values[[0, -1]].tolist() == [-11.5, 11.5] and data.y_mm.values[[0, -1]].tolist() == [7.5, -7.5]
    red = data.sel(rgb="r").isel(view_y=1, view_x=1)
    assert numpy.array_equal(red.values, light_field.radiance[1, 1, :, :, 0])


def test_an_array_file_holds_the_values(light_field: lumistack.LightField, tmp_path: Path) -> None:
    light_field.save(tmp_path / "field.npy")
    assert numpy.array_equal(numpy.load(tmp_path / "field.npy"), light_field.radiance)
    again = lumistack.LightField.open(tmp_path / "field.npy", fov_deg=(20, 20), pitch_mm=1.0)
    assert numpy.array_equal(again.radiance, light_field.radiance)
    assert numpy.allclose(again.slope_x, light_field.slope_x)
    with pytest.raises(lumistack.SettingError, match="expected no `info`"):
        light_field.save(tmp_path / "other.npy", info={"by": "hand"})
    assert not (tmp_path / "other.npy").exists()


def test_methods_are_the_functions(light_field: lumistack.LightField, tmp_path: Path) -> None:
    stack = light_field.factorize(iterations=5)
    same = lumistack.factorize(light_field, iterations=5)
    assert all(numpy.array_equal(a, b) for a, b in zip(stack.layers, same.layers, strict=True))
    assert numpy.array_equal(stack.simulate((0.05, 0.0)), lumistack.simulate(stack, (0.05, 0.0)))
    assert numpy.array_equal(stack.simulate(angle_deg=(3, -1)), lumistack.simulate(stack, angle_deg=(3, -1)))
    assert stack.write("images", tmp_path / "images") == lumistack.write(stack, "images", tmp_path / "again")
    with pytest.raises(TypeError, match="iteratoins"):
        light_field.factorize(iteratoins=5)  # type: ignore[call-arg]


@pytest.mark.parametrize("weighted", [False, True])
def test_psnr_can_be_had_by_hand(light_field: lumistack.LightField, weighted: bool) -> None:
    weights = numpy.ones((3, 3), numpy.float32) if weighted else None
    if weights is not None:
        weights[0, 1] = 0.0
    stack = light_field.factorize(iterations=5, weights=weights)
    counts = stack.weights(light_field, weights=weights)
    assert counts.shape == light_field.shape[:4] and not counts.flags.writeable
    assert 0 < (counts > 0).sum() < counts.size, "rays of oblique views miss layers at the border"
    assert (counts[0, 1] > 0).any() != weighted
    error = (stack.views(light_field).radiance.astype(float) - light_field.radiance) ** 2
    by_hand = -10 * math.log10(error[counts > 0].mean())
    assert stack.psnr(light_field, weights=weights) == pytest.approx(by_hand, abs=1e-4)


def pictures(html: str) -> list[NDArray[Any]]:
    found = re.findall(r'src="data:image/png;base64,([^"]+)"', html)
    return [numpy.asarray(Image.open(io.BytesIO(base64.b64decode(data)))) for data in found]


def test_a_notebook_shows_views_and_sliders(light_field: lumistack.LightField) -> None:
    html = light_field._repr_html_()
    assert html is not None
    views = pictures(html)
    assert len(views) == 9 and views[0].shape == (16, 24, 3)
    expected = light_field[0, 0]
    # The transfer function of sRGB, IEC 61966-2-1.
    encoded = numpy.where(expected <= 0.0031308, 12.92 * expected, 1.055 * expected ** (1 / 2.4) - 0.055)
    assert numpy.abs(views[0] - 255 * encoded).max() < 0.51
    assert html.count('type="range"') == 2 and html.count("display:none") == 8
    assert html.count('data-at="1,1"') == 1 and 'data-at="1,1" style="width:320px;image-rendering:auto"' in html


def test_a_notebook_shows_patterns(light_field: lumistack.LightField) -> None:
    stack = light_field.factorize(iterations=3)
    html = stack._repr_html_()
    assert html is not None and "\N{MINUS SIGN}12, 0, 12 mm" in html and f"{stack.history[-1][2]:.2f} dB" in html
    # The notebook shows the seen picture at three slopes, and the masks of three layers.
    assert len(pictures(html)) == 6
    # A name with HTML tags is shown as text.
    display = lumistack.Display({**stack.display.to_dict(), "name": "<script>alert(1)</script>"})
    named = lumistack.LayerStack(stack.layers, display)._repr_html_()
    assert named is not None and "<script" not in named


def test_large_views_are_reduced_and_many_are_thinned() -> None:
    radiance = numpy.random.default_rng(1).random((1, 40, 10, 1000, 3), numpy.float32)
    html = lumistack.LightField(radiance, pitch_mm=1.0, fov_deg=(40, 1))._repr_html_()
    assert html is not None
    views = pictures(html)
    assert len(views) == 9 and views[0].shape == (2, 250, 3)
    assert 'data-at="0,8"' in html and html.count('type="range"') == 1


def test_plots_show_what_they_say(light_field: lumistack.LightField) -> None:
    ax = light_field.plot((0, 2))
    (image,) = ax.get_images()
    assert image.get_extent() == [-12.0, 12.0, -8.0, 8.0]
    assert numpy.array_equal(image.get_array(), lumistack.srgb(light_field[0, 2]))
    assert light_field.plot(ax=ax) is ax
    stack = light_field.factorize(iterations=5)
    assert light_field.plot((0, 0)).get_title().startswith("view [0, 0], slope (\N{MINUS SIGN}0.1")
    assert light_field.plot((1, 1)).get_title() == "view [1, 1], slope (0.000, 0.000)"
    # `plot` returns axes, since a notebook would show a returned figure twice
    axes = stack.plot(1)
    titles = [one.get_title() for one in axes]
    assert titles == ["layer 0, \N{MINUS SIGN}12 mm", "layer 1, 0 mm", "layer 2, 12 mm", "seen, 2 frames"]
    assert [text.get_text() for text in axes[0].figure.texts] == ["frame 1 of 0 to 1"]
    with pytest.raises(IndexError, match="frame: expected -2 to 1, found 2"):
        stack.plot(2)
    (line,) = stack.plot_history().get_lines()
    assert line.get_ydata().tolist() == [step[2] for step in stack.history]
    with pytest.raises(ValueError, match="expected patterns that factorize"):
        lumistack.LayerStack(stack.layers, stack.display).plot_history()
    pyplot.close("all")


def test_values_that_are_not_finite_are_drawn_without_warnings(light_field: lumistack.LightField) -> None:
    radiance = numpy.array(light_field.radiance)
    radiance[...] = numpy.nan
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        lumistack.LightField(radiance, display=light_field.display).plot()
    pyplot.close("all")


WORK = """
import numpy, lumistack
{before}
display = lumistack.Display("paper-three-layer", resolution=(320, 200), views=(5, 5))
field = lumistack.LightField(numpy.random.default_rng(1).random(display.light_field_shape, numpy.float32), display=display)
lumistack.factorize(field, iterations={iterations})
"""


def output_of(before: str, iterations: int) -> str:
    program = WORK.format(before=before, iterations=iterations)
    done = subprocess.run([sys.executable, "-c", program], stderr=subprocess.PIPE, check=True)
    return done.stderr.decode()


def test_nothing_is_shown_without_a_terminal() -> None:
    assert output_of("", 5) == ""


def test_progress_is_shown_on_request_and_wiped() -> None:
    text = output_of("lumistack.set_progress(True)\nlumistack._progress._PATIENCE = 0.0", 10)
    assert re.search(r"\rfactorize[^\r]*: \d+ %", text), text
    assert text.endswith("\r\x1b[K")


posix = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals of this kind")


def in_terminal(arguments: list[str], variables: dict[str, str] | None = None) -> bytes:
    """Runs Python in a pseudo-terminal, and returns everything that appears there."""
    import pty

    master, slave = pty.openpty()
    environment = {name: value for name, value in os.environ.items() if name != "NO_COLOR"}
    environment |= {"TERM": "xterm", **(variables or {})}
    command = [sys.executable, *arguments]
    with subprocess.Popen(command, env=environment, stdin=slave, stdout=slave, stderr=slave) as running:
        os.close(slave)
        text = b""
        try:
            while part := os.read(master, 4096):
                text += part
        except OSError:  # Linux reports an error once the program has closed the terminal
            pass
        assert running.wait() == 0, text
    os.close(master)
    return text


@posix
def test_a_terminal_shows_progress_without_a_request() -> None:
    program = WORK.format(before="lumistack._progress._PATIENCE = 0.0", iterations=10)
    text = in_terminal(["-c", program])
    assert re.search(rb"\rfactorize[^\r]*: \d+ %", text), text
    assert text.endswith(b"\r\x1b[K")


@posix
def test_the_command_has_colours_only_in_terminals_that_want_them() -> None:
    help_text = ["-m", "lumistack", "run", "--help"]
    plain = subprocess.run([sys.executable, *help_text], stdout=subprocess.PIPE, check=True).stdout
    assert b"Usage:" in plain and b"\x1b" not in plain
    assert b"\x1b[1m" in in_terminal(help_text)
    for variable in ({"NO_COLOR": "1"}, {"TERM": "dumb"}):
        # the width of the terminal decides where lines end
        assert in_terminal(help_text, variable).split() == plain.split()


@posix
def test_the_command_shows_a_bar_in_a_terminal(tmp_path: Path) -> None:
    job = ["--resolution", "64x40", "--views", "3x3", "--iterations", "20", "--output", str(tmp_path / "run")]
    scene = str(Path(__file__).resolve().parents[3] / "scenes/letters/letters.gltf")
    text = in_terminal(["-m", "lumistack", "run", scene, *job])
    assert re.search(rb"\x1b\[[0-9;]*K|\x1b\[2K", text) and b"render" in text, text[-2000:]


def test_a_notebook_shows_a_bar_that_is_emptied(monkeypatch: pytest.MonkeyPatch) -> None:
    pictures: list[str] = []

    class Handle:
        def update(self, html: str) -> None:
            pictures.append(html)

    def display(html: str, display_id: bool) -> Handle:
        assert display_id
        pictures.append(html)
        return Handle()

    # a notebook's IPython has a shell with a kernel
    shell = types.SimpleNamespace(kernel=object())
    of_display = types.SimpleNamespace(display=display, HTML=str)
    monkeypatch.setitem(sys.modules, "IPython", types.SimpleNamespace(get_ipython=lambda: shell))
    monkeypatch.setitem(sys.modules, "IPython.display", of_display)
    monkeypatch.setattr(_progress, "_PATIENCE", 0.0)
    monkeypatch.setattr(_progress, "_PAUSE", 0.0)
    lumistack.set_progress(None)
    display_of_job = lumistack.Display("paper-three-layer", resolution=(160, 100), views=(3, 3))
    values = numpy.random.default_rng(1).random(display_of_job.light_field_shape, numpy.float32)
    lumistack.factorize(lumistack.LightField(values, display=display_of_job), iterations=30)
    assert pictures[0].startswith("<progress max=") and "factorize" in pictures[0], pictures[:2]
    assert pictures[-1] == ""


def test_the_remaining_time_is_shown_after_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    now, texts = [100.0], list[str]()
    monkeypatch.setattr("lumistack._progress.time.monotonic", lambda: now[0])
    monkeypatch.setattr(_progress._Line, "show", lambda self, stage, fraction, text: texts.append(text))
    shown = _progress._Line()
    for seconds, fraction in ((0.8, 0.1), (10.0, 0.25), (40.0, 1.0)):
        now[0] = 100.0 + seconds
        shown("render", fraction)
    # the stage began with the first report
    assert texts == ["render: 10 %", "render: 25 %, 28 s left", "render: 100 %"]


def test_the_remaining_time_has_units() -> None:
    assert [_progress._duration(s) for s in (0.2, 59.2, 61.0, 600.0)] == ["1 s", "59 s", "1 min 01 s", "10 min 00 s"]


def test_pictures_are_whole_files() -> None:
    data = base64.b64decode(_show._png(numpy.zeros((2, 3, 3))).split(",")[1])
    assert data.startswith(b"\x89PNG") and zlib.crc32(b"IEND").to_bytes(4, "big") == data[-4:]

"""Shared fixtures: a small display, a light field of smooth waves at a known depth, and the
repository's scenes."""

from __future__ import annotations

import os
from pathlib import Path

import numpy
import pytest
from numpy.typing import NDArray

import lumistack

ROOT = Path(__file__).resolve().parents[3]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Adds skipped tests to the list of skipped checks of `cargo xtask ci`. In CI they are failures."""
    skips = os.environ.get("LUMISTACK_SKIPPED")
    for report in terminalreporter.stats.get("skipped", []) if skips else []:
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr
        with open(str(skips), "a") as file:
            file.write(f"test {report.nodeid}: {reason}\n".replace("\n", " ").strip() + "\n")


def waves(display: lumistack.Display) -> NDArray[numpy.float32]:
    """Returns views of a plane of waves 6 mm in front of the display. In the view of slope s, content
    at depth z is shifted by -z·s."""
    slope_x, slope_y = display.slopes
    _, _, rows, cols, _ = display.light_field_shape
    x = (numpy.arange(cols) - (cols - 1) / 2) * display.pitch_mm
    y = ((rows - 1) / 2 - numpy.arange(rows)) * display.pitch_mm
    place_x = x[None, :] + 6.0 * numpy.array(slope_x)[:, None]
    place_y = y[None, :] + 6.0 * numpy.array(slope_y)[:, None]
    wave = numpy.sin(0.7 * place_x)[None, :, None, :] * numpy.cos(0.5 * place_y)[:, None, :, None]
    radiance: NDArray[numpy.float32] = (0.5 + 0.4 * wave[..., None] * numpy.array([1.0, 0.6, -0.8])).astype(numpy.float32)
    return radiance


@pytest.fixture
def display() -> lumistack.Display:
    return lumistack.Display(
        {
            "name": "small",
            "frames": 2,
            "brightness": 0.5,
            "field": {"resolution": (24, 16), "pitch_mm": 1.0, "views": (3, 3), "fov_deg": (20.0, 20.0)},
            "layers": [{"d_mm": d, "resolution": (24, 16), "pitch_mm": 1.0} for d in (-12.0, 0.0, 12.0)],
        }
    )


@pytest.fixture
def radiance(display: lumistack.Display) -> NDArray[numpy.float32]:
    return waves(display)


@pytest.fixture
def light_field(display: lumistack.Display, radiance: NDArray[numpy.float32]) -> lumistack.LightField:
    return lumistack.LightField(radiance, display=display)


@pytest.fixture
def scene() -> Path:
    return ROOT / "scenes" / "letters" / "letters.gltf"


@pytest.fixture
def slow() -> tuple[lumistack.LightField, lumistack.Display]:
    """The light field and display of a factorization that takes minutes unless it is stopped."""
    display = lumistack.Display("paper-three-layer", resolution=(320, 200))
    return lumistack.LightField(waves(display), display=display), display

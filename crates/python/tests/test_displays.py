"""Displays: made from presets, files and mappings, changed by arguments, and their properties."""

from __future__ import annotations

import copy
import math
import pickle
from pathlib import Path

import numpy
import pytest

import lumistack
from lumistack import Display


def test_every_preset_makes_a_display() -> None:
    assert "paper-three-layer" in lumistack.displays()
    for name in lumistack.displays():
        display = Display(name)
        assert display.frames >= 1 and display.name and name
    assert Display() == Display("paper-three-layer")


def test_a_display_is_what_its_numbers_say() -> None:
    display = Display("paper-three-layer", resolution=(84, 52), views=(3, 2), fov_deg=(10, 8), frames=5, brightness=0.3)
    assert display.light_field_shape == (2, 3, 52, 84, 3)
    assert display.layer_shapes == ((5, 52, 84, 3),) * 3
    assert display.layer_distances_mm == (-40.0, 0.0, 40.0)
    assert (display.frames, display.brightness, display.emission_shape, display.distance_mm) == (5, 0.3, None, None)
    slope_x, slope_y = display.slopes
    step = 2 / 3 * numpy.tan(numpy.radians(5))
    assert slope_x == pytest.approx([-step, 0, step])
    assert slope_y == pytest.approx([numpy.tan(numpy.radians(4)) / 2, -numpy.tan(numpy.radians(4)) / 2])
    assert display.pitch_mm == pytest.approx(10 * Display("paper-three-layer").pitch_mm)
    low, high = display.depth_of_field_mm() or (0, 0)
    assert low == pytest.approx(-high) and high > 0


def test_a_directional_backlight_has_an_emission() -> None:
    shape = Display("fig7-directional").emission_shape
    assert shape is not None and len(shape) == 6 and shape[-1] == 3
    assert "directional" in repr(Display("fig7-directional"))


def test_displays_survive_dictionaries_files_pickles_and_copies(tmp_path: Path) -> None:
    display = Display("fig7-directional", frames=3)
    display.save(tmp_path / "d.toml")
    same = [
        Display(display),
        Display(display.to_dict()),
        Display(tmp_path / "d.toml"),
        Display(str(tmp_path / "d.toml")),
        pickle.loads(pickle.dumps(display)),
        copy.copy(display),
        copy.deepcopy(display),
    ]
    assert all(other == display for other in same)
    assert len({display, *same, Display("fig7-directional")}) == 2
    assert display != Display("fig7-directional") and display != "fig7-directional"
    assert display.to_toml() == (tmp_path / "d.toml").read_text()


def test_no_slope_is_minus_zero(light_field: lumistack.LightField, display: Display) -> None:
    for slopes in (*display.slopes, light_field.slope_x, light_field.slope_y):
        assert 0.0 in slopes and all(math.copysign(1.0, slope) > 0.0 for slope in slopes if slope == 0.0)


def test_settings_take_numbers_of_numpy() -> None:
    display = Display(resolution=numpy.array([64, 40]), frames=numpy.int64(4), brightness=numpy.float32(0.25))  # type: ignore[arg-type]
    assert (display.light_field_shape[2:], display.frames, display.brightness) == ((40, 64, 3), 4, 0.25)


def test_a_display_adapts_to_a_light_field(light_field: lumistack.LightField) -> None:
    adapted = Display("paper-three-layer").adapted_to(light_field)
    assert adapted.light_field_shape == light_field.shape
    assert adapted.pitch_mm == light_field.pitch_mm
    assert adapted.slopes[0] == pytest.approx(light_field.slope_x)

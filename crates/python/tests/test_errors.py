"""Errors: their classes, and messages with the expected and the found value."""

from __future__ import annotations

import base64
import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy
import pytest

import lumistack
from lumistack import Display, LayerStack, LightField, Scene


def test_classes_fit_what_python_programs_catch() -> None:
    assert issubclass(lumistack.MissingFileError, FileNotFoundError)
    assert issubclass(lumistack.FileError, OSError)
    assert issubclass(lumistack.SettingError, ValueError)
    for name in lumistack.__all__:
        thing = getattr(lumistack, name)
        if isinstance(thing, type) and issubclass(thing, Exception) and not issubclass(thing, Warning):
            assert issubclass(thing, lumistack.Error) and thing.__module__ == "lumistack" and thing.__doc__


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("no-such-display",), "expected a preset or a .toml file; lumistack.displays\\(\\) lists the presets"),
        (("paper-three-layers",), "did you mean `paper-three-layer`"),
    ],
)
def test_unknown_displays(arguments: tuple[Any, ...], message: str) -> None:
    with pytest.raises(lumistack.SettingError, match=message):
        Display(*arguments)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frames": 0}, "frames: expected 1 to 1000, found 0"),
        ({"frames": 2.5}, "display: frames: expected a whole number above 0, found 2.5"),
        ({"frames": "two"}, "display: frames: expected a whole number above 0, found the text"),
        ({"brightness": 1.5}, "brightness: expected a number above 0 and at most 1, found 1.5"),
        ({"brightness": float("nan")}, "expected a finite number"),
        ({"resolution": (0, 4)}, "^display: resolution: expected at least"),
        ({"resolution": (64, 40, 3)}, "resolution: expected a list of 2 values, found a list of length 3"),
        ({"resolution": 4}, "display: resolution: expected a list of 2 values, found 4"),
        ({"sampling": "nearesst"}, "display: sampling: expected .*found `nearesst`; did you mean `nearest`"),
    ],
)
def test_wrong_changes_of_displays(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(lumistack.SettingError, match=message):
        Display("paper-three-layer", **changes)


def test_wrong_mappings_and_files(tmp_path: Path, display: Display) -> None:
    with pytest.raises(lumistack.SettingError, match="unknown field `framse`.*did you mean `frames`"):
        Display({**display.to_dict(), "framse": 3})
    with pytest.raises(lumistack.SettingError, match="layers: expected at least one layer"):
        Display({**display.to_dict(), "layers": []})
    with pytest.raises(lumistack.MissingFileError, match="nowhere.toml: expected a readable file"):
        Display(tmp_path / "nowhere.toml")
    (tmp_path / "bad.toml").write_text("name = 3")
    with pytest.raises(lumistack.SettingError, match="line 1, column 8"):
        Display(tmp_path / "bad.toml")
    with pytest.raises(TypeError, match="^display: expected a Display, a name, a file or a mapping, found int"):
        Display(3)  # type: ignore[arg-type]
    with pytest.raises(TypeError):
        Display(paper=True)  # type: ignore[call-arg]


def test_missing_files_are_not_found(tmp_path: Path) -> None:
    for call in (
        lambda: Scene(tmp_path / "no.glb"),
        lambda: lumistack.render(tmp_path / "no.glb"),
        lambda: LightField.open(tmp_path / "no.npy", pitch_mm=1.0),
        lambda: LayerStack.open(tmp_path / "no"),
        lambda: lumistack.run(tmp_path / "no.toml"),
        lambda: lumistack.info(tmp_path / "no.npy"),
    ):
        with pytest.raises(FileNotFoundError, match="no"):
            call()


def test_folders_that_are_files(light_field: LightField, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    stack = lumistack.factorize(light_field, iterations=0)
    for call in (
        lambda: light_field.save(tmp_path / "taken"),
        lambda: stack.save(tmp_path / "taken"),
        lambda: lumistack.report(stack, light_field, tmp_path / "taken"),
        lambda: display_save(stack.display, tmp_path / "taken" / "d.toml"),
    ):
        with pytest.raises(OSError, match="taken"):
            call()
    with pytest.raises(lumistack.PluginError, match="expected a folder, or a name for a new folder"):
        lumistack.write(stack, "images", tmp_path / "taken")


def display_save(display: Display, path: Path) -> None:
    display.save(path)


def test_broken_scenes(tmp_path: Path) -> None:
    (tmp_path / "bad.glb").write_bytes(b"glTF broken")
    with pytest.raises(lumistack.SceneError, match="bad.glb"):
        Scene(tmp_path / "bad.glb")
    (tmp_path / "x.docx").write_bytes(b"")
    with pytest.raises(lumistack.SettingError, match="expected a file with the extension .gltf, .glb"):
        Scene(tmp_path / "x.docx")


def test_wrong_settings_of_rendering(scene: Path) -> None:
    loaded = Scene(scene)
    for settings, message in (
        ({"samples": 0}, "^render: samples: expected 1 to 65536, found 0"),
        ({"samples": 1.5}, "render: samples: expected a whole number above 0, found 1.5"),
        ({"denoise": "strong"}, "render: denoise: expected one of auto, off, .*, found `strong`"),
        ({"lens_deg": 91}, "^render: lens_deg: expected 0 to 90, found 91"),
        ({"camera": "Nobody"}, "window.camera: expected a camera's name"),
        ({"depth_scale": 0}, "^render: depth_scale"),
        ({"window": {"form": "bounds"}}, "unknown field `form`.*did you mean `from`"),
        ({"tone": "film"}, "^render: tone: expected one of auto, .*, found `film`"),
        ({"zone_directions": 5}, "^render: zone_directions: expected 0, or 32 to 4096, found 5"),
        ({"light": {"automatic": False}}, "light.automatic: expected the value with which the Scene was loaded"),
        ({"window": 3}, "window: expected a mapping"),
    ):
        with pytest.raises((lumistack.SettingError, TypeError), match=message):
            lumistack.render(loaded, "fig7-uniform", **settings)


def test_wrong_settings_of_factorization(light_field: LightField, display: Display) -> None:
    for settings, error, message in (
        ({"solver": "newton"}, lumistack.SettingError, "solver: expected one of .*found newton"),
        ({"start": "middle"}, lumistack.SettingError, "^factorize: start: expected one of"),
        ({"iterations": -1}, lumistack.SettingError, "factorize: iterations: expected a whole number, 0 or more, found -1"),
        ({"brightness": 0.0}, lumistack.SettingError, "brightness: expected a number above 0"),
        ({"frames": 0}, lumistack.SettingError, "frames: expected 1 to 1000"),
        ({"weights": numpy.ones((2, 2), "f4")}, lumistack.SettingError, r"^weights: expected shape \[3, 3\]"),
        ({"weights": numpy.ones(3, "f4")}, lumistack.SettingError, r"weights: shape: expected an array \[view_y\]"),
        ({"weights": -numpy.ones((3, 3), "f4")}, lumistack.SettingError, "finite values ≥ 0"),
        ({"weights": numpy.zeros((3, 3), "f4")}, lumistack.SettingError, "at least one weight above 0, found 0 everywhere"),
        ({"weights": numpy.ones((3, 3), int)}, TypeError, "weights: expected an array of float32"),
        ({"eyes": [{"eye_mm": (0, 0, -5), "sigma_mm": 1}]}, lumistack.SettingError, "^factorize: eyes"),
        ({"eyes": [{"eye": 3}]}, lumistack.SettingError, "unknown field `eye`"),
        ({"iteration": 3}, TypeError, "iteration"),
    ):
        with pytest.raises(error, match=message):
            lumistack.factorize(light_field, display, **settings)


def test_values_that_are_no_light(radiance: Any, display: Display, tmp_path: Path) -> None:
    radiance[1, 2, 3, 4, 0] = numpy.nan
    bad = LightField(radiance, display=display)
    place = r"^light_field, view \[1, 2\], row 3, column 4, red: expected a finite value, found NaN; replace .* numpy.nan_to_num"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(lumistack.FactorizeError, match=place):
            lumistack.factorize(bad, iterations=1)
        stack = LayerStack([numpy.zeros(shape, "f4") for shape in display.layer_shapes], display)
        with pytest.raises(lumistack.DataError, match=place):
            lumistack.report(stack, bad, tmp_path)


def test_arguments_of_a_wrong_type_are_named(light_field: LightField, radiance: Any, display: Display, scene: Path) -> None:
    stack = lumistack.factorize(light_field, iterations=0)
    wanted = "^{}: expected a LightField, found ndarray; LightField\\(array, display=display\\) makes a LightField"
    cloud = {"positions": numpy.zeros((1, 3)), "scales": numpy.ones((1, 3)), "opacities": [1.0], "harmonics": numpy.ones((1, 1, 3))}
    without_cameras = Scene.from_splats({name: numpy.asarray(values) for name, values in cloud.items()})
    calls: list[tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any], str]] = [
        (lumistack.factorize, (radiance,), {}, wanted.format("light_field")),
        (lumistack.report, (stack, radiance, "x"), {}, wanted.format("light_field")),
        (lumistack.write, (stack, "images", "x"), {"target": radiance}, wanted.format("target")),
        (stack.psnr, (radiance,), {}, wanted.format("light_field")),
        (stack.psnr_zone, (radiance,), {}, wanted.format("references")),
        (stack.views, (radiance,), {}, wanted.format("like")),
        (stack.weights, (radiance,), {}, wanted.format("light_field")),
        (display.adapted_to, (radiance,), {}, wanted.format("light_field")),
        (lumistack.simulate, (radiance,), {}, "^stack: expected a LayerStack, found ndarray"),
        (lumistack.factorize, (light_field,), {"warm_start": radiance}, "^warm_start: expected a LayerStack"),
        (lumistack.factorize, (light_field,), {"frames": 2.0}, "^frames: expected a whole number above 0, found 2.0"),
        (lumistack.render, (scene, (64, 40)), {}, "^display: expected a Display, a name, a file or a mapping, found tuple"),
        (lumistack.render, (3,), {}, "^scene: expected a Scene, a path or an OpenUSD stage, found int"),
        (lumistack.render, (without_cameras,), {"camera": "x"}, "camera: expected no value, since the scene has no cameras, found x"),
        (light_field.exposed, ("1",), {}, "^exposure_ev: expected a number"),
        (LightField, (radiance, display), {}, "pass the others by name, such as display="),
        (LightField, (radiance.tolist(),), {"display": display}, r"found list; numpy\.asarray\(\.\.\.\) makes an array"),
        (LightField.open, ("x.npy",), {"slope_x": [0.0]}, r"LightField\(numpy\.load\(path\), slope_x="),
        (lumistack.set_threads, (0,), {}, "expected 1 or more, found 0"),
        (lumistack.set_threads, (2,), {}, "call set_threads before all other functions of the package"),
    ]
    for call, arguments, named, message in calls:
        with pytest.raises((TypeError, lumistack.SettingError), match=message):
            call(*arguments, **named)


def test_geometry_of_arrays(radiance: Any) -> None:
    for how, message in (
        ({}, "expected `display`, or `pitch_mm`"),
        ({"pitch_mm": 1.0}, "expected either `fov_deg` or"),
        ({"pitch_mm": 1.0, "fov_deg": (20, 20), "slope_x": [0, 0, 0]}, "expected either `fov_deg` or"),
        ({"pitch_mm": 0.0, "fov_deg": (20, 20)}, "pitch_mm: expected a number above 0, found 0"),
        ({"pitch_mm": 1.0, "fov_deg": (180, 20)}, "fov_deg: expected full angles"),
        ({"pitch_mm": 1.0, "slope_x": [0.0], "slope_y": [0.0]}, "expected the shape that the geometry has"),
        ({"pitch_mm": 1.0, "fov_deg": (20, 20), "distance_mm": -1.0}, "distance_mm: expected a viewing distance"),
        ({"display": "paper-three-layer"}, "expected views of 525 × 840 pixels"),
        ({"display": "paper-three-layer", "pitch_mm": 1.0}, "found both"),
    ):
        with pytest.raises((lumistack.SettingError, lumistack.DataError), match=message):
            LightField(radiance, **how)


def test_patterns_that_do_not_fit(light_field: LightField, display: Display) -> None:
    layers = [numpy.zeros(shape, "f4") for shape in display.layer_shapes]
    with pytest.raises(lumistack.DataError, match="layers: expected 3, found 2"):
        LayerStack(layers[:2], display)
    with pytest.raises(lumistack.DataError, match="of layer 1: expected"):
        LayerStack([layers[0], layers[1][:, 1:], layers[2]], display)
    layers[2][0, 0, 0, 0] = 1.5
    with pytest.raises(lumistack.DataError, match="layer 2: expected values in 0..1, found 1.5"):
        LayerStack(layers, display)
    with pytest.raises(TypeError, match=r"layers\[0\]: expected an array with the axes \[frame, row, col, rgb\]"):
        LayerStack([numpy.zeros(3, "f4")], display)
    stack = lumistack.factorize(light_field, iterations=0)
    other = Display("paper-three-layer", resolution=(12, 8))
    field = LightField(numpy.zeros(other.light_field_shape, "f4"), display=other)
    with pytest.raises(lumistack.DataError, match="warm_start"):
        lumistack.factorize(field, warm_start=stack)


def test_viewpoints(light_field: LightField) -> None:
    stack = lumistack.factorize(light_field, iterations=0)
    for how, message in (
        ({"slope": (0, 0), "eye_mm": (0, 0, 1)}, "found several"),
        ({"angle_deg": (90, 0)}, "angle_deg: expected angles between -90 and 90"),
        ({"eye_mm": (0, 0, 0)}, "eye_mm: expected finite numbers, with a distance z above 0"),
        ({"slope": (float("nan"), 0)}, "expected a finite number"),
        ({"slope": (0, 0, 0)}, "slope: "),
        ({"eye_mm": "here"}, "eye_mm: expected a list of 3 values in millimetres, found the text"),
    ):
        with pytest.raises(lumistack.SettingError, match=message):
            lumistack.simulate(stack, **how)


def test_jobs(tmp_path: Path) -> None:
    with pytest.raises(lumistack.SettingError, match="unknown field `scen`.*did you mean `scene`"):
        lumistack.run({"scen": "a.glb"}, tmp_path)
    with pytest.raises(lumistack.SettingError, match="^job: scene: expected a path, found a mapping"):
        lumistack.run({"scene": {"path": "a.glb"}}, tmp_path)
    with pytest.raises(lumistack.SettingError, match="^job: expected a value for `display`, found none"):
        lumistack.run({"scene": "a.glb"}, tmp_path)
    with pytest.raises(lumistack.SettingError, match="expected exactly one of `scene`, `light_field` and `source`"):
        lumistack.run({"display": {"preset": "fig7-uniform"}}, tmp_path)
    with pytest.raises(TypeError, match=r"\w: expected strings \(str\) as keys"):
        lumistack.run({3: 4}, tmp_path)  # type: ignore[dict-item]
    with pytest.raises(TypeError, match="expected a number, a text, a path"):
        lumistack.run({"scene": object()}, tmp_path)


def test_warnings_are_warnings_of_python(display: Display) -> None:
    # The multiplicative solver keeps equal frames equal, so it warns.
    equal = LayerStack([numpy.full(shape, 0.5, "f4") for shape in display.layer_shapes], display)
    field = LightField(numpy.full(display.light_field_shape, 0.2, "f4"), display=display)
    with pytest.warns(lumistack.LumistackWarning, match="warm start: all frames are equal"):
        lumistack.factorize(field, solver="multiplicative", warm_start=equal, iterations=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(lumistack.LumistackWarning):
            lumistack.factorize(field, solver="multiplicative", warm_start=equal, iterations=1)


def test_warnings_speak_python(tmp_path: Path) -> None:
    # the lamp shines away from the triangle
    corners = base64.b64encode(numpy.array([0, 0, 0, 1, 0, 0, 0, 1, 0], "<f4").tobytes()).decode()
    lamp = {"KHR_lights_punctual": {"light": 0}}
    scene = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_lights_punctual"],
        "extensions": {"KHR_lights_punctual": {"lights": [{"type": "spot", "spot": {}}]}},
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0}, {"translation": [0, 0, 50], "rotation": [0, 1, 0, 0], "extensions": lamp}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, "uri": f"data:application/octet-stream;base64,{corners}"}],
    }
    (tmp_path / "dark.gltf").write_text(json.dumps(scene))
    with pytest.warns(lumistack.LumistackWarning, match='light={"automatic": False} prevents the studio light'):
        lumistack.render(tmp_path / "dark.gltf", Display("fig7-uniform", resolution=(8, 5)), samples=1)


def test_values_that_no_display_shows_are_named_and_can_be_brought_into_range(light_field: LightField, display: Display, tmp_path: Path) -> None:
    radiance = numpy.array(light_field.radiance)
    radiance[1, 1, 3, 5, 0] = 1e4
    bright = LightField(radiance, display=display)
    share = r"values above 1: 1 of \d+ values; the largest value is 10000.*light_field\.exposed"
    with pytest.warns(lumistack.LumistackWarning, match=share):
        stack = lumistack.factorize(bright, iterations=2)
    measured = lumistack.report(stack, bright, tmp_path / "bright")
    assert any("values above 1" in warning["message"] for warning in measured["warnings"])
    assert measured["psnr_view"] < 0.0, "one ray decides the figure, and the report says so"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        clipped = bright.exposed()
        stack = lumistack.factorize(clipped, iterations=2)
        measured = lumistack.report(stack, clipped, tmp_path / "clipped")
    assert measured["psnr_view"] > 10.0
    assert numpy.asarray(clipped.radiance).max() == 1.0
    half = numpy.asarray(light_field.exposed(-1.0).radiance)
    numpy.testing.assert_allclose(half, 0.5 * numpy.asarray(light_field.radiance), rtol=1e-6)
    with pytest.raises(lumistack.SettingError, match="tone: expected one of linear, khronos-neutral, agx, found `log`"):
        light_field.exposed(tone="log")  # type: ignore[arg-type]


def test_a_directional_backlight_follows_the_light_field() -> None:
    field = LightField(numpy.full((5, 5, 20, 32, 3), 0.5, "f4"), pitch_mm=2.0, fov_deg=(20.0, 20.0))
    adapted = Display("fig7-directional").adapted_to(field)
    assert adapted.emission_shape is not None and adapted.emission_shape[1:3] == (5, 5)
    with pytest.warns(lumistack.LumistackWarning, match="the directional backlight is adapted to the light field: 5 × 5 bins"):
        lumistack.factorize(field, "fig7-directional", iterations=1)
    slopes = [0.001 * i for i in range(17)]
    fan = LightField(numpy.zeros((17, 17, 20, 32, 3), "f4"), pitch_mm=20.0, slope_x=slopes, slope_y=slopes[::-1], distance_mm=500.0)
    with pytest.raises(lumistack.SettingError, match="17 views whose slopes are 0.0010 apart"):
        Display("fig7-directional").adapted_to(fan)

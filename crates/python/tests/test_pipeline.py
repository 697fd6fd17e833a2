"""Tests the way from a scene to a light field, to patterns and to pictures in memory, and the
written files."""

from __future__ import annotations

import copy
import json
import math
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy
import pytest

import lumistack
from lumistack import Display, LayerStack, LightField, Scene

SMALL = {"resolution": (42, 26), "views": (3, 3), "frames": 2}


def emitted(stack: LayerStack, light_field: LightField) -> Any:
    """Returns the emitted light field by a naive forward model. Each ray reads the nearest pixel of
    every layer; its light is the mean over the frames of the product of these values. Also returns
    True for each ray that hits all layers."""
    view_rows, view_cols, rows, cols, _ = light_field.shape
    shown = numpy.zeros(light_field.shape)
    counts = numpy.ones(light_field.shape[:4], bool)
    for vy in range(view_rows):
        for vx in range(view_cols):
            product = numpy.ones((stack.frames, rows, cols, 3))
            for layer, d in zip(stack.layers, stack.display.layer_distances_mm):
                c = numpy.floor(numpy.arange(cols) + d * light_field.slope_x[vx] / light_field.pitch_mm + 0.5).astype(int)
                r = numpy.floor(numpy.arange(rows) - d * light_field.slope_y[vy] / light_field.pitch_mm + 0.5).astype(int)
                inside = ((r >= 0) & (r < rows))[:, None] & ((c >= 0) & (c < cols))[None, :]
                counts[vy, vx] &= inside
                product *= layer[:, numpy.clip(r, 0, rows - 1)][:, :, numpy.clip(c, 0, cols - 1)]
            shown[vy, vx] = product.mean(axis=0)
    shown[~counts] = 0.0
    return shown, counts


def test_patterns_show_what_the_forward_model_says(light_field: LightField, display: Display) -> None:
    stack = lumistack.factorize(light_field, display, iterations=10)
    shown, counts = emitted(stack, light_field)
    assert numpy.allclose(stack.views(light_field, raw=True).radiance, shown, atol=1e-6)
    assert numpy.allclose(stack.views(light_field).radiance, shown / stack.brightness, atol=2e-6)
    error = (shown / stack.brightness - light_field.radiance)[counts]
    psnr = -10 * math.log10(float((error**2).mean()))
    assert stack.psnr(light_field) == pytest.approx(psnr, abs=1e-3)
    assert stack.psnr(light_field, raw=True) == pytest.approx(psnr - 20 * math.log10(0.5), abs=1e-3)
    assert stack.history[-1][2] == pytest.approx(psnr, abs=1e-3)
    assert psnr > 25 and stack.history[-1][1] < stack.history[0][1]
    for layer, shape in zip(stack.layers, display.layer_shapes):
        assert layer.shape == shape and layer.min() >= 0 and layer.max() <= 1


def test_a_picture_is_a_seen_view(light_field: LightField) -> None:
    stack = lumistack.factorize(light_field, iterations=3)
    views = stack.views(light_field).radiance
    # At slope 0 the layers' pixels are aligned, so all rays of a pixel have the same value. So the
    # seen picture, a mean over each pixel's area, equals the view of rays through the pixels'
    # centres.
    assert numpy.allclose(lumistack.simulate(stack), views[1, 1], atol=1e-6)
    slope = (light_field.slope_x[2], light_field.slope_y[0])
    seen = lumistack.simulate(stack, slope)
    degrees = tuple(math.degrees(math.atan(s)) for s in slope)
    assert numpy.allclose(lumistack.simulate(stack, angle_deg=degrees), seen, atol=1e-6)
    far = lumistack.simulate(stack, eye_mm=(slope[0] * 1e9, slope[1] * 1e9, 1e9))
    assert numpy.allclose(far, seen, atol=1e-5)
    raw = lumistack.simulate(stack, slope, raw=True)
    assert numpy.allclose(raw / stack.brightness, seen, atol=1e-6) and raw.dtype == numpy.float32
    # The expected picture is the mean of 9 × 9 rays per pixel. Pixels at the border are excluded,
    # since some of their rays miss a layer.
    rows, cols, _ = seen.shape
    fine = numpy.zeros((1, 1, 9 * rows, 9 * cols, 3), numpy.float32)
    like = LightField(fine, pitch_mm=light_field.pitch_mm / 9, slope_x=[slope[0]], slope_y=[slope[1]])
    mean = stack.views(like).radiance[0, 0].reshape(rows, 9, cols, 9, 3).mean(axis=(1, 3))
    inner = (slice(3, -3), slice(3, -3))
    assert numpy.abs(mean - seen)[inner].mean() < 0.01 < numpy.abs(views[0, 2] - seen)[inner].mean()


def test_settings_reach_the_solver(light_field: LightField, display: Display) -> None:
    paper = lumistack.factorize(light_field, solver="multiplicative", iterations=4, seed=3)
    assert paper.solution == {
        "solver": "multiplicative",
        "start": "random",
        "coarse_levels": 0,
        "kkt_residual": pytest.approx(paper.solution["kkt_residual"] if paper.solution else 0),
        "levels": None,
    }
    assert [step[0] for step in paper.history] == [0, 1, 2, 3, 4]
    again = lumistack.factorize(light_field, solver="multiplicative", iterations=4, seed=3)
    other = lumistack.factorize(light_field, solver="multiplicative", iterations=4, seed=4)
    assert all(numpy.array_equal(a, b) for a, b in zip(paper.layers, again.layers))
    assert not numpy.array_equal(paper.layers[0], other.layers[0])
    changed = lumistack.factorize(light_field, display, brightness=0.25, frames=3, iterations=1)
    assert (changed.brightness, changed.frames, changed.display.brightness) == (0.25, 3, 0.25)
    assert display.frames == 2
    warm = lumistack.factorize(light_field, iterations=1, warm_start=paper)
    assert warm.history[0][2] == pytest.approx(paper.history[-1][2], abs=1e-3)
    eyes = lumistack.factorize(light_field, iterations=2, eyes=[{"eye_mm": (0, 0, 500), "sigma_mm": 30}], eye_floor=0.01)
    assert not numpy.array_equal(eyes.layers[0], lumistack.factorize(light_field, iterations=2).layers[0])


def test_patterns_are_made_from_arrays_too(light_field: LightField, display: Display) -> None:
    stack = lumistack.factorize(light_field, iterations=2)
    same = LayerStack([layer.astype("f8") for layer in stack.layers], display)
    assert same.psnr(light_field) == stack.psnr(light_field)
    assert same.history == [] and same.solution is None and same.emission is None
    assert [memoryview(a).shape for a in same.arrays] == list(display.layer_shapes)
    grey = LayerStack([numpy.full(shape, 0.5, "f4") for shape in display.layer_shapes], display, brightness=1.0)
    assert lumistack.simulate(grey)[8, 12] == pytest.approx([0.125] * 3)


def test_a_directional_backlight_goes_both_ways() -> None:
    display = Display("fig7-directional", resolution=(32, 20), frames=2)
    light_field = LightField(numpy.full(display.light_field_shape, 0.25, "f4"), display=display)
    stack = lumistack.factorize(light_field, iterations=3)
    assert stack.emission is not None and stack.emission.shape == display.emission_shape
    same = LayerStack(stack.layers, stack.display, emission=stack.emission, brightness=stack.brightness)
    assert numpy.array_equal(lumistack.simulate(same), lumistack.simulate(stack))
    with pytest.raises(lumistack.DataError, match="shape of the emission"):
        LayerStack(stack.layers, stack.display)


def test_light_fields_and_patterns_survive_files_and_pickles(light_field: LightField, tmp_path: Path) -> None:
    light_field.save(tmp_path / "views", info={"note": "waves"})
    read = LightField.open(tmp_path / "views")
    assert read.shape == light_field.shape and read.slope_x == pytest.approx(light_field.slope_x)
    assert numpy.allclose(read.radiance, light_field.radiance, rtol=1e-3)
    assert read.info == {"note": "waves"} and read.display == light_field.display
    info = json.loads((tmp_path / "views" / "lightfield.json").read_text())["info"]
    assert info["note"] == "waves" and info["display"]["name"] == "small"
    stack = lumistack.factorize(light_field, iterations=2)
    stack.save(tmp_path / "run")
    for other in (
        LayerStack.open(tmp_path / "run"),
        LayerStack.open(tmp_path / "run" / "layers", display=stack.display),
        pickle.loads(pickle.dumps(stack)),
        copy.deepcopy(stack),
    ):
        assert all(numpy.array_equal(a, b) for a, b in zip(stack.layers, other.layers))
        assert (other.display, other.brightness) == (stack.display, stack.brightness)
    for same in (pickle.loads(pickle.dumps(light_field)), copy.copy(light_field)):
        assert numpy.array_equal(same.radiance, light_field.radiance)
        assert (same.slope_x, same.slope_y, same.pitch_mm) == (light_field.slope_x, light_field.slope_y, 1.0)


def test_an_array_file_takes_its_geometry_from_arguments(radiance: Any, tmp_path: Path) -> None:
    numpy.save(tmp_path / "views.npy", radiance)
    read = LightField.open(tmp_path / "views.npy", pitch_mm=0.5, fov_deg=(10, 10), distance_mm=600, grid="perspective")
    assert (read.pitch_mm, read.distance_mm) == (0.5, 600.0) and "perspective" in repr(read)
    with pytest.raises(lumistack.DataError, match=r"state the value with pitch_mm, for example pitch_mm=0\.5"):
        LightField.open(tmp_path / "views.npy")
    with pytest.warns(lumistack.LumistackWarning, match="fov_deg sets other angles"):
        LightField.open(tmp_path / "views.npy", display="fig7-uniform")


def test_geometry_of_an_array_may_be_slopes(radiance: Any) -> None:
    uneven = LightField(radiance, pitch_mm=1.0, slope_x=[-0.2, 0.0, 0.1], slope_y=[0.1, 0.0, -0.1])
    assert uneven.slope_x == [-0.2, 0.0, 0.1]
    same = LightField(radiance, pitch_mm=1.0, slope_x=numpy.array(uneven.slope_x), slope_y=tuple(uneven.slope_y))
    assert (same.slope_x, same.slope_y) == (uneven.slope_x, uneven.slope_y)
    assert lumistack.factorize(uneven, "paper-three-layer", frames=1, iterations=1).frames == 1


def test_a_scene_becomes_a_light_field(scene: Path, tmp_path: Path) -> None:
    display = Display("paper-three-layer", **SMALL)  # type: ignore[arg-type]
    loaded = Scene(scene)
    assert loaded.triangles > 1000 and loaded.cameras and loaded.materials and loaded.path == scene
    low, high = loaded.bounds
    assert all(a < b for a, b in zip(low, high)) and (loaded.animations, loaded.variants) == ([], [])
    stages: list[tuple[str, float]] = []
    first = lumistack.render(loaded, display, samples=2, max_bounces=2, callback=lambda *news: stages.append(news))
    assert first.shape == display.light_field_shape and first.display == display
    assert 0.05 < first.radiance.mean() < 0.95 and first.radiance.max() <= 1.0
    assert first.info["tone"] in ("linear", "khronos-neutral", "agx") and first.info["exposure"] > 0
    assert ("render", 1.0) in stages and all(0 <= share <= 1 for _, share in stages)
    kept = lumistack.render(scene, display, samples=2, max_bounces=2, cache=tmp_path / "cache")
    assert numpy.array_equal(first.radiance, kept.radiance), "the same seed, the same values"
    assert list((tmp_path / "cache").iterdir())
    darker = lumistack.render(loaded, display, samples=2, max_bounces=2, exposure_ev=-2.0, tone="linear")
    assert darker.radiance.mean() < 0.5 * first.radiance.mean()
    stack = lumistack.factorize(first, iterations=5)
    assert stack.display.light_field_shape == first.shape and stack.psnr(first) > 12


def test_rendering_leaves_nothing_behind(scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    lumistack.render(scene, Display("fig7-uniform", resolution=(16, 10), views=(1, 1)), samples=1, max_bounces=0)
    assert list(tmp_path.iterdir()) == []


def test_a_job_runs_as_it_does_from_a_file(scene: Path, tmp_path: Path) -> None:
    job: dict[str, Any] = {
        "scene": scene,
        "display": {"preset": "paper-three-layer", "resolution": (42, 26), "views": (3, 3), "frames": 2},
        "render": {"samples": 1, "max_bounces": 1, "held_out": 0, "outside": 0},
        "factorize": {"iterations": 2},
        "outputs": [{"plugin": "quilt", "from": "light_field"}],
    }
    stages = set()
    summary = lumistack.run(job, tmp_path / "a", callback=lambda stage, share: stages.add(stage))
    assert Path(summary["report"]).is_file() and math.isfinite(summary["psnr_view"])
    assert {"render", "factorize", "report"} <= stages
    again = lumistack.run(tmp_path / "a" / "job.toml", tmp_path / "b")
    assert again["psnr_view"] == summary["psnr_view"]
    stack = LayerStack.open(tmp_path / "a")
    target = LightField.open(tmp_path / "a")
    assert stack.psnr(target) == pytest.approx(summary["psnr_view"], abs=1e-6)
    # Calls of render, factorize and so on give the results of the run.
    rendered = lumistack.render(scene, Display(stack.display), samples=1, max_bounces=1)
    assert numpy.array_equal(rendered.radiance, target.radiance)
    made = lumistack.factorize(rendered, iterations=2)
    assert all(numpy.array_equal(a, b) for a, b in zip(made.layers, stack.layers))
    info = lumistack.info(tmp_path / "a")
    assert info["result"]["psnr_view"] == summary["psnr_view"]


def test_plugins_write(light_field: LightField, tmp_path: Path) -> None:
    stack = lumistack.factorize(light_field, iterations=2)
    known = {plugin["id"]: plugin for plugin in lumistack.plugins()}
    assert {"images", "quilt", "web_simulator"} <= set(known)
    assert all(param["help"] for param in known["images"]["params"])
    files = lumistack.write(stack, "images", tmp_path / "images", png16=True)
    assert files and all((tmp_path / "images" / file).is_file() for file in files)
    assert lumistack.write(light_field, "quilt", tmp_path / "quilt")
    assert lumistack.write(stack, "web_simulator", tmp_path / "web", target=light_field)
    with pytest.raises(lumistack.PluginError, match="did you mean `images`"):
        lumistack.write(stack, "imagse", tmp_path / "x")
    with pytest.raises(lumistack.PluginError, match="unknown parameter `png61`"):
        lumistack.write(stack, "images", tmp_path / "x", png61=True)
    assert not (tmp_path / "x").exists()


def test_a_report_measures_patterns(light_field: LightField, tmp_path: Path) -> None:
    stack = lumistack.factorize(light_field, iterations=3)
    report = lumistack.report(stack, light_field, tmp_path / "report", title="waves")
    assert report["psnr_view"] == pytest.approx(stack.psnr(light_field), abs=1e-6)
    assert report["title"] == "waves" and report["solution"]["solver"] == "extrapolated"
    assert json.loads((tmp_path / "report" / "report.json").read_text()) == report
    assert "waves" in (tmp_path / "report" / "report.html").read_text()


def test_defaults_are_those_of_jobs_and_docstrings_say_them_right() -> None:
    defaults = lumistack.defaults()
    assert defaults["render"]["zone_samples"] == "auto" and defaults["factorize"]["solver"] == "auto"
    assert lumistack.run.__doc__ and lumistack.render.__doc__ and "1 to 65536" in lumistack.render.__doc__


def test_the_number_of_threads_changes_nothing(tmp_path: Path) -> None:
    program = """
import sys, numpy, lumistack
lumistack.set_threads(int(sys.argv[1]))
display = lumistack.Display("paper-three-layer", resolution=(48, 30), frames=2)
rng = numpy.random.default_rng(1)
field = lumistack.LightField(rng.random(display.light_field_shape, numpy.float32), display=display)
numpy.save(sys.argv[2], lumistack.factorize(field, iterations=3).layers[0])
"""
    for threads in ("1", "3"):
        subprocess.run([sys.executable, "-c", program, threads, str(tmp_path / threads)], check=True)
    assert (tmp_path / "1.npy").read_bytes() == (tmp_path / "3.npy").read_bytes()
    with pytest.raises(lumistack.SettingError):
        lumistack.set_threads(2)
        lumistack.set_threads(3)

"""Pickles, copies and folders keep the display, the settings and the reference pictures, on which
later results depend. Otherwise a warning appears."""

from __future__ import annotations

import copy
import pickle
import warnings
from pathlib import Path

import numpy
import pytest

import lumistack
from lumistack import Display, LayerStack, LightField


@pytest.fixture(scope="module")
def rendered() -> LightField:
    scene = Path(__file__).resolve().parents[3] / "scenes" / "letters" / "letters.gltf"
    display = Display("paper-three-layer", resolution=(24, 15), views=(3, 3), frames=2)
    return lumistack.render(scene, display, samples=1, zone_directions=32)


def test_pickles_and_copies_keep_display_settings_and_references(rendered: LightField) -> None:
    stack = rendered.factorize(iterations=2)
    score = stack.psnr_zone(rendered)
    assert len(score["directions"]) == 32
    for same in (pickle.loads(pickle.dumps(rendered)), copy.copy(rendered), copy.deepcopy(rendered)):
        assert same.display == rendered.display and same.info == rendered.info and same.info["depth"]
        assert stack.psnr_zone(same) == score
    for again in (pickle.loads(pickle.dumps(stack)), copy.deepcopy(stack)):
        assert again.history == stack.history and again.history
        assert again.solution == stack.solution


def test_left_out_views_stay_references_in_a_pickle(light_field: LightField, tmp_path: Path) -> None:
    light_field.save(tmp_path / "views")
    few = LightField.open(tmp_path / "views", views=(2, 2))
    stack = few.factorize(iterations=1)
    assert stack.psnr_zone(pickle.loads(pickle.dumps(few))) == stack.psnr_zone(few)


def test_exposure_changes_the_references_too(rendered: LightField) -> None:
    stack = rendered.factorize(iterations=2)
    assert stack.psnr_zone(rendered.exposed(0.0))["psnr_zone"] == pytest.approx(stack.psnr_zone(rendered)["psnr_zone"], abs=1e-6)
    dark = rendered.exposed(-2.0)
    assert len(stack.psnr_zone(dark)["directions"]) == 32
    assert stack.psnr_zone(dark)["psnr_zone"] < stack.psnr_zone(rendered)["psnr_zone"] - 1.0
    assert dark.info["exposed"] == [{"exposure_ev": -2.0, "tone": "linear"}] and "exposed" not in rendered.info


def test_a_folder_keeps_settings_and_display(rendered: LightField, tmp_path: Path) -> None:
    rendered.save(tmp_path / "views")
    for path in (tmp_path / "views", tmp_path / "views" / "lightfield.json"):
        read = LightField.open(path)
        assert read.info == rendered.info and read.display == rendered.display
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read.factorize(iterations=0).display == rendered.display
    # the argument takes precedence
    other = Display("fig7-uniform", resolution=(24, 15))
    assert LightField.open(tmp_path / "views", display=other).display == other
    # if the note `display` is not a valid display, it stays a note
    rendered.save(tmp_path / "views", info={"display": "mine"})
    read = LightField.open(tmp_path / "views")
    assert read.display is None and read.info["display"] == "mine"


def test_views_that_the_solver_used_are_no_silent_references(rendered: LightField, tmp_path: Path) -> None:
    rendered.save(tmp_path / "views")
    stack = rendered.factorize(iterations=1)
    with pytest.warns(lumistack.LumistackWarning, match="used 9 of these views to compute the patterns.*zone_directions"):
        stack.psnr_zone(LightField.open(tmp_path / "views"))
    x, y = (numpy.array(slopes) + 0.01 for slopes in (rendered.slope_x, rendered.slope_y))
    other = LightField(rendered.radiance, pitch_mm=rendered.pitch_mm, slope_x=x, slope_y=y)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        stack.psnr_zone(other)


def test_the_default_display_is_no_silent_choice(tmp_path: Path) -> None:
    field = LightField(numpy.full((3, 3, 8, 8, 3), 0.5, "f4"), pitch_mm=1.0, fov_deg=(20, 20))
    with pytest.warns(lumistack.LumistackWarning, match="no display, so the default display is used, .* 12 frames.*pass display="):
        field.factorize(iterations=0)
    with pytest.warns(lumistack.LumistackWarning, match="the default display is used"):
        lumistack.write(field, "images", tmp_path / "images")


def test_a_folder_holds_one_thing(light_field: LightField, tmp_path: Path) -> None:
    for suffix in (".npz", ".exr"):
        with pytest.raises(lumistack.SettingError, match=f"expected the name of a folder, or .*found the suffix {suffix}"):
            light_field.save(tmp_path / f"x{suffix}")
    light_field.save(tmp_path / "views.v2")
    stack = light_field.factorize(iterations=0)
    stack.save(tmp_path / "run")
    for path in (tmp_path / "run", tmp_path / "run" / "layers"):
        with pytest.raises(lumistack.FileError, match="expected a free folder for a light field, found patterns"):
            light_field.save(path)
    with pytest.raises(lumistack.FileError, match="expected a free folder for patterns, found a light field"):
        stack.save(tmp_path / "views.v2")
    for name, save in (("display.toml", stack.save), ("layers/mine.txt", stack.save), ("view_00_00.exr", light_field.save)):
        folder = tmp_path / name.replace("/", "-")
        (folder / name).parent.mkdir(parents=True)
        (folder / name).write_text("mine")
        with pytest.raises(lumistack.FileError, match="of another program, or of a save that was stopped"):
            save(folder)
        assert (folder / name).read_text() == "mine" and len(list(folder.rglob("*.*"))) == 1
    assert LayerStack.open(tmp_path / "run").frames == 2 and not (tmp_path / "views.v2" / "layers").exists()


def test_views_of_an_earlier_light_field_are_removed(light_field: LightField, tmp_path: Path) -> None:
    light_field.save(tmp_path)
    (tmp_path / "view_mine.exr").write_bytes(b"mine")
    small = LightField(light_field.radiance[:2, :2], pitch_mm=1.0, fov_deg=(20, 20))
    small.save(tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"lightfield.json", "view_mine.exr", *(f"view_0{v}_0{u}.exr" for v in range(2) for u in range(2))}

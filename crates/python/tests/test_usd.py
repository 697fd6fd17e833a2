"""Tests the reading of USD in this process, by the OpenUSD of this Python: files, and stages in memory."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy
import pytest

import lumistack
from lumistack import Scene

from conftest import ROOT

Usd: Any = pytest.importorskip("pxr.Usd", reason="no OpenUSD: pip install usd-core")
UsdGeom: Any = pytest.importorskip("pxr.UsdGeom")

SMALL: dict[str, Any] = {"resolution": (32, 20), "views": (2, 2), "frames": 1}


def stage_of_boxes(count: int = 2) -> Any:
    """Returns a stage of boxes in a row, with a variant set that colours the first box."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    for number in range(count):
        box = UsdGeom.Cube.Define(stage, f"/World/Box{number}")
        UsdGeom.XformCommonAPI(box).SetTranslate((3.0 * number, 0.0, 0.0))
        if number > 0:
            box.CreateDisplayColorAttr([(0.8, 0.2, 0.1)])
    first = stage.GetPrimAtPath("/World/Box0")
    looks = first.GetVariantSets().AddVariantSet("look")
    for name, color in (("red", (0.9, 0.0, 0.0)), ("green", (0.0, 0.9, 0.0))):
        looks.AddVariant(name)
        looks.SetVariantSelection(name)
        with looks.GetVariantEditContext():
            UsdGeom.Cube(first).CreateDisplayColorAttr([color])
    looks.SetVariantSelection("red")
    return stage


def file_of_boxes(folder: Path) -> Path:
    stage = stage_of_boxes()  # keep the stage, since its root layer exists only as long as the stage
    path = folder / "boxes.usda"
    stage.GetRootLayer().Export(str(path))
    return path


def test_a_file_gives_what_its_gltf_gives() -> None:
    usd = Scene(ROOT / "scenes" / "still-life" / "still-life.usda")
    gltf = Scene(ROOT / "scenes" / "still-life" / "still-life.gltf")
    assert usd.triangles == gltf.triangles and len(usd.cameras) == len(gltf.cameras)
    numpy.testing.assert_allclose(usd.bounds, gltf.bounds, atol=1e-4)
    display = lumistack.Display("paper-three-layer", **SMALL)
    pictures = [lumistack.render(scene, display, samples=64, max_bounces=3, tone="linear").radiance for scene in (usd, gltf)]
    assert abs(float(pictures[0].mean() / pictures[1].mean()) - 1.0) < 0.02


def test_a_stage_in_memory_is_read_as_it_stands(tmp_path: Path) -> None:
    stage = stage_of_boxes()
    scene = Scene(stage)
    assert scene.triangles == 24 and scene.duration is None and "anon" in str(scene.path)
    assert scene.bounds == ((-1.0, -1.0, -1.0), (4.0, 1.0, 1.0))
    UsdGeom.Cube.Define(stage, "/World/More").CreateSizeAttr(20.0)
    assert Scene(stage).triangles == 36
    assert stage.GetPrimAtPath("/World/More") and not stage.GetSessionLayer().rootPrims


def test_a_changed_stage_is_not_taken_for_the_one_in_the_cache(tmp_path: Path) -> None:
    stage = stage_of_boxes(1)
    display = lumistack.Display("paper-three-layer", **SMALL)

    def mean() -> Any:
        return lumistack.render(Scene(stage), display, samples=4, cache=tmp_path).radiance.mean(axis=(0, 1, 2, 3))

    red = mean()
    stage.GetPrimAtPath("/World/Box0").GetVariantSets().SetSelection("look", "green")
    green = mean()
    assert red[0] > 1.5 * red[1] and green[1] > 1.5 * green[0]


def test_variants_of_a_file(tmp_path: Path) -> None:
    path = file_of_boxes(tmp_path)
    scene = Scene(path, variants=["look=green"])
    assert scene.variants == ["/World/Box0{look=green}", "/World/Box0{look=red}"]
    with pytest.raises(lumistack.SceneError, match=r"expected one of the variants \(/World/Box0\{look\}: green, red\), found the variant look=blue"):
        Scene(path, variants=["look=blue"])
    with pytest.raises(lumistack.SettingError, match="variants: expected no variants with a stage"):
        Scene(stage_of_boxes(), variants=["look=red"])


def test_mistakes_are_reported(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="missing.usda"):
        Scene(tmp_path / "missing.usda")
    broken = tmp_path / "broken.usda"
    broken.write_text("this is no stage")
    with pytest.raises(lumistack.SceneError, match="broken.usda"):
        Scene(broken)
    empty = Usd.Stage.CreateInMemory()
    with pytest.raises(lumistack.SceneError, match="expected at least one"):
        Scene(empty)
    with pytest.raises(lumistack.SettingError, match="animation: expected no value"):
        Scene(stage_of_boxes(), animation="walk")


def test_without_openusd_the_message_says_what_to_type(tmp_path: Path) -> None:
    path = file_of_boxes(tmp_path)
    code = "import sys; sys.modules['pxr'] = None\nimport lumistack\ntry: lumistack.Scene(sys.argv[1])\nexcept lumistack.SceneError as error: print(error)"
    environment = {"PATH": "", "HOME": str(tmp_path), "XDG_DATA_HOME": str(tmp_path)}
    result = subprocess.run([sys.executable, "-c", code, str(path)], env=environment, capture_output=True, text=True, check=True)
    assert "lumistack setup usd" in result.stdout

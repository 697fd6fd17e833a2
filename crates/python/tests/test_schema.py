"""Checks every job and display file of the repository with the schemas of docs/schema, by the
package jsonschema."""

import copy
import json
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest

ROOT = Path(__file__).resolve().parents[3]
FILES = sorted([*ROOT.glob("scenes/*/*.toml"), *ROOT.glob("tests/cases/*/job.toml")])
FILES.remove(ROOT / "scenes/generator/Cargo.toml")


def checker(name: str) -> jsonschema.Draft7Validator:
    schema = json.loads((ROOT / f"docs/schema/{name}.json").read_text())
    jsonschema.Draft7Validator.check_schema(schema)
    return jsonschema.Draft7Validator(schema)


JOB, DISPLAY = checker("job"), checker("display")


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_of_the_repository_fit(path: Path) -> None:
    file = tomllib.loads(path.read_text())
    # A file with layers is a display; all other files are jobs.
    schema = DISPLAY if "layers" in file else JOB
    errors = [f"{error.json_path}: {error.message}" for error in schema.iter_errors(file)]
    assert not errors


def changed(file: dict[str, Any], place: str, value: Any) -> dict[str, Any]:
    file = copy.deepcopy(file)
    *parents, key = place.split(".")
    table: Any = file
    for parent in parents:
        table = table[int(parent)] if isinstance(table, list) else table.setdefault(parent, {})
    table[key] = value
    return file


@pytest.mark.parametrize(
    ("place", "value"),
    [
        ("sceen", "a.glb"),
        ("display.preset", "paper-tree-layer"),
        ("display.resolution", [420]),
        ("display.views", "many"),
        ("window.near", "soon"),
        ("window.fit_depth", "compres"),
        ("light.background", "#20202"),
        ("light.tone", 1),
        ("render.zone_samples", "400"),
        ("render.max_bounces", -1),
        ("factorize.solver", "magic"),
        ("outputs.0.params", {"png9": True}),
        ("outputs.0.params", {"png8": "yes"}),
    ],
)
def test_what_the_program_refuses_does_not_fit(place: str, value: object) -> None:
    good = {
        "scene": {"percent": "m%F6bel.glb"},
        "display": {"preset": "paper-three-layer", "views": {"step": [0.1, 0.0]}},
        "window": {"near": 2.5},
        "light": {"background": [0.1, 0.2, 0.3]},
        "outputs": [{"plugin": "images", "params": {"png8": False}}],
    }
    assert JOB.is_valid(good)
    assert not JOB.is_valid(changed(good, place, value))


def test_displays_are_checked_to_the_last_table() -> None:
    good = tomllib.loads((ROOT / "scenes/displays/paper-three-layer.toml").read_text())
    for place, value in [
        ("frames", 2.5),
        ("colour_order", "rgg"),
        ("layers.0.transfer", {"gama": 2.2}),
        ("layers.0.panel", {"flip": "both"}),
        ("backlight", {"kind": "lenslets"}),
    ]:
        assert not DISPLAY.is_valid(changed(good, place, value)), place
    for place, value in [
        ("layers.0.transfer", {"gamma": [2.1, 2.2, 2.3]}),
        ("layers.0.transfer", {"table": [[0, 0.3], [255, 210.0]]}),
        ("layers.0.panel", {"output": "DP-1", "homography": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}),
        ("field.views", [5, 5]),
    ]:
        assert DISPLAY.is_valid(changed(good, place, value)), place

"""Gaussian splats as arrays, from and to Python."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy
import pytest

import lumistack
from lumistack import Display, Scene

KEYS = ("positions", "rotations", "scales", "opacities", "harmonics")


def cloud(count: int = 300, coefficients: int = 4) -> dict[str, Any]:
    random = numpy.random.default_rng(5)
    turns = random.normal(size=(count, 4))
    return {
        "positions": random.normal(size=(count, 3)).astype(numpy.float32),
        "rotations": (turns / numpy.linalg.norm(turns, axis=1, keepdims=True)).astype(numpy.float32),
        "scales": numpy.exp(random.uniform(-4, -1, (count, 3))).astype(numpy.float32),
        "opacities": random.uniform(0.1, 0.9, count).astype(numpy.float32),
        "harmonics": random.normal(size=(count, coefficients, 3)).astype(numpy.float32),
    }


def write_ply(path: Path, splats: dict[str, Any]) -> None:
    """Writes a .ply file in the form of training programs: it has logarithms of scales, logits of
    opacities, and harmonics grouped by colour channel."""
    rest = splats["harmonics"].shape[1] - 1
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(3 * rest))]
    names += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    opacities = splats["opacities"][:, None]
    columns = [splats["positions"], splats["harmonics"][:, 0], splats["harmonics"][:, 1:].transpose(0, 2, 1).reshape(-1, 3 * rest)]
    columns += [numpy.log(opacities / (1 - opacities)), numpy.log(splats["scales"]), splats["rotations"][:, [3, 0, 1, 2]]]
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(opacities)}\n"
    header += "".join(f"property float {name}\n" for name in names) + "end_header\n"
    path.write_bytes(header.encode() + numpy.hstack(columns).astype("<f4").tobytes())


def test_a_scene_gives_back_the_arrays_that_it_was_made_of() -> None:
    given = cloud()
    place = numpy.diag([2.0, 3.0, 4.0, 1.0])
    place[:3, 3] = (5, 6, 7)
    scene = Scene.from_splats([given, {**given, "encoding": "linear", "scene_from_cloud": place}], name="two")
    assert scene.triangles == 0 and scene.path == Path("two") and "600 splats" in repr(scene)
    first, second = scene.splats
    for key in KEYS:
        assert numpy.allclose(first[key], given[key], atol=1e-6), key
    assert (first["encoding"], second["encoding"]) == ("srgb", "linear")
    assert numpy.array_equal(first["scene_from_cloud"], numpy.eye(4)) and numpy.array_equal(second["scene_from_cloud"], place)
    again = Scene.from_splats(scene.splats)
    assert again.bounds == scene.bounds


def test_arrays_and_their_file_are_the_same_light_field(tmp_path: Path) -> None:
    given = cloud()
    write_ply(tmp_path / "a.ply", given)
    read = Scene(tmp_path / "a.ply", importer={"params": {"up": "y"}})
    for key in KEYS:
        assert numpy.allclose(read.splats[0][key], given[key], rtol=1e-4, atol=1e-6), key
    display = Display("paper-three-layer", resolution=(32, 20), views=(3, 3), frames=1)
    fields = [lumistack.render(scene, display).radiance for scene in (read, Scene.from_splats(given))]
    assert fields[0].max() > 0.2 and abs(fields[0] - fields[1]).max() < 1e-3


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ({"scales": None}, "splats: expected an array `scales`, found none"),
        ({"opacities": numpy.ones(7)}, r'splats\["opacities"\]: expected an array of shape \[300\], found \[7\]'),
        ({"harmonics": numpy.ones((300, 5, 3))}, "1, 4, 9 or 16 coefficients"),
        ({"encoding": "p3"}, "expected srgb or linear, found p3"),
        ({"colours": 1}, "found colours"),
    ],
)
def test_wrong_arrays_are_reported(change: dict[str, Any], part: str) -> None:
    with pytest.raises(lumistack.SettingError, match=part):
        Scene.from_splats({**cloud(), **change})


def test_splats_that_are_no_gaussians_are_gone() -> None:
    given = cloud()
    given["opacities"][0] = numpy.nan
    with pytest.warns(lumistack.LumistackWarning, match="splats left out: 1 of 300"):
        assert len(Scene.from_splats(given).splats[0]["opacities"]) == 299
    with pytest.raises(lumistack.SceneError, match="at least one splat"):
        Scene.from_splats({key: given[key][:0] for key in KEYS})

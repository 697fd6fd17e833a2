"""Texts of help(): the examples in them and in docs/PYTHON.md give the stated results."""

from __future__ import annotations

import doctest
import inspect
import os
from pathlib import Path

import pytest

import lumistack

ROOT = Path(__file__).resolve().parents[3]
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def public() -> list[tuple[str, object]]:
    things = [(name, getattr(lumistack, name)) for name in lumistack.__all__ if not name.startswith("__")]
    for name, thing in list(things):
        if isinstance(thing, type) and not issubclass(thing, Exception):
            things += [(f"{name}.{key}", value) for key, value in vars(thing).items() if not key.startswith("_")]
    return things


@pytest.mark.parametrize(("name", "thing"), public(), ids=[name for name, _ in public()])
def test_everything_public_is_documented_and_its_examples_hold(name: str, thing: object) -> None:
    text = inspect.getdoc(thing)
    assert text and len(text) > 10, name
    examples = doctest.DocTestParser().get_doctest(text, dict(vars(lumistack)), name, None, 0)
    runner = doctest.DocTestRunner(optionflags=FLAGS)
    assert runner.run(examples).failed == 0


def test_there_are_examples() -> None:
    texts = [inspect.getdoc(thing) or "" for _, thing in public()]
    assert sum(text.count(">>> ") for text in texts) >= 8


def test_functions_show_their_arguments() -> None:
    assert "iterations=None" in str(inspect.signature(lumistack.factorize))
    assert "fov_deg=None" in str(inspect.signature(lumistack.LightField))


def test_the_page_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    os.symlink(ROOT / "scenes", tmp_path / "scenes")
    result = doctest.testfile(str(ROOT / "docs" / "PYTHON.md"), module_relative=False, optionflags=FLAGS)
    assert result.failed == 0 and result.attempted >= 10

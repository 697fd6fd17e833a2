"""Every notebook of examples/notebooks runs from top to bottom, in its own folder."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
NOTEBOOKS = sorted((ROOT / "examples/notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook(notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    # paths in a notebook are relative to its folder
    folder = tmp_path / "examples/notebooks"
    folder.mkdir(parents=True)
    (tmp_path / "scenes").symlink_to(ROOT / "scenes")
    monkeypatch.chdir(folder)
    names: dict[str, object] = {"__name__": "__main__"}
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    codes = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    for number, code in enumerate(codes, 1):
        exec(compile(code, f"{notebook.name}, code cell {number}", "exec"), names)
    matplotlib.pyplot.close("all")


def test_there_are_notebooks_without_results() -> None:
    assert len(NOTEBOOKS) >= 3
    for notebook in NOTEBOOKS:
        cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
        assert not any(cell.get("outputs") for cell in cells), f"{notebook.name} holds results"

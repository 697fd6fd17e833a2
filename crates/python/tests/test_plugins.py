"""Plugins in libraries run in child processes, which start the running Python interpreter anew."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from conftest import ROOT

# This program runs in another process, since a process searches for plugins only once.
USES = """
import sys
import numpy
import lumistack
assert "c_means" in [plugin["id"] for plugin in lumistack.plugins()]
field = {"resolution": (24, 16), "pitch_mm": 1.0, "views": (3, 3), "fov_deg": (20.0, 20.0)}
layers = [{"d_mm": d, "resolution": (24, 16), "pitch_mm": 1.0} for d in (-12.0, 12.0)]
display = lumistack.Display({"name": "small", "frames": 2, "brightness": 0.5, "field": field, "layers": layers})
stack = lumistack.LayerStack([numpy.full((2, 16, 24, 3), 0.5, numpy.float32)] * 2, display)
lumistack.write(stack, "c_means", sys.argv[1])
sys.exit(lumistack.main(["plugins"]))
"""


@pytest.mark.skipif(os.name != "posix" or shutil.which("cc") is None, reason="needs a C compiler")
def test_a_plugin_in_a_library_works(tmp_path: Path) -> None:
    library = tmp_path / f"liblumistack_plugin_c_means{'.dylib' if sys.platform == 'darwin' else '.so'}"
    source = ROOT / "examples" / "c-plugin" / "lumistack_plugin_c_means.c"
    include = ROOT / "crates" / "plugin-abi" / "include"
    subprocess.run(["cc", "-shared", "-fPIC", "-O2", "-I", include, "-o", library, source], check=True)
    environment = {**os.environ, "LUMISTACK_PLUGIN_PATH": str(tmp_path)}
    command = [sys.executable, "-c", USES, str(tmp_path / "out")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "c_means 1.0.0" in done.stdout
    assert (tmp_path / "out" / "means_0000.txt").read_text().startswith("layer 0 frame 0 mean 0.500000\n")

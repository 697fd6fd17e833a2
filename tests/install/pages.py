"""Runs every command of the documentation's first pages in order, with few pixels and views. Each page has its own folder in FOLDER.

usage: pages.py FOLDER
"""

import re
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = ["docs/FIRST_HOUR.md", *sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs/start").glob("*.md"))]
#: Flags that are added to every `lumistack run`, so that it is quick. If a flag is repeated, the
#: last one takes effect.
SMALL = ["--resolution", "64x40", "--views", "3x3", "--zone-samples", "20", "--iterations", "3"]
FENCE = re.compile(r"^```(sh|python)\n(.*?)^```$", re.M | re.S)


def serves(words: list[str], folder: Path) -> None:
    """Starts a command that serves a page, checks that it prints the page's address, and ends it."""
    with subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout
        line = server.stdout.readline()
        server.terminate()
    assert "http://127.0.0.1" in line or "http://localhost" in line, f"{shlex.join(words)}: {line!r}"


def page(path: str, folder: Path) -> int:
    folder.mkdir(parents=True)
    shutil.copytree(ROOT / "scenes/letters", folder, dirs_exist_ok=True)
    # on the pages the name of the reader's model is `model.glb`
    (folder / "letters.gltf").rename(folder / "model.gltf")
    (folder / "job.toml").unlink()
    count = 0
    for kind, text in FENCE.findall((ROOT / path).read_text()):
        text = text.replace("model.glb", "model.gltf")
        if kind == "python":
            subprocess.run([sys.executable, "-c", text], cwd=folder, check=True)
            count += 1
            continue
        for line in text.splitlines():
            words = shlex.split(line, comments=True)
            if not words:
                continue
            print(f"{path}: {line}", flush=True)
            if ">>" in words:
                subprocess.run(line, cwd=folder, check=True, shell=True)
            elif words[:2] == ["lumistack", "preview"]:
                serves(words, folder)
            else:
                small = SMALL if words[:2] == ["lumistack", "run"] and "--plan" not in words else []
                subprocess.run(words + small, cwd=folder, check=True, stdout=subprocess.DEVNULL)
            count += 1
    return count


for name in PAGES:
    start = time.monotonic()
    commands = page(name, Path(sys.argv[1]) / Path(name).stem)
    assert commands, f"{name} has no commands"
    print(f"{name}: {commands} commands in {time.monotonic() - start:.0f} s", flush=True)

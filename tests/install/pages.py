"""Runs the commands of documentation pages in order, with few pixels and views. Each page has its own folder in FOLDER.
The tests of `crates/python/tests/test_pages.py` run the commands of all other pages by the functions of this file.

usage: pages.py FOLDER
"""

import json
import re
import shlex
import shutil
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
#: Pages whose commands `cargo xtask dist test` runs, with an installed program.
PAGES = ["docs/FIRST_HOUR.md", *sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs/start").glob("*.md"))]
TINY = ["--resolution", "16x10", "--views", "2x2"]
SOLVED = ["--iterations", "2"]
ALL = [*TINY, "--zone-samples", "8", *SOLVED]
#: Flags that are added to commands, so that they are quick and open no browser. A command gets the
#: flags of the longest key with which it begins. If a flag is repeated, the last one takes effect.
ADDED = {
    "lumistack run": ALL,
    "lumistack run scenes/sweeps/baselines.toml": ["--resolution", "16x10", *SOLVED],
    "lumistack run scenes/sweeps/figure-9.toml": ["--resolution", "16x10", *SOLVED],
    "lumistack render": [*TINY, "--samples", "2"],
    "lumistack factorize": SOLVED,
    "lumistack farm job.toml -o runs/farm": ALL,
    "lumistack sweep": ALL,
    "lumistack live": [*TINY, "--no-open"],
    "lumistack live views/": ["--no-open"],
    "lumistack preview": ["--no-open"],
    "lumistack new": ["--questions"],
    "lumistack display new": ["--questions"],
}
#: Answers to the questions of a command.
ANSWERS = {
    "lumistack new": "model.glb\npaper-three-layer\nimages,web_simulator\n",
    "lumistack display new": "mine\n0\n40,40\n\n1680x1050\n22" + 6 * "\n",
}
#: Commands that serve a page until they are stopped.
SERVERS = ("lumistack preview", "lumistack live")
#: Longest time of a command, seconds.
LONGEST_S = 300


class Block(NamedTuple):
    """A fenced block of a page: the number of its first line, its language and its text."""

    line: int
    language: str
    text: str


def blocks(page: str) -> Iterator[Block]:
    """Yields the fenced blocks of a page. A fence in a list may be indented."""
    fence, start, lines = None, 0, []
    for number, line in enumerate((ROOT / page).read_text(encoding="utf-8").splitlines(), 1):
        mark = re.match(r"( *)```(.*)$", line)
        if fence is None and mark:
            fence, start, lines = mark, number + 1, []
        elif fence is not None and mark:
            yield Block(start, fence[2].strip(), "\n".join(line.removeprefix(fence[1]) for line in lines) + "\n")
            fence = None
        elif fence is not None:
            lines.append(line)
    assert fence is None, f"{page}:{start}: this block has no end"


def commands(block: Block) -> Iterator[tuple[int, str]]:
    """Yields the commands of a block in the language `sh` without comments, each with its line in the page."""
    number = block.line
    for line in block.text.replace("\\\n", "\0").splitlines():
        words = line.replace("\0", " ")
        command = re.sub(r"(^|\s+)#(\s.*)?$", "", words)
        assert shlex.split(command) == shlex.split(words, comments=True), f"line {number}: the comment is unclear"
        if command.strip():
            yield number, command.strip()
        number += 1 + line.count("\0")


def made_for(command: str, table: dict[str, list[str]] | dict[str, str]) -> list[str] | str | None:
    starts = [start for start in table if (command + " ").startswith(start + " ")]
    return table[max(starts, key=len)] if starts else None


def prepare(folder: Path) -> None:
    """Copies a scene as `model.glb` and `scene.glb` into a new folder, with the folder `scenes` of the repository."""
    folder.mkdir(parents=True)
    shutil.copytree(ROOT / "scenes/letters", folder, dirs_exist_ok=True)
    (folder / "job.toml").unlink()
    # a .glb file whose buffers and pictures stay separate files
    text = (folder / "letters.gltf").read_bytes()
    text = json.dumps(json.loads(text)).encode()
    text += b" " * (-len(text) % 4)
    for name in ("model.glb", "scene.glb"):
        (folder / name).write_bytes(struct.pack("<4sIIII", b"glTF", 2, 20 + len(text), len(text), 0x4E4F534A) + text)
    (folder / "scenes").symlink_to(ROOT / "scenes")


def serves(words: list[str], folder: Path) -> None:
    """Starts a command that serves a page, checks that it prints the page's address, and ends it."""
    with subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout
        line = server.stdout.readline()
        server.terminate()
    assert "http://127.0.0.1" in line or "http://localhost" in line, f"{shlex.join(words)}: {line!r}"


def run(command: str, folder: Path) -> None:
    """Runs a command of a page with the flags of `ADDED`.

    # Errors
    `AssertionError` if the command fails, with its output.
    """
    added = made_for(command, ADDED) or []
    # `ADDED` has `--questions` for these commands, which contradicts `--no-questions`
    if "--no-questions" in command:
        added = []
    words = shlex.split(command) + list(added)
    if command.startswith(SERVERS):
        serves(words, folder)
        return
    # bash interprets its operators, such as `>>` and `&&`
    line = f"{command} {shlex.join(added)}" if added else command
    answers = made_for(command, ANSWERS)
    done = subprocess.run(
        ["bash", "-ec", line],
        cwd=folder,
        input=str(answers or ""),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=LONGEST_S,
    )
    assert done.returncode == 0, f"`{line}` ends with {done.returncode}:\n{done.stdout[-3000:]}"


def run_python(text: str, folder: Path) -> None:
    """Runs a block of Python as a program."""
    done = subprocess.run([sys.executable, "-c", text], cwd=folder, capture_output=True, text=True, timeout=LONGEST_S)
    assert done.returncode == 0, f"a program ends with {done.returncode}:\n{text}\n{done.stderr[-3000:]}"


def main(folder: Path) -> None:
    for page in PAGES:
        start, count, place = time.monotonic(), 0, folder / Path(page).stem
        prepare(place)
        for block in blocks(page):
            if block.language == "python":
                run_python(block.text, place)
                count += 1
            elif block.language == "sh":
                for number, command in commands(block):
                    print(f"{page}:{number}: {command}", flush=True)
                    run(command, place)
                    count += 1
        assert count, f"{page} has no commands"
        print(f"{page}: {count} commands in {time.monotonic() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

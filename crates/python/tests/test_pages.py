"""Tests of the documentation's pages. Every block is of a known kind. These tests, or the test that a table names, run every
shell command. Tasks of `cargo xtask` are not run, but must exist. The options of commands in the text must exist, too."""

from __future__ import annotations

import functools
import importlib.util
import os
import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy
import pytest

import lumistack
from conftest import ROOT

spec = importlib.util.spec_from_file_location("pages", ROOT / "tests" / "install" / "pages.py")
assert spec is not None and spec.loader is not None
pages: Any = importlib.util.module_from_spec(spec)
spec.loader.exec_module(pages)

#: Languages of blocks without commands. Doctests and the tests of plugins check Rust and C.
OTHERS = {"text", "toml", "rust", "c", "ts", "html"}

#: Parts of commands that are replaced before a command is run: page, part, replacement.
REPLACED = [
    # fewer time steps
    ("README.md", "--times 24", "--times 2"),
    # the alias of .cargo/config.toml
    ("README.md", "cargo lumistack ", "lumistack "),
    # a folder at the root; a scheduler and a store on other machines
    ("docs/FARM.md", "/mnt/shots/one t0007/trace/3-of-8", "shots/one trace/1-of-1"),
    ("docs/FARM.md", "-o /mnt/shots/one", "-o shots/one"),
    ("docs/FARM.md", "tls://head:8786", "tls://{scheduler}"),
    ("docs/FARM.md", "s3://bucket/shots", "file://{folder}/store"),
    ("docs/FARM.md", "scenes/shot", "scenes/letters"),
    # a port that is free
    ("docs/LIVE.md", "--opentrack 4242", "--opentrack {port}"),
    ("CONTRIBUTING.md", "URL", "{folder}/forge"),
]

#: Commands that another test runs in an equal form: page, start of the command, file of the test,
#: a part of this file, and the reason.
ELSEWHERE = [
    ("README.md", "mkdir -p ~/.local && tar xzf", "tests/install/common.sh", 'tar xzf "$file" -C "$HOME/.local"', "needs a release"),
    ("README.md", "tar -xf lumistack", "tests/install/windows.sh", 'unzip -q "$zip"', "needs a release, and Windows"),
    ("README.md", "sudo apt install", "tests/install/deb.sh", 'apt-get install -q -y "$deb"', "needs a release"),
    ("README.md", 'pip install "lumistack-', "tests/install/wheel.sh", 'pip" install --no-index', "needs a release"),
    ("README.md", "npm install", "tests/install/npm.sh", "npm install --no-audit", "needs a release"),
    ("README.md", "blender --command", "tests/install/blender.sh", "blender --command extension install-file", "needs Blender"),
    ("README.md", "cargo install --locked --path crates/cli", "xtask/src/dist/build.rs", '"lumistack-cli"', "builds for minutes"),
    ("README.md", "pip install .", "xtask/src/python.rs", '["build", "--release"', "builds for minutes"),
    ("README.md", "lumistack show", "tests/show.rs", "fn every_output_shows_its_layer", "needs outputs"),
    ("README.md", "lumistack setup usd", "tests/usd.rs", '["setup", "usd"]', "installs packages"),
    ("docs/PYTHON.md", 'pip install "lumistack-', "tests/install/wheel.sh", 'pip" install --no-index', "needs a release"),
    ("docs/PYTHON.md", "pip install .", "xtask/src/python.rs", '["build", "--release"', "builds for minutes"),
    ("docs/FARM.md", "pip install", "xtask/src/python.rs", "distributed==", "needs a published release"),
    ("docs/GPU.md", "cargo build", "tests/devices.rs", 'cfg!(feature = "gpu")', "builds for minutes"),
    ("docs/GPU.md", "lumistack run scene.glb -o runs/scene --device gpu:", "tests/devices.rs", "fn an_adapter_solves", "needs an adapter"),
    ("docs/PANELS.md", "cargo build", "xtask/src/tools.rs", "lumistack-cli/panels", "builds for minutes"),
    ("docs/PANELS.md", "lumistack show --list", "tests/show.rs", '["show", "--list"]', "needs outputs"),
    ("docs/PANELS.md", "lumistack show runs/scene", "tests/show.rs", "fn every_output_shows_its_layer", "needs outputs"),
    ("docs/PANELS.md", "lumistack show runs/scene --preview", "tests/calibrate.rs", "fn the_preview_window_shows", "needs a screen"),
    ("docs/PANELS.md", "lumistack show my-display.toml", "tests/calibrate.rs", "crosshairs", "needs outputs"),
    ("docs/PANELS.md", "lumistack display calibrate", "tests/calibrate.rs", '"display", "calibrate"', "needs photographs of panels"),
    ("docs/PLUGINS.md", "cargo", "xtask/src/plugins.rs", 'for task in ["build", "test"]', "builds for minutes"),
    ("docs/BLENDER.md", "blender -b shot.blend --command", "tests/install/blender.sh", "--command lumistack make", "needs Blender"),
    ("docs/BLENDER.md", "blender -b shot.blend --python-expr", "plugins/blender/tests/program.py", "command.main(words)", "needs Blender"),
    ("docs/BLENDER.md", "lumistack run shot.blend", "plugins/blender/tests/runs.py", 'lumistack("render", path', "needs Blender"),
    ("docs/BLENDER.md", "lumistack info shot.blend", "plugins/blender/tests/runs.py", 'lumistack("info", path', "needs Blender"),
    ("crates/cli/README.md", "cargo install", "xtask/src/package.rs", '"package"', "needs a published release"),
    ("scenes/README.md", "cargo run", "xtask/src/main.rs", '"lumistack-scene-generator"', "compiles"),
    ("scenes/README.md", "cargo test", "xtask/src/tools.rs", '"--workspace"', "compiles"),
    ("CONTRIBUTING.md", "cargo build --release", "xtask/src/web.rs", '["build", "--release", "--package", "lumistack-cli"]', "builds for minutes"),
    ("web/README.md", "npm ci", "xtask/src/web.rs", '"ci"', "installs packages"),
    ("web/README.md", "npm run check", "web/build.mjs", "typescript/bin/tsc", "needs packages"),
    ("web/README.md", "npm run build", "xtask/src/web.rs", '"run", "--silent", "build"', "needs packages"),
    ("web/README.md", "npm test", "xtask/src/web.rs", '["test", "--silent"', "needs browsers"),
    ("crates/plugin-host/tests/fixtures/abi-1.0/README.md", "cc", "crates/plugin-host/tests/plugin_host/old.rs", "abi-1.0", "never built again"),
]

#: Commands that make the files that a page's first commands read.
BEFORE = {
    "docs/DESIGN_TOOLS.md": ["lumistack run model.glb -o runs/a", "lumistack run scene.glb -o runs/b"],
    "docs/LIVE.md": ["lumistack render model.glb -o views/1", "lumistack render model.glb -o views/2"],
}
JOB = """scene = "model.glb"
[display]
preset = "paper-three-layer"
resolution = [16, 10]
views = [2, 2]
frames = 2
[render]
zone_samples = 8
[factorize]
iterations = 2
"""
#: Pages on which the reader has a job file.
WITH_JOB = {"docs/FARM.md": JOB, "docs/PLUGINS.md": JOB + '[[outputs]]\nplugin = "c_means"\n'}


def all_pages() -> list[str]:
    """Returns all pages of the repository. Folders with other people's files or built files are omitted."""
    found = []
    for folder, folders, files in os.walk(ROOT):
        folders[:] = [name for name in folders if name not in {"target", "node_modules", "dist", "shared"} and name[0] != "."]
        found += [(Path(folder) / name).relative_to(ROOT).as_posix() for name in files if name.endswith(".md")]
    return sorted(found)


def is_task(command: str) -> bool:
    """Returns whether a command is a task of the crate `xtask`. These tasks are CI itself, or its single steps, or
    benchmarks, which take minutes to hours. Fails if `xtask` does not know the task."""
    if not command.startswith("cargo xtask "):
        return False
    words = command.split()[2:]
    assert f'["{words[0]}"' in (ROOT / "xtask/src/main.rs").read_text(), f"`{command}`: xtask has no task `{words[0]}`"
    files = [path for pattern in ("main.rs", f"{words[0]}*.rs", f"{words[0]}/*.rs") for path in (ROOT / "xtask/src").glob(pattern)]
    source = "".join(path.read_text() for path in files)
    for word in words[1:]:
        # capital letters and paths stand for values
        if re.fullmatch(r"-*[a-z-]+", word):
            usage = rf"\[{word}\b|\b{word}\]" if word.startswith("-") else rf"\n  {word} "
            assert f'"{word}"' in source or re.search(usage, source), f"`{command}`: xtask does not know `{word}`"
    return True


def elsewhere(page: str, command: str) -> tuple[str, str, str, str, str] | None:
    """Returns the row of `ELSEWHERE` for a command: the row with the longest start."""
    rows = [row for row in ELSEWHERE if row[0] == page and (command + " ").startswith(row[1])]
    return max(rows, key=lambda row: len(row[1]), default=None)


def write_splats(path: Path) -> None:
    """Writes a capture in the form of training programs: 200 splats of degree 0 in a ball."""
    names = ["x", "y", "z", *(f"f_dc_{i}" for i in range(3)), "opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    values = numpy.random.default_rng(1).normal(size=(200, len(names))).astype("<f4")
    values[:, 7:10] = -3.0
    lines = ["ply", "format binary_little_endian 1.0", "element vertex 200", *(f"property float {name}" for name in names), "end_header\n"]
    path.write_bytes("\n".join(lines).encode() + values.tobytes())


def write_photograph(run: Path, path: Path) -> None:
    """Writes a photograph of a display in which its corners are where DESIGN_TOOLS.md states them."""
    from PIL import Image

    corners = [(210, 160), (1830, 150), (1850, 1170), (190, 1180)]
    view = run.parent / "seen.png"
    pages.run(f"lumistack simulate {run} --eye 150,60,900 -o {view}", run.parent)
    with Image.open(view) as file:
        picture = file.convert("RGB")
    sides = [(0, 0), (picture.width, 0), (picture.width, picture.height), (0, picture.height)]
    rows, right = [], []
    for (x, y), (u, v) in zip(corners, sides):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
        right += [u, v]
    coefficients = [float(value) for value in numpy.linalg.solve(numpy.array(rows, float), numpy.array(right, float))]
    picture.transform((2000, 1333), Image.Transform.PERSPECTIVE, coefficients).save(path)


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, dict[str, str]]]:
    """A Dask scheduler with TLS and one worker. Yields its address and the files with its certificates."""
    distributed = pytest.importorskip("distributed")
    security = distributed.security.Security.temporary()
    files = {"ca.pem": security.tls_ca_file, "me.pem": security.tls_client_cert, "me-key.pem": security.tls_client_key}
    folder = tmp_path_factory.mktemp("dask")
    words = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": None, "local_directory": str(folder)}
    with distributed.LocalCluster(security=security, protocol="tls", **words) as cluster:
        yield cluster.scheduler_address.removeprefix("tls://"), files


def with_commands() -> list[str]:
    """Returns the pages with blocks that these tests run."""
    found = []
    for page in all_pages():
        for block in pages.blocks(page):
            mine = block.language == "python" and ">>>" not in block.text
            if block.language == "sh":
                mine = any(not command.startswith("cargo xtask ") and elsewhere(page, command) is None for _, command in pages.commands(block))
            if mine and page not in found:
                found.append(page)
    return found


def test_every_block_is_of_a_known_kind() -> None:
    """A block states its language, and examples with `>>>` are only where test_docs.py runs them."""
    count = 0
    for page in all_pages():
        for block in pages.blocks(page):
            place = f"{page}:{block.line}"
            assert block.language in OTHERS | {"sh", "python"}, f"{place}: expected a language of a block, found `{block.language}`"
            for _, command in pages.commands(block) if block.language == "sh" else []:
                is_task(command)
            assert block.language != "python" or ">>>" not in block.text or page == "docs/PYTHON.md", f"{place}: no test runs these examples"
            count += 1
        fenced = {number for block in pages.blocks(page) for number in range(block.line, block.line + block.text.count("\n"))}
        for number, line in enumerate((ROOT / page).read_text().splitlines(), 1):
            is_command = re.match(r"( {4,}|\t)(lumistack|cargo|pip|npm|git|blender|python3?|sudo|cc|make) ", line)
            assert number in fenced or not is_command, f"{page}:{number}: expected a block in ```sh around this command"
    assert count > 60


def test_tables_have_no_old_rows() -> None:
    lines = {page: [command for block in pages.blocks(page) if block.language == "sh" for _, command in pages.commands(block)] for page in all_pages()}
    for page, part, _ in REPLACED:
        assert any(part in command for command in lines[page]), f"REPLACED: {page} has no command with `{part}`"
    alias = 'lumistack = "run --release --package lumistack-cli --"'
    assert alias in (ROOT / ".cargo/config.toml").read_text(), "REPLACED: `cargo lumistack` is another command"
    used = {elsewhere(page, command) for page in lines for command in lines[page]}
    for row in ELSEWHERE:
        page, start, file, part, reason = row
        assert row in used, f"ELSEWHERE: {page} has no command `{start}`"
        assert part in (ROOT / file).read_text(), f"ELSEWHERE: {file}: expected `{part}`, the test of `{start}` ({reason})"


@pytest.mark.parametrize("page", with_commands())
def test_the_commands_of_a_page_work(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    folder = tmp_path / "page"
    pages.prepare(folder)
    # put the programs of this Python's environment first on PATH
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("LUMISTACK_PYTHON", sys.executable)
    known = {"folder": str(folder), "port": "", "scheduler": ""}
    if page in WITH_JOB:
        (folder / "job.toml").write_text(WITH_JOB[page])
    for command in BEFORE.get(page, []):
        pages.run(command, folder)
    if page == "README.md":
        numpy.save(folder / "views.npy", numpy.full((3, 3, 10, 16, 3), 0.5, numpy.float32))
    elif page == "docs/DESIGN_TOOLS.md":
        write_photograph(folder / "runs/a", folder / "photo.jpg")
    elif page == "docs/SPLATS.md":
        write_splats(folder / "garden.ply")
        shutil.copy(ROOT / "scenes/dandelion/dandelion.spz", folder / "biker.spz")
    elif page == "docs/LIVE.md":
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            known["port"] = str(free.getsockname()[1])
    elif page == "docs/FARM.md":
        known["scheduler"], files = request.getfixturevalue("scheduler")
        for name, text in files.items():
            (folder / name).write_text(text)
    elif page == "docs/PLUGINS.md":
        (folder / "target/release").mkdir(parents=True)
        for name in ("crates", "examples"):
            (folder / name).symlink_to(ROOT / name)
        # Commands of the page need a plugin library in target/release. Build the page's plugin in
        # C there, since it needs no cargo.
        [build] = [command for block in pages.blocks(page) if block.language == "sh" for _, command in pages.commands(block) if command.startswith("cc ")]
        pages.run(build.replace("-o target/", "-o target/release/"), folder)
    elif page == "CONTRIBUTING.md":
        (folder / "target/site").mkdir(parents=True)
        (folder / "target/site/index.html").write_text("a page")
        pages.run("git init --quiet --bare forge", folder)
        for name in ("AUTHOR", "COMMITTER"):
            monkeypatch.setenv(f"GIT_{name}_NAME", "a reader")
            monkeypatch.setenv(f"GIT_{name}_EMAIL", "reader@example.org")
    failure = ""
    for block in pages.blocks(page):
        if block.language == "python" and ">>>" not in block.text:
            pages.run_python(block.text, folder)
        for number, command in pages.commands(block) if block.language == "sh" else []:
            if is_task(command) or elsewhere(page, command):
                continue
            for other, part, replacement in REPLACED:
                if other == page:
                    command = command.replace(part, replacement.format_map(known))
            try:
                pages.run(command, folder)
            except AssertionError as error:
                failure = f"{page}:{number}: {error}"
                break
        if failure:
            pytest.fail(failure, pytrace=False)


@functools.cache
def help_of(words: tuple[str, ...]) -> str | None:
    """Returns the help text of a command; `None` if there is no such command."""
    done = subprocess.run([sys.executable, "-m", "lumistack", *words, "--help"], capture_output=True, text=True)
    return done.stdout if done.returncode == 0 else None


def test_commands_in_the_text_have_known_flags() -> None:
    """Checks the spans `lumistack COMMAND ...` and `cargo xtask TASK` in the text of all pages."""
    count = 0
    for page in all_pages():
        text = re.sub(r"^ *```.*?^ *```$", "", (ROOT / page).read_text(), flags=re.M | re.S)
        for span in re.findall(r"`([^`]+)`", text):
            span = " ".join(span.split())
            is_task(span)
            if not span.startswith("lumistack ") or not re.fullmatch(r"[a-z]+", span.split()[1]):
                continue
            words = span.split()[1:]
            found = help_of((words[0],))
            assert found, f"{page}: `{span}`: there is no command `{words[0]}`"
            if "\nCommands:\n" in found and len(words) > 1 and re.fullmatch(r"[a-z]+", words[1]):
                found = help_of(tuple(words[:2])) or found
            for flag in re.findall(r"--[a-z][a-z0-9-]*", span):
                assert re.search(rf"{flag}\b", found), f"{page}: `{span}`: the command has no option {flag}"
            count += 1
    assert count > 40

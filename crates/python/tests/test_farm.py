"""Runs on many machines: results have the same bytes as on one machine, even if processes are
killed. Messages name unusable workers. Exported jobs run, or contain the graph of the plan."""

from __future__ import annotations

import json
import os
import shutil
import signal
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy
import pytest

import lumistack
import lumistack.farm
from conftest import ROOT

distributed = pytest.importorskip("distributed")
PROGRAM = [sys.executable, "-m", "lumistack"]
JOB = """
name = "walk"
scene = {scene}
[display]
preset = "paper-three-layer"
resolution = [20, 12]
views = [3, 3]
frames = 2
[render]
samples = 1
[factorize]
iterations = 4
[sequence]
times = 3
iterations = 2
turn_deg = 8.0
"""
BLOCKS = ["--blocks", "2"]


def command(*words: str | Path) -> str:
    done = subprocess.run([*PROGRAM, *map(str, words)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def results(folder: Path) -> dict[str, bytes]:
    """Returns the files of a run and their bytes. Omits caches, reports (which contain times) and
    the job file."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file() and "cache" not in path.relative_to(folder).parts)
    kept = (path for path in files if not path.name.startswith("report.") and path.name != "job.toml")
    return {str(path.relative_to(folder)): path.read_bytes() for path in kept}


@pytest.fixture(scope="module")
def place() -> Iterator[Path]:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


@pytest.fixture(scope="module")
def job(place: Path) -> Path:
    path = place / "walk.toml"
    path.write_text(JOB.format(scene=json.dumps(str(ROOT / "scenes" / "letters" / "letters.gltf"))))
    return path


@pytest.fixture(scope="module")
def expected(place: Path, job: Path) -> dict[str, bytes]:
    command("run", job, "-o", place / "one")
    found = results(place / "one")
    assert len(found) > 20
    return found


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A cluster of two workers. All tests share it, except the tests that kill workers."""
    with lumistack.farm._engine.connected(None, None, 2, None) as client:
        yield client


def test_a_script_without_a_guard_is_told_so(tmp_path: Path) -> None:
    """A spawned worker imports the script. Without a guard, the script then calls `plan` again."""
    script = tmp_path / "farm_of_mine.py"
    lines = ["import multiprocessing, lumistack.farm", "try:", "    lumistack.farm.plan('nothing.toml', 'run')"]
    lines += ["except lumistack.farm.FarmError as error:", "    print(error, flush=True)", "if __name__ == '__main__':"]
    lines += ["    child = multiprocessing.get_context('spawn').Process(target=print)", "    child.start()", "    child.join()"]
    script.write_text("\n".join(lines))
    found = subprocess.run([sys.executable, script], capture_output=True, text=True, cwd=tmp_path, check=True)
    first, second = found.stdout.strip().splitlines()
    assert "nothing.toml" in first and "after `if __name__ ==" in second



def test_two_workers_give_the_bytes_of_one_machine(place: Path, job: Path, expected: dict[str, bytes], cluster: Any) -> None:
    events: list[dict[str, Any]] = []
    outcome = lumistack.farm.run(job, place / "two", options=BLOCKS, client=cluster, threads=1, tell=events.append)
    assert results(place / "two") == expected
    units = lumistack.farm.plan(job, place / "two", options=BLOCKS)["units"]
    assert sorted(outcome.done) == sorted(unit["id"] for unit in units)
    order = [event["id"] for event in events if event["event"] == "done_unit"]
    for unit in units:
        assert all(order.index(taken) < order.index(unit["id"]) for taken in unit["inputs"])
    # A second run executes only the last unit, which checks all results.
    again = lumistack.farm.run(job, place / "two", options=BLOCKS, client=cluster, threads=1)
    assert (again.done, again.before) == (["finish"], len(units) - 1)


def test_workers_and_client_that_are_killed_cost_nothing_but_time(place: Path, job: Path, expected: dict[str, bytes]) -> None:
    folder = place / "killed"
    words = [*PROGRAM, "--json", "--threads", "1", "farm", str(job), "-o", str(folder), *BLOCKS]
    first = subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env={**os.environ, "LUMISTACK_PYTHON": sys.executable}, process_group=0)
    assert first.stdout is not None
    assert any(json.loads(line)["event"] == "done_unit" for line in first.stdout), "the run ended before a unit was done"
    # Kill the client, its scheduler and its workers at the same time.
    os.killpg(first.pid, signal.SIGKILL)
    first.wait()
    first.stdout.close()
    kills: list[int] = []
    with lumistack.farm._engine.connected(None, None, 2, None) as client:

        def kill(event: dict[str, Any]) -> None:
            # Kill a worker after every third unit.
            if event["event"] == "done_unit" and event["done"] % 3 == 0:
                pids = list(client.run(os.getpid).values())
                os.kill(pids[0], signal.SIGKILL)
                kills.append(pids[0])

        outcome = lumistack.farm.run(job, folder, options=BLOCKS, client=client, threads=1, tell=kill)
    assert outcome.before > 0 and len(kills) >= 2
    assert results(folder) == expected


def test_a_unit_ends_with_its_worker(place: Path, job: Path) -> None:
    folder = place / "attached"
    lumistack.farm.plan(job, folder, options=BLOCKS)
    # The unit waits for inputs that no unit makes, so it runs until its standard input closes.
    words = [*PROGRAM, "farm", "unit", "--attached", str(folder), "t0001/expose"]
    child = subprocess.Popen(words, stdin=subprocess.PIPE)
    time.sleep(0.5)
    assert child.poll() is None and child.stdin is not None
    child.stdin.close()
    assert child.wait(20) == 130


def test_a_worker_of_another_build_is_refused_by_name(place: Path, job: Path, cluster: Any) -> None:
    script = place / "other.sh"
    script.write_text('#!/bin/sh\necho \'{"event": "code", "version": "0.0.9", "code": "feedfacefeedface"}\'\n')
    script.chmod(0o755)
    with pytest.raises(lumistack.farm.FarmError, match=r"none of the workers can be used: tcp://127.*has lumistack 0\.0\.9 \(feedfacefeedface\)"):
        lumistack.farm.run(job, place / "refused", client=cluster, worker_program=[str(script)])


def test_a_worker_that_does_not_see_the_folder_is_refused(place: Path, job: Path, cluster: Any) -> None:
    with pytest.raises(lumistack.farm.FarmError, match=r"does not find /nowhere/refused: share the folder"):
        lumistack.farm.run(job, place / "refused", client=cluster, maps=[f"{place}=/nowhere"])


def test_paths_are_mapped(place: Path, job: Path, cluster: Any, expected: dict[str, bytes]) -> None:
    # The workers see the run folder under another path, as on another machine.
    other = place.with_name(place.name + "-there")
    other.symlink_to(place)
    try:
        lumistack.farm.run(job, place / "mapped", options=BLOCKS, client=cluster, threads=1, maps=[f"{place}={other}"])
    finally:
        other.unlink()
    assert results(place / "mapped") == expected


def test_a_poisoned_unit_ends_with_one_message_and_all_else_done(place: Path, cluster: Any, light_field: lumistack.LightField) -> None:
    times = place / "times"
    times.mkdir()
    values = numpy.asarray(light_field)
    for time_ in range(3):
        numpy.save(times / f"t{time_ + 1}.npy", values)
    (times / "t2.npy").write_bytes((times / "t2.npy").read_bytes()[:-100])
    job = place / "times.toml"
    job.write_text(
        f"light_field = {json.dumps(str(times))}\n[geometry]\ngrid = \"oblique\"\nfov_deg = [20.0, 20.0]\npitch_mm = 1.0\n"
        "[display]\npreset = \"paper-three-layer\"\nframes = 2\n[factorize]\niterations = 2\n[sequence]\niterations = 2\n"
    )
    with pytest.raises(lumistack.farm.FarmError) as caught:
        lumistack.farm.run(job, place / "poisoned", client=cluster, threads=1)
    message = str(caught.value)
    assert "unit t0002/read failed 3 times" in message and "t2.npy" in message, message
    assert "units that were not started, since they depend on failed units" in message
    done = {unit["id"] for unit in lumistack.farm.plan(job, place / "poisoned")["units"] if unit["done"]}
    assert {"t0001/read", "t0001/factorize", "t0003/read"} <= done and "t0003/factorize" not in done
    # After the damaged file is corrected, the same command continues.
    numpy.save(times / "t2.npy", values)
    outcome = lumistack.farm.run(job, place / "poisoned", client=cluster, threads=1)
    assert outcome.before == len(done) and "finish" in outcome.done


def test_schedulers_on_other_machines_need_tls() -> None:
    check = lumistack.farm._engine.check_address
    for address in ("tcp://127.0.0.1:8786", "localhost:8786", "tcp://[::1]:8786"):
        check(address, False, False)
    check("tcp://farm.example:8786", False, True)
    check("tls://farm.example:8786", True, False)
    for address in ("tcp://farm.example:8786", "10.0.0.1:8786", "ws://farm.example:8786", "tcp://127.0.0.1.example:8786"):
        with pytest.raises(lumistack.farm.FarmError, match="--insecure"):
            check(address, False, False)
    with pytest.raises(lumistack.farm.FarmError, match="--tls-ca"):
        check("tls://farm.example:8786", False, False)


def test_ctrl_c_stops_units_and_keeps_what_is_done(place: Path, cluster: Any) -> None:
    job = place / "long.toml"
    scene = json.dumps(str(ROOT / "scenes" / "letters" / "letters.gltf"))
    job.write_text(f"scene = {scene}\n[display]\npreset = \"paper-three-layer\"\nresolution = [420, 262]\n[render]\nsamples = 64\n")
    # Restore Python's handler of Ctrl-C: a test suite in the background may ignore interrupts.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    threading.Timer(4.0, signal.raise_signal, [signal.SIGINT]).start()
    with pytest.raises(KeyboardInterrupt):
        lumistack.farm.run(job, place / "long", options=BLOCKS, client=cluster, threads=1)
    signal.signal(signal.SIGINT, before)
    children = f"ps -eo args | grep -c '[f]arm unit --attached {place / 'long'}'"
    deadline = time.monotonic() + 20
    while int(subprocess.run(children, shell=True, capture_output=True, text=True).stdout) and time.monotonic() < deadline:
        time.sleep(0.2)
    assert time.monotonic() < deadline, "units of a run that was stopped go on"


def test_make_gives_the_bytes_of_one_machine(place: Path, job: Path, expected: dict[str, bytes]) -> None:
    program = " ".join(PROGRAM)
    command("farm", "export", "makefile", job, "-o", place / "made it", *BLOCKS, "--to", place / "Makefile", "--program", program)
    done = subprocess.run(["make", "-j2", "-f", str(place / "Makefile")], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert results(place / "made it") == expected


def test_a_shell_script_gives_the_bytes_of_one_machine(place: Path, job: Path, expected: dict[str, bytes]) -> None:
    program = " ".join(PROGRAM)
    command("farm", "export", "shell", job, "-o", place / "shell", *BLOCKS, "--to", place / "sh", "--program", program)
    done = subprocess.run([str(place / "sh" / "run.sh")], capture_output=True, text=True, env={**os.environ, "JOBS": "2"})
    assert done.returncode == 0, done.stderr
    assert results(place / "shell") == expected


def test_openjd_checks_and_runs_its_template(place: Path, job: Path, expected: dict[str, bytes]) -> None:
    pytest.importorskip("openjd.cli")
    program = " ".join(PROGRAM)
    template = place / "template.json"
    command("farm", "export", "openjd", job, "-o", place / "openjd", *BLOCKS, "--to", template, "--program", program)
    openjd = [sys.executable, "-m", "openjd"]
    for words in (["check", str(template)], ["run", str(template)]):
        done = subprocess.run([*openjd, *words], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
    assert results(place / "openjd") == expected


def graph(place: Path, job: Path) -> dict[str, set[str]]:
    units = lumistack.farm.plan(job, place / "exported", options=BLOCKS)["units"]
    return {unit["id"]: set(unit["inputs"]) for unit in units}


def test_flamenco_compiles_the_same_graph(place: Path, job: Path) -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("no Node.js")
    command("farm", "export", "flamenco", job, "-o", place / "exported", *BLOCKS, "--to", place / "flamenco")
    script = """
        const fs = require("fs"), vm = require("vm");
        const [type, job] = process.argv.slice(1).map((path) => fs.readFileSync(path, "utf8"));
        const author = {
          Task: (name, type) => ({ name, type, needs: [], commands: [], addCommand(c) { this.commands.push(c); }, addDependency(t) { this.needs.push(t.name); } }),
          Command: (name, parameters) => ({ name, parameters }),
        };
        const tasks = [];
        const submitted = { ...JSON.parse(job), addTask: (task) => tasks.push(task) };
        const context = vm.createContext({ author });
        vm.runInContext(type + "; globalThis.type = JOB_TYPE; globalThis.compile = compileJob", context);
        for (const key of Object.keys(submitted.settings)) {
          if (!context.type.settings.some((setting) => setting.key === key)) throw new Error(key);
        }
        context.compile(submitted);
        console.log(JSON.stringify(tasks));
    """
    done = subprocess.run([node, "-e", script, str(place / "flamenco" / "lumistack.js"), str(place / "flamenco" / "job.json")], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    tasks = json.loads(done.stdout)
    assert {task["name"]: set(task["needs"]) for task in tasks} == graph(place, job)
    [exec_] = tasks[1]["commands"]
    assert [exec_["parameters"]["exe"], *exec_["parameters"]["args"]] == ["lumistack", "farm", "unit", str(place / "exported"), tasks[1]["name"]]


def test_deadline_submits_the_same_graph(place: Path, job: Path) -> None:
    folder = place / "deadline"
    command("farm", "export", "deadline", job, "-o", place / "exported", *BLOCKS, "--to", folder)
    fake, log = place / "deadlinecommand", place / "submitted"
    fake.write_text(f'#!/bin/sh\nn=$(cat {log}/count 2>/dev/null || echo 0)\nmkdir -p {log}\ncp "$1" {log}/$n.job\ncp "$2" {log}/$n.plugin\necho $((n + 1)) > {log}/count\necho "Result=Success"\necho "JobID=id$n"\n')
    fake.chmod(fake.stat().st_mode | stat.S_IXUSR)
    done = subprocess.run([sys.executable, str(folder / "submit.py")], capture_output=True, text=True, env={**os.environ, "DEADLINE_COMMAND": str(fake)})
    assert done.returncode == 0, done.stderr
    found: dict[str, set[str]] = {}
    of_job: dict[str, list[str]] = {}
    for number in range(int((log / "count").read_text())):
        info = dict(line.split("=", 1) for line in (log / f"{number}.job").read_text().splitlines())
        plugin = dict(line.split("=", 1) for line in (log / f"{number}.plugin").read_text().splitlines())
        pattern = plugin["Arguments"].split()[-1]
        last = int(info["Frames"].split("-")[-1])
        of_job[f"id{number}"] = [pattern.replace("<STARTFRAME>", str(frame)) for frame in range(1, last + 1)]
        needed = [unit for id_ in info.get("JobDependencies", "").split(",") if id_ for unit in of_job[id_]]
        found.update({unit: set(needed) for unit in of_job[f"id{number}"]})
    assert found == graph(place, job)


def test_opencue_makes_the_same_graph(place: Path, job: Path) -> None:
    pytest.importorskip("outline")
    command("farm", "export", "opencue", job, "-o", place / "exported", *BLOCKS, "--to", place / "job.py")
    script = """
        import json, runpy, sys
        job = runpy.run_path(sys.argv[1], run_name="job")["make"]()
        layers = []
        for layer in job.get_layers():
            depends = [depend.get_depend_on_layer().get_name() for depend in layer.get_depends()]
            layers.append([layer.get_name(), layer.get_arg("command")[-1], str(layer.get_arg("range")), depends])
        print(json.dumps(layers))
    """
    done = subprocess.run([sys.executable, "-c", "\n".join(line[8:] for line in script.splitlines()), str(place / "job.py")], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    of_layer: dict[str, list[str]] = {}
    found: dict[str, set[str]] = {}
    for name, pattern, frames, depends in json.loads(done.stdout.splitlines()[-1]):
        of_layer[name] = [pattern.replace("#IFRAME#", str(frame)) for frame in range(1, int(frames.split("-")[-1]) + 1)]
        needed = {unit for depend in depends for unit in of_layer[depend]}
        found.update({unit: needed for unit in of_layer[name]})
    assert found == graph(place, job)

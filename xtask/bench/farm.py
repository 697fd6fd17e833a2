"""Computes a sequence on one and on two workers, and compares the times with the predicted times.
Also checks that the results have the same bytes after kills of workers and of the client, and after
a full disk. `cargo xtask bench farm` runs this script."""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import lumistack.farm
from lumistack.farm._engine import FarmError, connected

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = [sys.executable, "-m", "lumistack"]
JOB = """
name = "walk"
scene = {scene}
[display]
preset = "paper-three-layer"
resolution = [{cols}, {rows}]
views = [5, 5]
frames = 3
[render]
samples = {samples}
[factorize]
iterations = 8
[sequence]
times = {times}
iterations = 3
turn_deg = {turn}
"""


def results(folder: Path) -> dict[str, bytes]:
    """Returns the files of a run and their bytes, except caches, reports (which contain times) and the job file."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file() and "cache" not in path.relative_to(folder).parts)
    kept = (path for path in files if not path.name.startswith("report.") and path.name != "job.toml")
    return {str(path.relative_to(folder)): path.read_bytes() for path in kept}


def predicted(folder: Path, workers: list[int]) -> dict[int, float]:
    """Predicts the time of a run for several numbers of workers, from the measured times of a finished run, seconds."""
    words = [*PROGRAM, "--json", "farm", "show", str(folder), "--workers", ",".join(map(str, workers))]
    answer = json.loads(subprocess.run(words, capture_output=True, text=True, check=True).stdout.splitlines()[-1])
    return {prediction["workers"]: prediction["makespan_seconds"] for prediction in answer["predictions"]}


def timed(job: Path, folder: Path, workers: int, options: list[str]) -> float:
    with connected(None, None, workers, None) as client:
        # make each worker load its modules before the time is measured
        client.run(lumistack.farm._work.probe, None, str(folder))
        return lumistack.farm.run(job, folder, options=options, client=client, threads=1).seconds


def kill_often(job: Path, folder: Path, options: list[str], count: int) -> int:
    """Runs the job, and kills the client with all its children once, then workers at random times.
    Returns the number of kills."""
    chance = random.Random(7)
    words = [*PROGRAM, "--threads", "1", "farm", str(job), "-o", str(folder), *options]
    first = subprocess.Popen(words, env={**os.environ, "LUMISTACK_PYTHON": sys.executable}, process_group=0, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    time.sleep(chance.uniform(5.0, 9.0))
    os.killpg(first.pid, signal.SIGKILL)
    first.wait()
    kills, stop = 1, threading.Event()
    with connected(None, None, 2, None) as client:

        def kill() -> None:
            nonlocal kills
            while kills <= count and not stop.wait(chance.uniform(0.3, 1.2)):
                try:
                    pids = list(client.run(os.getpid, on_error="ignore").values())
                    os.kill(chance.choice(pids), signal.SIGKILL)
                    kills += 1
                except (IndexError, OSError, TimeoutError, ProcessLookupError):
                    continue

        killer = threading.Thread(target=kill)
        killer.start()
        try:
            lumistack.farm.run(job, folder, options=options, client=client, threads=1)
        finally:
            stop.set()
            killer.join()
    return kills


def seams(place: Path, job: Path, times: int) -> dict[str, Any]:
    """Measures how much splitting a sequence into four chunks costs, for several numbers of warm-up steps.

    The costs are the worst changes of `psnr_view` and `psnr_change` at the first time step of a chunk, relative to the
    sequence solved as one chain."""

    def report(folder: Path, *options: str) -> list[dict[str, Any]]:
        subprocess.run([*PROGRAM, "run", str(job), "-o", str(folder), *options], check=True, capture_output=True)
        found: list[dict[str, Any]] = json.loads((folder / "report.json").read_text())["times"]
        return found

    chain = report(place / "plain")
    chunk = times // 4
    found: dict[str, Any] = {}
    for warm_up in (1, 2, 4):
        if warm_up > chunk:
            continue
        folder = place / f"chunks-{warm_up}"
        # the copy contains the rendered views, so that both runs use the same views
        subprocess.run(["cp", "-r", str(place / "plain"), str(folder)], check=True)
        cut = report(folder, "--chunk-times", str(chunk), "--warm-up-times", str(warm_up))
        starts = range(chunk, times, chunk)
        differences = {key: [cut[t][key] - chain[t][key] for t in starts] for key in ("psnr_view", "psnr_change")}
        found[str(warm_up)] = {key: min(values) for key, values in differences.items()}
        found[str(warm_up)]["solves"] = (times + warm_up * len(starts)) / times
    return found


def full_disk(job: Path, expected: dict[str, bytes], options: list[str]) -> str:
    """Runs the job in a file system that is too small, which must fail. Then enlarges the file
    system and runs the job again. Needs root."""
    with tempfile.TemporaryDirectory() as place:
        mount = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", place]
        if os.geteuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
            return "skipped: mounting a small file system needs root"
        try:
            try:
                lumistack.farm.run(job, Path(place) / "run", options=options, workers=2, threads=1)
                raise SystemExit("the run succeeded although the file system is too small for it")
            except FarmError as error:
                message = str(error)
            subprocess.run(["mount", "-o", "remount,size=2g", place], check=True)
            outcome = lumistack.farm.run(job, Path(place) / "run", options=options, workers=2, threads=1)
            assert results(Path(place) / "run") == expected, "bytes differ after a full disk"
            return f"{message[:160]} ... The second run reused {outcome.before} units; equal bytes"
        finally:
            subprocess.run(["umount", "-l", place], check=False)


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--times", type=int)
    parser.add_argument("--samples", type=int)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    size: dict[str, Any] = {"cols": 40, "rows": 26, "samples": 8, "times": 12} if given.quick else {"cols": 84, "rows": 52, "samples": 32, "times": 48}
    size["times"], size["samples"] = given.times or size["times"], given.samples or size["samples"]
    # the window turns by 0.4° from each time step to the next
    size["turn"] = 0.4 * (size["times"] - 1)
    figures: dict[str, Any] = dict(size)
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        job = place / "walk.toml"
        job.write_text(JOB.format(scene=json.dumps(str(ROOT / "scenes/still-life/still-life.gltf")), **size))
        options = ["--blocks", "2"]
        start = time.monotonic()
        subprocess.run([*PROGRAM, "--threads", "1", "run", str(job), "-o", str(place / "plain")], check=True, capture_output=True)
        figures["run_seconds"] = time.monotonic() - start
        expected = results(place / "plain")
        for workers in (1, 2):
            figures[f"workers_{workers}_seconds"] = timed(job, place / f"on-{workers}", workers, options)
            assert results(place / f"on-{workers}") == expected, f"bytes differ on {workers} workers"
        from_one = predicted(place / "on-1", [1, 2, 10, 100, 1000])
        from_two = predicted(place / "on-2", [2])
        figures["predicted_seconds"] = from_one
        figures["predicted_2_from_2_seconds"] = from_two[2]
        one, two = figures["workers_1_seconds"], figures["workers_2_seconds"]
        print(f"{size['times']} time steps, {size['cols']} × {size['rows']} pixels: lumistack run {figures['run_seconds']:.1f} s")
        print(f"one worker   {one:6.1f} s   predicted {from_one[1]:6.1f} s ({from_one[1] / one - 1:+.0%})")
        print(f"two workers  {two:6.1f} s   predicted {from_one[2]:6.1f} s ({from_one[2] / two - 1:+.0%}), from the times of two workers {from_two[2]:.1f} s ({from_two[2] / two - 1:+.0%})   {one / two:.2f} times faster")
        for workers in (10, 100, 1000):
            print(f"{workers:4} workers  predicted {from_one[workers]:6.1f} s   {from_one[1] / from_one[workers]:.1f} times faster than one")
        figures["seams"] = seams(place, job, size["times"])
        for warm_up, seam in figures["seams"].items():
            print(
                f"chunks of {size['times'] // 4} time steps, {warm_up} to warm up: at the first time step of a chunk, PSNR {seam['psnr_view']:+.2f} dB "
                f"and flicker score {seam['psnr_change']:+.2f} dB at worst; {seam['solves']:.2f} times the solves"
            )
        figures["kills"] = kill_often(job, place / "killed", options, 20)
        assert results(place / "killed") == expected, "bytes differ after kills"
        print(f"{figures['kills']} kills, one of them of the client: equal bytes")
        figures["full_disk"] = full_disk(job, expected, options)
        print(f"full disk: {figures['full_disk']}")
    if given.json:
        given.json.write_text(json.dumps(figures, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Long work: interrupts, callbacks, threads, and the release of Python's lock."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import textwrap
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import lumistack

#: Largest processor time from an interrupt to the end of the work, seconds, summed over all cores:
#: one second per core. On an idle machine the work ends after less than 0.2 s. Other programs delay
#: the end, but do not add to the processor time of this work.
PATIENCE = 1.0 * (os.cpu_count() or 1)


def processor_time(child: subprocess.Popen[str]) -> float:
    """Processor time that a child process has used, seconds; from `/proc` of Linux."""
    fields = Path(f"/proc/{child.pid}/stat").read_text().rpartition(")")[2].split()
    user, system = fields[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def interruptible() -> None:
    """Enables interrupts in a child process. A test suite in the background may ignore interrupts,
    and its child processes would inherit this setting."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


HEAD = """
import sys, time, numpy, lumistack
display = lumistack.Display("paper-three-layer", resolution=(420, 262), views=(5, 5))
field = lumistack.LightField(numpy.random.default_rng(1).random(display.light_field_shape, numpy.float32), display=display)
scene = sys.argv[1]
started = []
def callback(stage, share):
    if not started:
        started.append(1); print("started", flush=True)
try:
    {call}
except KeyboardInterrupt:
    print("interrupted", time.process_time(), flush=True)
    print(lumistack.factorize(field, iterations=0).frames, "frames", flush=True)
"""


@pytest.mark.parametrize(
    "call",
    [
        "lumistack.factorize(field, iterations=100000, callback=callback)",
        "lumistack.render(scene, display, samples=65536, callback=callback)",
        "lumistack.run({'scene': scene, 'render': {'samples': 60000}, 'display': {'preset': 'paper-three-layer', 'resolution': [420, 262]}}, sys.argv[2], callback=callback)",
    ],
    ids=["factorize", "render", "run"],
)
def test_ctrl_c_interrupts(call: str, scene: Path, tmp_path: Path) -> None:
    program = HEAD.replace("{call}", call)
    words = [sys.executable, "-c", program, str(scene), str(tmp_path / "run")]
    child = subprocess.Popen(words, stdout=subprocess.PIPE, text=True, preexec_fn=interruptible)
    assert child.stdout is not None and child.stdout.readline().strip() == "started"
    time.sleep(0.5)
    asked = processor_time(child)
    child.send_signal(signal.SIGINT)
    word, at = child.stdout.readline().split()
    took = float(at) - asked
    print(f"interrupted after {took:.3f} s of processor time")
    assert word == "interrupted" and took < PATIENCE
    assert child.stdout.readline().strip() == "12 frames", "the package still works"
    assert child.wait() == 0


def test_ctrl_c_ends_the_command_with_130(scene: Path, tmp_path: Path) -> None:
    # at the display's full resolution, the run would need many gigabytes of disk space
    size = ["--resolution", "420x262", "--samples", "60000"]
    words = [sys.executable, "-m", "lumistack", "run", str(scene), *size, "-o", str(tmp_path / "run")]
    child = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, preexec_fn=interruptible)
    assert child.stderr is not None
    for line in child.stderr:
        if line.startswith("render"):
            break
    time.sleep(0.3)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    asked = processor_time(child)
    child.send_signal(signal.SIGINT)
    assert child.wait(timeout=120) == 130
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    in_all = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    assert in_all - asked < PATIENCE
    assert "stopped; run the same command again" in child.stderr.read()


def test_the_lock_is_released(slow: tuple[lumistack.LightField, lumistack.Display]) -> None:
    light_field, _ = slow
    counts: list[int] = []

    def count() -> None:
        # Every step of this loop needs Python's lock.
        end, n = time.perf_counter() + 0.3, 0
        while time.perf_counter() < end:
            n += 1
        counts.append(n)

    count()
    stop = threading.Event()
    worker = threading.Thread(target=count)

    def begin(stage: str, share: float) -> None:
        if not stop.is_set():
            stop.set()
            worker.start()
        if not worker.is_alive():
            raise StopIteration("counted")

    with pytest.raises(StopIteration, match="counted"):
        lumistack.factorize(light_field, iterations=100000, callback=begin)
    alone, beside = counts
    # The solver's threads leave this thread a part of a core. If the call held the lock, this
    # thread would count nothing.
    assert beside > 0.1 * alone, counts


def test_an_exception_of_the_callback_stops_the_work(slow: tuple[lumistack.LightField, lumistack.Display]) -> None:
    light_field, _ = slow

    def fail(stage: str, share: float) -> None:
        raise LookupError(stage)

    # Without a stop, the work would take hours.
    start = time.process_time()
    with pytest.raises(LookupError, match="factorize"):
        lumistack.factorize(light_field, iterations=100000, callback=fail)
    assert time.process_time() - start < 20.0


def test_work_in_several_threads(light_field: lumistack.LightField) -> None:
    with ThreadPoolExecutor(4) as pool:
        stacks = list(pool.map(lambda seed: lumistack.factorize(light_field, iterations=3, seed=seed), [5, 6, 5, 6]))
    first = [stack.layers[0].tobytes() for stack in stacks]
    assert first[0] == first[2] and first[1] == first[3]


def test_progress_is_reported_from_begin_to_end(light_field: lumistack.LightField) -> None:
    news: list[tuple[str, float]] = []
    lumistack.factorize(light_field, iterations=7, callback=lambda stage, share: news.append((stage, share)))
    shares = [share for stage, share in news if stage == "factorize"]
    assert shares == sorted(shares) and shares[-1] == 1.0
    with pytest.raises(TypeError):
        lumistack.factorize(light_field, iterations=1, callback=3)  # type: ignore[arg-type]


def test_the_command(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert lumistack.main(["displays"]) == 0
    assert "paper-three-layer" in capfd.readouterr().out
    assert lumistack.main(["info", str(tmp_path / "no.glb")]) == 1
    assert "error: " in capfd.readouterr().err
    assert lumistack.main(["walk"]) == 2
    assert lumistack.main(["--version"]) == 0
    assert lumistack.__version__ in capfd.readouterr().out
    installed = Path(sys.executable).with_name("lumistack")
    if installed.exists():
        said = subprocess.run([installed, "displays"], capture_output=True, text=True, check=True).stdout
        assert said.count("\n") == len(lumistack.displays())


def test_importing_needs_no_numpy() -> None:
    program = """
    import sys
    sys.modules["numpy"] = None
    import lumistack
    field = lumistack.LightField(memoryview(bytes(4 * 3 * 8 * 8)).cast("f", (1, 1, 8, 8, 3)), pitch_mm=1.0)
    stack = lumistack.factorize(field, "fig7-uniform", iterations=1)
    assert memoryview(stack.arrays[0]).shape == (stack.frames, 8, 8, 3)
    try:
        field.radiance
    except ImportError as error:
        assert "pip install numpy" in str(error)
    else:
        raise SystemExit("numpy came from nowhere")
    """
    environment = {**os.environ, "PYTHONWARNINGS": "ignore"}
    subprocess.run([sys.executable, "-c", textwrap.dedent(program)], check=True, env=environment)

"""Threads of Python that solve, simulate and read arrays at the same time. A free-threaded Python runs
them without its lock."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy
from numpy.typing import NDArray

import lumistack

T = TypeVar("T")

#: Number of threads. It exceeds the processors of many machines, so that threads interrupt each other.
THREADS = 8


def at_once(work: Callable[[int], T]) -> list[T]:
    """Returns the results of `work(0)`, `work(1)`, ..., each computed in its own thread."""
    start = threading.Barrier(THREADS)

    def begin(thread: int) -> T:
        start.wait()
        return work(thread)

    with ThreadPoolExecutor(THREADS) as threads:
        return list(threads.map(begin, range(THREADS)))


def test_threads_that_solve_and_simulate_get_the_values_of_one_thread(
    display: lumistack.Display, light_field: lumistack.LightField
) -> None:
    # every second thread uses the same seed, so that equal and different work overlaps
    def work(thread: int) -> list[NDArray[numpy.float32]]:
        found = []
        for turn in range(3):
            stack = lumistack.factorize(light_field, display, iterations=3, start="random", seed=thread % 2 + turn)
            found += [*stack.layers, stack.simulate((0.05 * turn, 0.0)), stack.weights(light_field)]
        return found

    alone = [work(0), work(1)]
    assert not numpy.array_equal(alone[0][0], alone[1][0])
    for thread, found in enumerate(at_once(work)):
        assert len(found) == len(alone[0])
        for own, expected in zip(found, alone[thread % 2], strict=True):
            assert numpy.array_equal(own, expected)


def test_threads_share_objects_and_their_memory(
    display: lumistack.Display, light_field: lumistack.LightField, radiance: NDArray[numpy.float32]
) -> None:
    stack = light_field.factorize(iterations=2)
    expected = stack.simulate((0.0, 0.05))

    def work(thread: int) -> bool:
        same = True
        for _ in range(20):
            # buffers are exported, sliced and released while other threads do the same
            view = light_field[thread % 3, thread // 3 % 3]
            same &= bool(numpy.array_equal(view, radiance[thread % 3, thread // 3 % 3]))
            same &= memoryview(stack.arrays[0]).nbytes == stack.layers[0].nbytes
            same &= bool(numpy.array_equal(lumistack.LightField(radiance, display=display).radiance, radiance))
            same &= bool(numpy.array_equal(stack.simulate((0.0, 0.05)), expected))
        return same

    assert all(at_once(work))


def test_errors_and_callbacks_stay_in_their_threads(
    display: lumistack.Display, light_field: lumistack.LightField
) -> None:
    def work(thread: int) -> str:
        seen: set[int] = set()

        def callback(stage: str, fraction: float) -> None:
            seen.add(threading.get_ident())
            if thread % 2:
                raise KeyError(f"stop {thread}")

        try:
            light_field.factorize(display, iterations=20, callback=callback)
        except KeyError as error:
            return f"{error.args[0]} {seen == {threading.get_ident()}}"
        return f"done {seen == {threading.get_ident()}}"

    expected = [f"stop {thread} True" if thread % 2 else "done True" for thread in range(THREADS)]
    assert at_once(work) == expected


#: Program of a new process, whose threads make the first calls of the package. These calls build
#: tables and find the plugins. The first line of output states whether Python's lock is on.
FIRST = """
import sys, threading
import lumistack
texts = []
def work():
    start.wait()
    plugins = lumistack.plugins()
    texts.append(repr((plugins, lumistack.displays(), lumistack.defaults(), lumistack.Display("paper-three-layer"))))
start = threading.Barrier(8)
threads = [threading.Thread(target=work) for _ in range(8)]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
print(getattr(sys, "_is_gil_enabled", lambda: True)())
print(len(texts), len(set(texts)))
"""


def test_first_calls_of_many_threads_agree_and_a_free_threaded_python_keeps_no_lock() -> None:
    said = subprocess.run([sys.executable, "-c", FIRST], capture_output=True, text=True, check=True, timeout=120)
    has_lock = not sysconfig.get_config_var("Py_GIL_DISABLED")
    assert said.stdout.split() == [str(has_lock), "8", "1"], said.stderr

"""Code that runs on a worker: executes a unit as a child process, and describes the machine.
Results are texts in JSON."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from typing import Any

from lumistack.farm import _store

# Interval between checks that the client still waits for a running unit, seconds.
LOOK_SECONDS = 0.2
# Longest time that a unit has to stop before it is killed, seconds.
STOP_SECONDS = 10.0
# Number of characters that are kept from the end of a child's output.
MOST_SAID = 4000


def _program(words: list[str] | None) -> list[str]:
    """Returns the command that starts the program on this worker."""
    return words or [sys.executable, "-m", "lumistack"]


def _answer(text: str, event: str) -> dict[str, Any] | None:
    """Returns the last line of JSON in `text` whose `event` has this name."""
    for line in reversed(text.splitlines()):
        if line.startswith("{"):
            try:
                found = json.loads(line)
            except ValueError:
                continue
            if isinstance(found, dict) and found.get("event") == event:
                return found
    return None


def probe(words: list[str] | None, folder: str, store: dict[str, Any] | None = None) -> str:
    """Returns version and fingerprint of the program on this worker, and whether the worker has access
    to the run folder or the store."""
    about: dict[str, Any] = {"host": os.uname().nodename if hasattr(os, "uname") else "", "process": os.getpid()}
    if store is None:
        about["folder"] = os.path.isdir(folder)
    else:
        try:
            about["folder"] = _store.Run(store["url"], store["plan"]).has_begun()
        except _store.StoreError as error:
            about["store"] = str(error)
    try:
        found = subprocess.run([*_program(words), "--json", "farm", "code"], capture_output=True, text=True, timeout=120)
        answer = _answer(found.stdout, "code")
        about.update(answer or {"error": (found.stderr or found.stdout).strip()[-MOST_SAID:]})
    except (OSError, subprocess.TimeoutExpired) as error:
        about["error"] = str(error)
    return json.dumps(about)


def _is_wanted() -> bool:
    """Returns true if the client still waits for the task of this thread. The client does not wait
    if it has ended or has cancelled the task."""
    try:
        from distributed import get_worker

        worker = get_worker()
        state = worker.state.tasks.get(worker.get_current_task())
    except (ImportError, ValueError, AttributeError):
        return True
    return state is not None and state.state == "executing"


def _address() -> str:
    """Returns this worker's address, by which the client's messages name the worker."""
    try:
        from distributed import get_worker

        return str(get_worker().address)
    except (ImportError, ValueError):
        return ""


def _threads(given: int | None) -> int:
    """Returns the number of threads of a unit: the given number, or else the machine's cores divided by
    the worker's threads."""
    if given is not None:
        return given
    try:
        from distributed import get_worker

        of_worker: int = get_worker().state.nthreads
    except (ImportError, ValueError, AttributeError):
        of_worker = 1
    return max(1, (os.cpu_count() or 1) // max(1, of_worker))


def execute(
    words: list[str] | None, folder: str, unit: str, maps: list[str], threads: int | None, store: dict[str, Any] | None = None
) -> str:
    """Executes a unit. Never raises: the returned text contains the result, errors included.

    `store`: the object store that replaces a shared folder. It has its `url`, the id of the `plan`,
    the units that this unit `needs`, and the folders that were `sent`.
    """
    if store is None:
        return _execute(words, folder, unit, maps, threads)
    try:
        mirror = _store.Mirror.of(store["url"], store["plan"])
        found = mirror.take(unit, store["needs"], store["sent"])
        text = _execute(words, str(mirror.folder), unit, [*maps, *found], threads)
        if json.loads(text)["outcome"] == "done":
            mirror.publish(unit)
    except (_store.StoreError, OSError) as error:
        return json.dumps({"id": unit, "outcome": "store", "message": str(error), "worker": _address()})
    return text


def _execute(words: list[str] | None, folder: str, unit: str, maps: list[str], threads: int | None) -> str:
    line = [*_program(words), "--json", "--threads", str(_threads(threads)), "farm", "unit", "--attached"]
    for pair in maps:
        line += ["--map", pair]
    try:
        # The unit ends when its standard input closes, so it never outlives this process.
        child = subprocess.Popen(
            [*line, folder, unit],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            # Only the client handles Ctrl-C; it then cancels the task.
            process_group=0 if os.name == "posix" else None,
        )
    except OSError as error:
        return json.dumps({"id": unit, "outcome": "refused", "message": str(error), "worker": _address()})
    said: dict[str, str] = {}

    def listen(name: str, stream: Any) -> None:
        kept = ""
        for text in stream:
            kept = (kept + text)[-MOST_SAID:]
        said[name] = kept

    listeners = [threading.Thread(target=listen, args=pair) for pair in (("out", child.stdout), ("err", child.stderr))]
    for listener in listeners:
        listener.start()
    wanted = True
    while True:
        try:
            child.wait(LOOK_SECONDS)
            break
        except subprocess.TimeoutExpired:
            if wanted and not _is_wanted():
                wanted = False
                child.terminate()
                threading.Timer(STOP_SECONDS, child.kill).start()
    for listener in listeners:
        listener.join()
    if child.stdin is not None:
        child.stdin.close()
    if not wanted:
        return json.dumps({"id": unit, "outcome": "cancelled"})
    answer = _answer(said.get("out", ""), "unit")
    if answer is None:
        ended = f"ended by signal {-child.returncode}" if child.returncode < 0 else f"ended with code {child.returncode}"
        last = (said.get("err", "") or said.get("out", "")).strip().splitlines()
        answer = {"outcome": "failed", "message": f"{ended}: {last[-1]}" if last else ended}
    answer["id"], answer["worker"] = unit, _address()
    return json.dumps(answer)

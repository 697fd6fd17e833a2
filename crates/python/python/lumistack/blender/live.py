"""A running `lumistack live`: commands to its standard input, events from its standard output.

    files ──▶ {"set": {"scene": FILE, ...}} ──▶ the program ──▶ {"event": "state", ...} ──▶ State

Every scene is a file with a new name, so the program never reads a file that is being written.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

#: Number of files that are kept, of scenes and of displays. Only the newest files are kept, since
#: the program may still read them.
KEPT = 4
#: Longest text of a message.
LONGEST = 400


@dataclass(frozen=True)
class State:
    """The state of the program, from its events."""

    #: Address of the page; empty before the first picture.
    address: str = ""
    #: Number of the shown state, and number of its content. Every change of the scene or the
    #: display makes a new content.
    states: int = 0
    content: int = 0
    #: PSNR of the last state at the solver's views, dB.
    psnr: float | None = None
    #: Seconds from the last change to the first state that shows it.
    latency_s: float | None = None
    #: The last warning or error; empty without one.
    problem: str = ""
    #: Path of the report, after the end.
    report: str = ""
    #: Exit status, after the end.
    code: int | None = None


class Live:
    """A process `lumistack live`, from its start to its end."""

    def __init__(self, words: Sequence[str], environment: Mapping[str, str]) -> None:
        """Starts the program with the words of its command line. Raises OSError."""
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(words, env=dict(environment), stdin=pipe, stdout=pipe, stderr=pipe)
        self._lock = threading.Lock()
        self._state = State()
        #: Time of the last change, and the number of the content before it; None once a state shows
        #: the change.
        self._sent: tuple[float, int] | None = None
        self._error = b""
        self._threads = [threading.Thread(target=each, name="lumistack live", daemon=True) for each in (self._read, self._read_errors)]
        for thread in self._threads:
            thread.start()
        # With this setting the program also ends if its caller crashes.
        self.send(stop_at_end=True)

    @property
    def state(self) -> State:
        """The newest state of the program. Its `code` is set after the program has ended."""
        code = self._process.poll()
        if code is not None:
            for thread in self._threads:
                thread.join(1.0)
        with self._lock:
            problem = self._state.problem or (self._error.decode("utf-8", "replace").strip()[-LONGEST:] if code else "")
            return replace(self._state, code=code, problem=problem)

    @property
    def is_shown(self) -> bool:
        """True if a state shows the last change."""
        with self._lock:
            return self._sent is None

    def change(self, keys: Mapping[str, Any], since: float) -> None:
        """Sets keys of the job, all at once; since: the time of the change (`time.monotonic`)."""
        with self._lock:
            self._sent = (since, self._state.content)
            self._state = replace(self._state, problem="")
        self.send(set=dict(keys))

    def send(self, **entries: Any) -> None:
        """Sends a line to the program. After the end of the program, which `state` reports, this has no
        effect."""
        stdin = self._process.stdin
        if stdin is not None:
            with contextlib.suppress(OSError, ValueError):
                stdin.write(json.dumps(entries).encode() + b"\n")
                stdin.flush()

    def stop(self) -> None:
        """Makes the program write its run folder and end; does not wait."""
        self.send(stop=True)

    def end(self, patience_s: float) -> None:
        """Stops the program and waits for its end; kills it after `patience_s` seconds."""
        self.stop()
        try:
            self._process.wait(patience_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            try:
                event = json.loads(line)
            except ValueError:
                continue
            if isinstance(event, dict):
                self._take(event)

    def _take(self, event: Mapping[str, Any]) -> None:
        with self._lock:
            state = self._state
            match event.get("event"):
                case "serving":
                    state = replace(state, address=event["address"])
                case "state":
                    content, latency_s = event["content"], state.latency_s
                    if self._sent is not None and content > self._sent[1]:
                        latency_s, self._sent = time.monotonic() - self._sent[0], None
                    state = replace(state, states=event["number"], content=content, psnr=event["psnr_view"], latency_s=latency_s)
                case "refused":
                    # After an error the display keeps its state, so no state will show this change.
                    state, self._sent = replace(state, problem=event["message"][:LONGEST]), None
                case "warning":
                    state = replace(state, problem=f"{event['place']}: {event['message']}"[:LONGEST])
                    if event["place"] == "live":
                        self._sent = None
                case "done":
                    state = replace(state, report=event["report"])
            self._state = state

    def _read_errors(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            with self._lock:
                self._error = (self._error + line)[-4 * LONGEST :]


class Files:
    """Numbered files of one folder. Only the newest (`KEPT`) stay."""

    def __init__(self, folder: Path, stem: str, suffix: str) -> None:
        """Makes the folder, and removes the files of earlier sessions. Raises OSError."""
        self._folder, self._stem, self._suffix = folder, stem, suffix
        self._number = 0
        folder.mkdir(parents=True, exist_ok=True)
        for path in folder.glob(f"{stem}-*{suffix}"):
            path.unlink()

    def next(self) -> Path:
        """Returns the path of a new file, and removes the oldest file."""
        self._path(self._number - KEPT).unlink(missing_ok=True)
        self._number += 1
        return self._path(self._number)

    def back(self) -> None:
        """Removes the newest file; the next file gets its number."""
        self._path(self._number).unlink(missing_ok=True)
        self._number -= 1

    def _path(self, number: int) -> Path:
        return self._folder / f"{self._stem}-{number:05}{self._suffix}"


def toml_of(job: Mapping[str, Any]) -> str:
    """Returns a job as TOML. Its values are plain, or tables of plain values."""
    plain = [f"{key} = {_value(value)}" for key, value in job.items() if not isinstance(value, Mapping)]
    tables = [
        f"\n[{name}]\n" + "\n".join(f"{key} = {_value(value)}" for key, value in table.items())
        for name, table in job.items()
        if isinstance(table, Mapping)
    ]
    return "\n".join([*plain, *tables]) + "\n"


def _value(value: Any) -> str:
    # JSON's texts, numbers, truth values and lists are also TOML's.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")

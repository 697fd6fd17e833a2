"""A running `lumistack live`: commands to it, events from it.

    files ──▶ {"set": {"scene": FILE, ...}} ──▶ the program ──▶ {"event": "state", ...} ──▶ State

`Live` starts the program, and uses its standard input and output. `Attached` uses the socket of a
program that already runs. Every scene is a file with a new name, so the program never reads a file
that is being written.
"""

from __future__ import annotations

import contextlib
import json
import socket
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

#: Number of earlier scene files that are kept besides the newest, and of earlier display files. The
#: program may still read these files.
KEPT = 4
#: Largest number of characters of a message.
LONGEST = 400
#: Longest wait for the first answer of a running program after `Attached` connects to it, seconds.
ANSWER_S = 5.0


@dataclass(frozen=True)
class State:
    """The state of the program, from its events."""

    #: Address of the page; empty before the first picture.
    address: str = ""
    #: Number of the shown state.
    states: int = 0
    #: Number of the shown state's content. Every change of the scene or the display makes a new
    #: content.
    content: int = 0
    #: PSNR of the last state at the solver's views, dB.
    psnr: float | None = None
    #: Seconds from the last change to the first state that shows it.
    latency_s: float | None = None
    #: The last warning or error since the last change; empty without one.
    problem: str = ""
    #: Path of the report, after the end of the program.
    report: str = ""
    #: Exit status, after the end of the program; None before.
    code: int | None = None


class Program:
    """A `lumistack live` program: the state of its display, and the changes that are sent to it."""

    #: The lines to the program.
    _commands: IO[bytes] | None

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._state = State()
        #: Time of the last change, and the number of the content before it; None once a state shows
        #: the change, or the program has refused it.
        self._sent: tuple[float, int] | None = None

    @property
    def state(self) -> State:
        """The state. Its `code` is set after the end of the program or of the connection."""
        raise NotImplementedError

    @property
    def is_shown(self) -> bool:
        """True if a state shows the last change, or if the program has refused it."""
        with self._lock:
            return self._sent is None

    def change(self, keys: Mapping[str, Any], since: float) -> None:
        """Sets keys of the job, all in one step. `since`: the time of the change
        (`time.monotonic`)."""
        with self._lock:
            self._sent = (since, self._state.content)
            self._state = replace(self._state, problem="")
        self.send(set=dict(keys))

    def send(self, **entries: Any) -> None:
        """Sends a line to the program. After the end of the program, which `state` reports, this has no
        effect."""
        if self._commands is None or self._commands.closed:
            return
        try:
            self._commands.write(json.dumps(entries).encode() + b"\n")
            self._commands.flush()
        except OSError:
            # The stream still holds the line, and would write it again when Python destroys the
            # stream. So close the stream here, where the error is expected.
            with contextlib.suppress(OSError):
                self._commands.close()

    def stop(self) -> None:
        """Requests the end; does not wait."""
        raise NotImplementedError

    def end(self, patience_s: float) -> None:
        """Requests the end, and waits for it."""
        raise NotImplementedError

    def _read(self, lines: IO[bytes]) -> None:
        for line in lines:
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


class Live(Program):
    """A program that this object starts and ends."""

    def __init__(self, words: Sequence[str], environment: Mapping[str, str]) -> None:
        """Starts the program with the words of its command line. Raises OSError."""
        super().__init__()
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(words, env=dict(environment), stdin=pipe, stdout=pipe, stderr=pipe)
        assert self._process.stdout is not None
        self._commands = self._process.stdin
        self._error = b""
        reads = ((self._read, (self._process.stdout,)), (self._read_errors, ()))
        self._threads = [threading.Thread(target=each, args=args, name="lumistack live", daemon=True) for each, args in reads]
        for thread in self._threads:
            thread.start()
        # From now on the end of standard input stops the program. So the program also ends if its
        # caller crashes.
        self.send(stop_at_end=True)

    @property
    def state(self) -> State:
        """The state. After the end of the program, its `code` is the exit status."""
        code = self._process.poll()
        if code is not None:
            for thread in self._threads:
                thread.join(1.0)
        with self._lock:
            problem = self._state.problem or (self._error.decode("utf-8", "replace").strip()[-LONGEST:] if code else "")
            return replace(self._state, code=code, problem=problem)

    def stop(self) -> None:
        """Makes the program write its run folder and end; does not wait."""
        self.send(stop=True)

    def end(self, patience_s: float) -> None:
        """Stops the program and waits for its end. Kills the program after `patience_s`."""
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

    def _read_errors(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            with self._lock:
                self._error = (self._error + line)[-4 * LONGEST :]


class Attached(Program):
    """A program that runs already. It continues after the end of the connection."""

    def __init__(self, run: Path) -> None:
        """Attaches to the program of a run folder. Raises OSError, with a message, if no program
        runs there, or if the program refuses."""
        super().__init__()
        path = run / "cache" / "live.json"
        expected = f"{run}: expected the run folder of a `lumistack live` that runs"
        try:
            door = json.loads(path.read_text(encoding="utf-8"))
            port, token = int(door["port"]), str(door["token"])
        except FileNotFoundError as error:
            raise FileNotFoundError(f"{expected}, found a folder without the file {path.relative_to(run)}") from error
        except (ValueError, KeyError, TypeError) as error:
            raise OSError(f"{path}: expected a port and a token, found other content") from error
        try:
            self._socket = socket.create_connection(("127.0.0.1", port), ANSWER_S)
            self._commands, self._events = self._socket.makefile("wb"), self._socket.makefile("rb")
            self.send(token=token)
            answer = dict(json.loads(self._events.readline() or b"{}"))
        except (OSError, ValueError, TypeError) as error:
            raise OSError(f"{expected}, found the folder of a program that has ended ({error})") from error
        if answer.get("event") != "attached":
            self._socket.close()
            raise OSError(f"{run}: {answer.get('message', 'the program ended the connection')}")
        self._socket.settimeout(None)
        self._thread = threading.Thread(target=self._read, args=(self._events,), name="lumistack live", daemon=True)
        self._thread.start()

    @property
    def state(self) -> State:
        """The state; its `code` is 0 after the end of the connection."""
        with self._lock:
            return replace(self._state, code=None if self._thread.is_alive() else 0)

    def stop(self) -> None:
        """Requests the end of the connection. The display keeps its last state."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)

    def end(self, patience_s: float) -> None:
        """Ends the connection, and waits until the program can accept another connection."""
        self.stop()
        self._thread.join(patience_s)
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def _read(self, lines: IO[bytes]) -> None:
        # A program that is killed resets the connection.
        with contextlib.suppress(OSError):
            super()._read(lines)


class Files:
    """Numbered files of one folder. Only the newest file and `KEPT` earlier files stay."""

    def __init__(self, folder: Path, stem: str, suffix: str) -> None:
        """Makes the folder. Numbers continue after the files of earlier sessions, since a running
        program may still read the newest of these files. Raises OSError."""
        self._folder, self._stem, self._suffix = folder, stem, suffix
        folder.mkdir(parents=True, exist_ok=True)
        numbers = [path.name[len(stem) + 1 : -len(suffix)] for path in folder.glob(f"{stem}-*{suffix}")]
        self._number = max((int(number) for number in numbers if number.isdecimal()), default=0)

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
    # Texts, numbers, truth values and lists have the same form in JSON and in TOML.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")

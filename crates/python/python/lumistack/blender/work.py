"""Long work off the main thread: it reports progress, can be stopped, and keeps its result or its
error."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any


class Stopped(Exception):
    """The user stopped the work."""


class Work:
    """Work on a thread of its own.

    make(report) does the work. The function make must call report(stage, fraction) regularly, which
    raises Stopped after a request to stop. make may pass report as the callback to functions of the
    package. Then these functions also stop.
    """

    def __init__(self, make: Callable[[Callable[[str, float], None]], Any]) -> None:
        self._make = make
        self._stop = threading.Event()
        self._lock = threading.Lock()
        self._progress = ("", 0.0)
        self.result: Any = None
        self.error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="lumistack", daemon=True)

    def start(self) -> Work:
        self._thread.start()
        return self

    def stop(self) -> None:
        """Requests that the work stops; it stops when it calls `report` the next time."""
        self._stop.set()

    def wait(self, seconds: float | None = None) -> bool:
        """Waits at most `seconds` for the end of the work; returns true if the work has ended."""
        self._thread.join(seconds)
        return self.is_done()

    def is_done(self) -> bool:
        return self._thread.ident is not None and not self._thread.is_alive()

    def was_stopped(self) -> bool:
        return isinstance(self.error, Stopped)

    @property
    def progress(self) -> tuple[str, float]:
        """Returns the name of the current stage, and the finished fraction of the stage."""
        with self._lock:
            return self._progress

    def _report(self, stage: str, fraction: float) -> None:
        with self._lock:
            self._progress = (stage, fraction)
        if self._stop.is_set():
            raise Stopped

    def _run(self) -> None:
        try:
            self._report("", 0.0)
            self.result = self._make(self._report)
        except BaseException as error:  # noqa: BLE001  the main thread reports it
            self.error = error

"""Progress of long calls without a callback: a line in a terminal, a bar in a notebook. Elsewhere
the line appears only after `set_progress(True)`."""

from __future__ import annotations

import importlib
import sys
import threading
import time
from typing import Any

#: Time before the first output, seconds. Shorter work shows no progress.
_PATIENCE = 0.5
#: Interval between outputs, seconds.
_PAUSE = 0.1

_wanted: bool | None = None


def set_progress(shown: bool | None = None) -> None:
    """Sets whether long calls show their progress.

    shown: True for always, False for never, None for terminals and notebooks only (the default). In
    two cases a call shows nothing: outside of the main thread, and with a callback, which receives
    the progress.

    >>> set_progress(False)
    """
    global _wanted
    _wanted = shown


class _Shown:
    """Shows (stage, fraction), with an estimate of the stage's remaining time."""

    def __init__(self) -> None:
        self._begin = self._last = self._stage_begin = time.monotonic()
        self._stage = ""
        self._was_shown = False

    def __call__(self, stage: str, fraction: float) -> None:
        now = time.monotonic()
        if stage != self._stage:
            self._stage, self._stage_begin = stage, now
        if now - self._begin < _PATIENCE or now - self._last < _PAUSE:
            return
        self._last, self._was_shown = now, True
        spent = now - self._stage_begin
        # The speed of the first second is no reliable estimate.
        is_known = fraction > 0.02 and spent > 1.0
        remains = f", {_duration(spent / fraction - spent)} left" if is_known and fraction < 1.0 else ""
        self.show(stage, fraction, f"{stage}: {100 * fraction:.0f} %{remains}")

    def close(self) -> None:
        if self._was_shown:
            self.clear()

    def show(self, stage: str, fraction: float, text: str) -> None:
        raise NotImplementedError

    def clear(self) -> None:
        raise NotImplementedError


class _Line(_Shown):
    def show(self, stage: str, fraction: float, text: str) -> None:
        sys.stderr.write(f"\r{text}\x1b[K")
        sys.stderr.flush()

    def clear(self) -> None:
        sys.stderr.write("\r\x1b[K")
        sys.stderr.flush()


class _Bar(_Shown):
    def __init__(self, display: Any, html: Any) -> None:
        super().__init__()
        self._display, self._html = display, html
        self._handle: Any = None

    def show(self, stage: str, fraction: float, text: str) -> None:
        bar = self._html(f'<progress max="1" value="{fraction:.3f}" aria-label="{stage}"></progress> {text}')
        if self._handle is None:
            self._handle = self._display(bar, display_id=True)
        else:
            self._handle.update(bar)

    def clear(self) -> None:
        self._handle.update(self._html(""))


def shown() -> _Shown | None:
    """Returns the output of progress for work that begins now; None if there is no output."""
    if _wanted is False or threading.current_thread() is not threading.main_thread():
        return None
    if _in_notebook():
        ipython = importlib.import_module("IPython.display")
        return _Bar(ipython.display, ipython.HTML)
    is_terminal = sys.stderr is not None and sys.stderr.isatty()
    return _Line() if is_terminal or (_wanted and sys.stderr is not None) else None


def _in_notebook() -> bool:
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None and hasattr(ipython, "get_ipython") else None
    return shell is not None and hasattr(shell, "kernel")


def _duration(seconds: float) -> str:
    whole = max(1, round(seconds))
    return f"{whole} s" if whole < 60 else f"{whole // 60} min {whole % 60:02} s"

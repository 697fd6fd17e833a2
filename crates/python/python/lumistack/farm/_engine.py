"""The client of a farm. It submits units whose inputs are finished, and reads the results of these
units. Then it submits the units that depend on these results."""

from __future__ import annotations

import json
import multiprocessing
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any
from urllib.parse import urlsplit

from lumistack.farm import _store, _work

# Number of failures after which a unit is abandoned.
MOST_FAILURES = 3
# Number of losses after which a unit is abandoned. A unit is lost with its worker. The number is
# high, since preempted workers are not the unit's fault.
MOST_LOSSES = 50
# Longest time to wait for the first worker, seconds.
WORKER_SECONDS = 60.0
# Interval between checks of the workers while no unit ends, seconds.
TEND_SECONDS = 2.0
# Name of the resource by which workers may offer memory; its unit is bytes.
MEMORY = "memory"


class FarmError(Exception):
    """A run did not finish. The results of finished units are kept, and a repeated call continues with
    the remaining units."""


@dataclass(frozen=True)
class Unit:
    """A unit of work."""

    id: str
    kind: str
    inputs: tuple[str, ...]
    seconds: float
    memory_bytes: int
    to_end_seconds: float
    done: bool


@dataclass
class Outcome:
    """The result of a run."""

    seconds: float = 0.0
    done: list[str] = field(default_factory=list)
    """Units that were executed by this call."""
    before: int = 0
    """Number of units that earlier calls had executed."""
    failed: dict[str, str] = field(default_factory=dict)
    """Abandoned units, with the cause."""
    left: list[str] = field(default_factory=list)
    """Units that depend on abandoned units."""
    refused: dict[str, str] = field(default_factory=dict)
    """Workers that could not be used, with the reason."""
    lost: int = 0
    """Number of attempts that were lost with their worker, or that a worker refused."""


Tell = Callable[[dict[str, Any]], None]


def quiet(event: dict[str, Any]) -> None:
    """Reports nothing."""


def plan(
    job: str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    options: Sequence[str] = (),
    program: Sequence[str] | None = None,
) -> dict[str, Any]:
    """Plans a job into its run folder; `options` are options of `lumistack farm plan`. Returns the
    units and their state."""
    _check_main()
    words = [*(program or [sys.executable, "-m", "lumistack"]), "--json", "farm", "plan", os.fspath(job), "-o", os.fspath(folder), *options]
    found = subprocess.run(words, capture_output=True, text=True)
    answer = _work._answer(found.stdout, "farm_plan")
    if found.returncode != 0 or answer is None:
        raise FarmError((found.stderr or found.stdout).strip().removeprefix("error: "))
    return answer


def run(
    job: str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    options: Sequence[str] = (),
    program: Sequence[str] | None = None,
    **engine: Any,
) -> Outcome:
    """Plans a job and executes the plan; `engine` are further arguments of `execute`."""
    return execute(plan(job, folder, options=options, program=program), program=program, **engine)


def execute(
    planned: dict[str, Any],
    *,
    address: str | None = None,
    client: Any = None,
    workers: int = 2,
    threads: int | None = None,
    maps: Sequence[str] = (),
    tls: tuple[str, str, str] | None = None,
    insecure: bool = False,
    program: Sequence[str] | None = None,
    worker_program: Sequence[str] | None = None,
    store: str | None = None,
    send: Sequence[str | os.PathLike[str]] = (),
    tell: Tell = quiet,
) -> Outcome:
    """Executes the units of a plan.

    * `address`: address of a Dask scheduler. Without `address` and `client`, this function starts
    `workers` processes on this machine.
    * `threads`: number of threads of a unit; by default the machine's cores divided by the worker's
    threads.
    * `maps`: texts "/here=/there": paths under /here on this machine are under /there on workers.
    * `tls`: files of the certificate authority, of the certificate and of its key.
    * `worker_program`: command that starts lumistack on workers; by default the package of the
      worker's Python.
    * `store`: object store through which workers exchange files if they share no folder, such as
      "s3://bucket/shots".
    * `send`: folders of this machine whose files are also copied to the store, such as the scene's
    folder.

    Raises FarmError if units were abandoned or no worker can be used; finished units are kept.
    """
    _check_main()
    if address is not None:
        check_address(address, tls is not None, insecure)
    on_workers = list(worker_program) if worker_program else (list(program) if program and address is None and client is None else None)
    if send and store is None:
        raise FarmError("send: expected a `store`, to which the folders are copied, found none")
    start = time.monotonic()
    with connected(address, client, workers, tls) as dask:
        engine = Engine(dask, planned, list(maps), threads, on_workers, tell)
        if store is None:
            outcome = engine.execute()
        else:
            outcome = engine.execute_through(store, [Path(folder).absolute() for folder in send])
    outcome.seconds = time.monotonic() - start
    return outcome


def _check_main() -> None:
    """Refuses calls while a new worker process imports the script that started it."""
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise FarmError(
            "every worker imports the script that starts it: expected calls of lumistack.farm after "
            '`if __name__ == "__main__":`, found a call during this import'
        )


def check_address(address: str, has_tls: bool, insecure: bool) -> None:
    """Refuses schedulers on other machines without TLS: every process that reaches such a scheduler
    can run programs on its workers."""
    parts = urlsplit(address if "://" in address else f"tcp://{address}")
    host = (parts.hostname or "").lower()
    is_here = host in ("localhost", "::1") or re.fullmatch(r"127(\.\d{1,3}){3}", host) is not None
    if parts.scheme == "tls":
        if not has_tls:
            raise FarmError(f"{address}: expected the files of --tls-ca, --tls-cert and --tls-key with tls://, found none")
    elif not (is_here or insecure):
        raise FarmError(
            f"{address}: expected tls:// or an address of this machine, found {parts.scheme}:// to another machine; every process that reaches "
            "such a scheduler can run programs on its workers; --insecure allows this address"
        )


@contextmanager
def connected(address: str | None, client: Any, workers: int, tls: tuple[str, str, str] | None) -> Iterator[Any]:
    """Yields a client of Dask. If no scheduler is named, starts a cluster on this machine."""
    if client is not None:
        yield client
        return
    distributed = _distributed()
    # Results are read as text. A result that needs pickle is refused, since pickles can run code.
    readers: dict[str, Any] = {"deserializers": ["msgpack", "error"]}
    settings = {
        # The class `Engine` counts lost workers, so Dask must not abandon a task earlier.
        "distributed.scheduler.allowed-failures": MOST_LOSSES,
        "distributed.worker.daemon": False,
        "distributed.logging.distributed": "error",
    }
    with import_module("dask").config.set(settings):
        if address is not None:
            security = None
            if tls is not None:
                authority, certificate, key = tls
                security = distributed.Security(
                    tls_ca_file=authority, tls_client_cert=certificate, tls_client_key=key, require_encryption=True
                )
            with distributed.Client(address, security=security, timeout="30s", set_as_default=False, **readers) as dask_client:
                yield dask_client
            return
        memory = _memory_bytes()
        cluster = distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            # No limit: units are child processes, and the workers themselves hold no data.
            memory_limit=0,
            resources={MEMORY: memory / workers},
            silence_logs=50,
        )
        with cluster, distributed.Client(cluster, set_as_default=False, **readers) as dask_client:
            yield dask_client


def _distributed() -> Any:
    try:
        return import_module("distributed")
    except ImportError as error:
        raise FarmError(f"expected the Python package distributed, found none ({error}); `pip install 'lumistack[farm]'` installs distributed") from error


def _has(module: str) -> bool:
    return find_spec(module) is not None


def _memory_bytes() -> float:
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):
        return 8e9


class Engine:
    """The state of a run: which units wait, run, are done or are abandoned."""

    def __init__(
        self, dask: Any, planned: dict[str, Any], maps: list[str], threads: int | None, program: list[str] | None, tell: Tell
    ) -> None:
        self.dask, self.threads, self.program, self.tell = dask, threads, program, tell
        self.code, self.version = str(planned["code"]), str(planned["version"])
        names = [name for name in Unit.__dataclass_fields__ if name != "inputs"]
        self.units = {
            unit["id"]: Unit(inputs=tuple(unit["inputs"]), **{name: unit[name] for name in names}) for unit in planned["units"]
        }
        self.here = Path(planned["folder"])
        self.maps = maps
        self.folder = _mapped(str(self.here), maps)
        # The last unit checks all results, so it always runs.
        last = planned["units"][-1]["id"] if planned["units"] else ""
        self.done = {unit.id for unit in self.units.values() if unit.done and unit.id != last}
        self.outcome = Outcome(before=len(self.done))
        self.running: dict[Any, str] = {}
        self.ended: SimpleQueue[Any] = SimpleQueue()
        # Workers on which a task may run; tasks that may run on all workers have no entry.
        self.bound: dict[Any, list[str]] = {}
        self.failures: dict[str, int] = {}
        self.losses: dict[str, int] = {}
        self.checked: dict[str, str | None] = {}
        self.attempts = 0
        self.unwritable: str | None = None
        self.plan = str(planned["id"])
        self.store: _store.Run | None = None
        self.sent: list[str] = []

    def execute_through(self, url: str, sent: list[Path]) -> Outcome:
        """Executes the units through an object store, and copies their files into the run folder here,
        even if some units failed."""
        last = list(self.units)[-1:]
        try:
            for folder in sent:
                if not folder.is_dir():
                    raise FarmError(f"{folder}: expected a folder to send, found none")
            self.store, self.sent = _store.Run(url, self.plan), [str(folder) for folder in sent]
            self.store.begin(self.here, sent)
            # Workers take inputs from the store. So only units whose files are in the store count
            # as done. A unit that is done only in the run folder of this machine is executed again.
            stored = [unit for unit in self.units if unit not in last and self.store.is_done(unit)]
            missing = [unit for unit in stored if unit not in self.done]
            self.done = set(stored)
            self.outcome.before = len(stored)
            try:
                return self.execute()
            finally:
                self.store.collect(self.here, [*missing, *self.outcome.done])
        except _store.StoreError as error:
            raise FarmError(str(error)) from error

    def execute(self) -> Outcome:
        if self.dask.dashboard_link and _has("bokeh"):
            self.tell({"event": "dashboard", "address": self.dask.dashboard_link})
        self.check_workers(wait=True)
        try:
            self.submit()
            while self.running:
                try:
                    future = self.ended.get(timeout=TEND_SECONDS)
                except Empty:
                    self.tend()
                else:
                    self.take(future)
                self.submit()
        except BaseException:
            # A worker stops a unit whose task is cancelled.
            self.dask.cancel(list(self.running), force=True)
            raise
        return self.end()

    # The next methods check workers.

    def check_workers(self, wait: bool) -> list[str]:
        """Returns the addresses of the usable workers. Reports each unusable worker once."""
        deadline = time.monotonic() + (WORKER_SECONDS if wait else 0.0)
        while True:
            known = list(self.dask.scheduler_info(n_workers=-1)["workers"])
            new = [address for address in known if address not in self.checked]
            if new:
                self.look_at(new)
            usable = [address for address in known if address in self.checked and self.checked[address] is None]
            if usable or time.monotonic() > deadline:
                break
            if known and all(address in self.checked for address in known):
                break
            time.sleep(0.2)
        if not usable and wait:
            reasons = sorted(set(self.outcome.refused.values()))
            if not reasons:
                raise FarmError(f"expected at least one worker at the scheduler, found none within {WORKER_SECONDS:.0f} s")
            named = "; ".join(f"{worker}: {reason}" for worker, reason in self.outcome.refused.items())
            raise FarmError(f"none of the workers can be used: {named}")
        return usable

    def look_at(self, addresses: list[str]) -> None:
        store = None if self.store is None else {"url": self.store.store.url, "plan": self.plan}
        found = self.dask.run(_work.probe, self.program, self.folder, store, workers=addresses, on_error="return")
        for address in addresses:
            text = found.get(address) if isinstance(found, dict) else None
            if _json(text) is None:
                # The worker did not answer, so it is not marked as checked. If it still exists, the
                # next call checks it again.
                continue
            reason = self.objection(text)
            self.checked[address] = reason
            if reason is not None:
                self.refuse(address, reason)

    def objection(self, text: object) -> str | None:
        """Returns the reason why a worker cannot be used, given its description; None if it can be used."""
        about = _json(text) or {}
        if "code" not in about:
            return f"lumistack does not start on this worker: {about.get('error')}"
        if about["code"] != self.code:
            theirs, ours = f"{about.get('version')} ({about['code']})", f"{self.version} ({self.code})"
            return f"the worker has lumistack {theirs}, but the run was planned by lumistack {ours}; install one build on both machines"
        if "store" in about:
            return f"the worker cannot use the store: {about['store']}"
        if self.store is not None and not about.get("folder"):
            return f"the worker does not find the files that this machine wrote to {self.store.store.url}: expected one store for all machines"
        if not about.get("folder"):
            return f"the worker does not find {self.folder}: share the folder with the worker, or map the folder's path (--map /here=/there)"
        return None

    def refuse(self, worker: str, reason: str) -> None:
        self.outcome.refused[worker] = reason
        self.tell({"event": "refused", "worker": worker, "reason": reason})

    # The next methods submit units and handle their results.

    def ready(self) -> list[Unit]:
        busy = set(self.running.values()) | self.done | set(self.outcome.failed)
        found = [unit for unit in self.units.values() if unit.id not in busy and all(i in self.done for i in unit.inputs)]
        return sorted(found, key=lambda unit: -unit.to_end_seconds)

    def tend(self) -> None:
        """Cancels tasks that may run only on lost workers. A worker that restarts has another address, so
        such a task would wait forever."""
        usable = self.check_workers(wait=False)
        for future, workers in list(self.bound.items()):
            if not future.done() and usable and not set(workers) & set(usable):
                self.lose(self.running.pop(future))
                del self.bound[future]
                future.cancel()

    def submit(self) -> None:
        if self.unwritable is not None:
            return
        # Find the usable workers, and the largest memory that one of them offers.
        ready = self.ready()
        if not ready:
            return
        usable = self.check_workers(wait=True)
        offered = self.memory_of(usable)
        everyone = not self.outcome.refused
        # Submit every ready unit; units on the critical path come first.
        for unit in ready:
            self.attempts += 1
            options: dict[str, Any] = {}
            if offered:
                # A unit whose estimate exceeds the memory of every worker would never be scheduled.
                options["resources"] = {MEMORY: min(float(unit.memory_bytes), offered)}
            if not everyone:
                options["workers"] = usable
            future = self.dask.submit(
                _work.execute,
                self.program,
                self.folder,
                unit.id,
                self.maps,
                self.threads,
                self.of_store(unit),
                key=f"lumistack-{os.getpid()}-{self.attempts}-{unit.id}",
                priority=unit.to_end_seconds,
                pure=False,
                retries=0,
                **options,
            )
            self.running[future] = unit.id
            if not everyone:
                self.bound[future] = usable
            future.add_done_callback(self.ended.put)

    def of_store(self, unit: Unit) -> dict[str, Any] | None:
        """Returns the data with which a worker executes a unit through a store. The data name all
        units on which the unit depends, directly or through other units. None without a store."""
        if self.store is None:
            return None
        needs: dict[str, None] = {}
        waiting = list(unit.inputs)
        while waiting:
            name = waiting.pop()
            if name not in needs:
                needs[name] = None
                waiting += self.units[name].inputs
        # The units have the order of the plan. If several units write a file, the last one's
        # version is used.
        ordered = [name for name in self.units if name in needs]
        return {"url": self.store.store.url, "plan": self.plan, "needs": ordered, "sent": self.sent}

    def memory_of(self, usable: list[str]) -> float:
        """Returns the largest memory that a worker offers, bytes; 0 if any worker offers none."""
        info = self.dask.scheduler_info(n_workers=-1)["workers"]
        offers = [float(info[address].get("resources", {}).get(MEMORY, 0.0)) for address in usable if address in info]
        return max(offers) if offers and min(offers) > 0 else 0.0

    def take(self, future: Any) -> None:
        unit = self.running.pop(future, None)
        self.bound.pop(future, None)
        if unit is None:
            return
        answer, lost = None, False
        if future.status == "finished":
            answer = _json(future.result())
        else:
            lost = True
        if answer is None or answer.get("id") != unit:
            answer = {"outcome": "lost" if lost else "failed", "message": "the worker's answer is unreadable"}
        outcome, message = str(answer.get("outcome")), str(answer.get("message", ""))
        if outcome == "done":
            self.done.add(unit)
            self.outcome.done.append(unit)
            count = {"done": len(self.done), "units": len(self.units)}
            self.tell({"event": "done_unit", "id": unit, "seconds": answer.get("seconds"), **count})
        elif outcome in ("lost", "cancelled"):
            # The worker is gone, or the scheduler has given the task to another worker.
            self.lose(unit)
        elif outcome == "refused":
            # The worker appeared or changed after the last check of workers, so check it again.
            self.checked.pop(str(answer.get("worker")), None)
            self.lose(unit)
        else:
            self.fail(unit, message, of_store=outcome == "store")

    def lose(self, unit: str) -> None:
        self.outcome.lost += 1
        self.losses[unit] = self.losses.get(unit, 0) + 1
        if self.losses[unit] >= MOST_LOSSES:
            self.give_up(unit, f"the unit's worker was lost {MOST_LOSSES} times")

    def fail(self, unit: str, message: str, of_store: bool = False) -> None:
        self.failures[unit] = self.failures.get(unit, 0) + 1
        self.tell({"event": "failed_unit", "id": unit, "attempt": self.failures[unit], "message": message})
        if self.failures[unit] >= MOST_FAILURES:
            if of_store:
                # No unit can write its results, so all other units would fail too.
                self.unwritable = message
            self.give_up(unit, message)

    def give_up(self, unit: str, message: str) -> None:
        self.outcome.failed[unit] = message

    def end(self) -> Outcome:
        outcome = self.outcome
        outcome.left = [unit for unit in self.units if unit not in self.done and unit not in outcome.failed]
        if not outcome.failed:
            return outcome
        kept = f"{len(self.done)} of {len(self.units)} units of work are finished, and their results are kept; the same command continues with the other units"
        if self.unwritable is not None:
            place = "the run folder cannot be written" if self.store is None else "the store cannot be used"
            raise FarmError(f"{place}: {self.unwritable}; {kept}")
        causes: dict[str, list[str]] = {}
        for unit, message in outcome.failed.items():
            causes.setdefault(message, []).append(unit)
        told = []
        for message, units in causes.items():
            others = f" and {len(units) - 1} more units" if len(units) > 2 else f" and {units[1]}" if len(units) == 2 else ""
            often = f"failed {MOST_FAILURES} times" if self.failures.get(units[0], 0) >= MOST_FAILURES else "given up"
            told.append(f"unit{'s' if len(units) > 1 else ''} {units[0]}{others} {often}: {message}")
        waits = f"; number of units that were not started, since they depend on failed units: {len(outcome.left)}" if outcome.left else ""
        raise FarmError(f"{'; '.join(told)}{waits}; {kept}")


def _json(text: object) -> dict[str, Any] | None:
    if not isinstance(text, str):
        return None
    try:
        found = json.loads(text)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None


def _mapped(path: str, maps: Sequence[str]) -> str:
    for pair in maps:
        here, there = pair.split("=", 1)
        if path == here or path.startswith(here.rstrip("/") + "/"):
            return there.rstrip("/") + path[len(here.rstrip("/")) :]
    return path

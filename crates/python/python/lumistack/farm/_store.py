"""An object store instead of a shared folder, by fsspec. Workers that share no file system exchange
the files of units through the store.

    URL/files/SHA256                 contents of files, by their hash: written once, never changed
    URL/PLAN/units/ID.json           files that a unit wrote: path, hash and size of each; written last, so the store has all files of a unit or none
    URL/PLAN/start.json              files of the run folder before the first unit, including the plan
    URL/PLAN/sent/N.json             files of a folder that the client sends

Each thread of a worker has its own run folder, the mirror. Before a unit, the thread copies the
files of all units on which this unit depends into its mirror. Then the thread executes the unit in
the mirror, and copies the files that the unit has written to the store.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import threading
import uuid
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import Any

# Files of a run folder that belong to one machine, and so are not copied.
OWN = {"lumistack.lock"}
# Number of attempts to fetch a file whose content does not have the stated hash.
MOST_FETCHES = 3


class StoreError(Exception):
    """The store cannot be used: the failed action and its cause."""


class Store:
    """A location of fsspec, such as `s3://bucket/shots` or `file:///mnt/shots`."""

    def __init__(self, url: str) -> None:
        self.url = url.rstrip("/")
        try:
            fsspec = import_module("fsspec")
        except ImportError as error:
            raise StoreError(f"expected the Python package fsspec, found none ({error}); `pip install 'lumistack[farm]'` installs fsspec") from error
        try:
            self.fs, self.root = fsspec.core.url_to_fs(self.url, use_listings_cache=False)
        except Exception as error:  # each file system raises its own errors
            raise StoreError(f"{self.url}: {_cause(error)}") from error
        self.is_local = "file" in _protocols(self.fs)
        self.root = self.root.rstrip("/")

    def put(self, name: str, content: bytes | Path) -> None:
        """Writes an object completely or not at all."""
        path = f"{self.root}/{name}"
        try:
            if self.is_local:
                # An object store replaces an object atomically, but a write to a file is not
                # atomic. So write another file and rename it.
                os.makedirs(os.path.dirname(path), exist_ok=True)
                part = f"{path}.{uuid.uuid4().hex}.part"
                self._write(part, content)
                os.replace(part, path)
            else:
                self._write(path, content)
        except Exception as error:
            raise StoreError(f"{self.url}: {name} cannot be written: {_cause(error)}") from error

    def _write(self, path: str, content: bytes | Path) -> None:
        if isinstance(content, bytes):
            self.fs.pipe_file(path, content)
        else:
            self.fs.put_file(str(content), path)

    def read(self, name: str) -> bytes | None:
        """Returns an object, or None if there is none."""
        try:
            content: bytes = self.fs.cat_file(f"{self.root}/{name}")
        except FileNotFoundError:
            return None
        except Exception as error:
            raise StoreError(f"{self.url}: {name} cannot be read: {_cause(error)}") from error
        return content

    def has(self, name: str) -> bool:
        try:
            return bool(self.fs.exists(f"{self.root}/{name}"))
        except Exception as error:
            raise StoreError(f"{self.url}: {_cause(error)}") from error

    def fetch(self, entry: dict[str, Any], to: Path) -> None:
        """Writes the file of an entry, completely or not at all, and checks its content."""
        part = to.with_name(f".{to.name}.{uuid.uuid4().hex}.part")
        try:
            to.parent.mkdir(parents=True, exist_ok=True)
            for _ in range(MOST_FETCHES):
                self.fs.get_file(f"{self.root}/files/{entry['hash']}", str(part))
                if _hash(part) == entry["hash"]:
                    os.replace(part, to)
                    return
        except Exception as error:
            raise StoreError(f"{self.url}: {entry['path']} cannot be read: {_cause(error)}") from error
        finally:
            part.unlink(missing_ok=True)
        raise StoreError(f"{self.url}: {entry['path']}: expected content with the SHA-256 {entry['hash']}, found other content")

    def publish(self, name: str, folder: Path, paths: Iterable[Path]) -> None:
        """Writes files of a folder, then the list of these files."""
        entries = []
        for path in sorted(paths):
            entry = {"path": path.relative_to(folder).as_posix(), "hash": _hash(path), "bytes": path.stat().st_size}
            if not self.has(f"files/{entry['hash']}"):
                self.put(f"files/{entry['hash']}", path)
            entries.append(entry)
        self.put(name, json.dumps({"files": entries}).encode())

    def entries(self, name: str) -> list[dict[str, Any]] | None:
        """Returns the entries of a list of files, or None if the list does not exist. Raises StoreError if
        the list is damaged."""
        text = self.read(name)
        if text is None:
            return None
        try:
            entries: list[dict[str, Any]] = json.loads(text)["files"]
            for entry in entries:
                path = PurePosixPath(entry["path"])
                if path.is_absolute() or ".." in path.parts or not path.parts or "\\" in entry["path"] or ":" in entry["path"]:
                    raise ValueError(f"expected paths inside the folder, found {entry['path']}")
                if len(bytes.fromhex(entry["hash"])) != 32:
                    raise ValueError(f"expected a SHA-256, found {entry['hash']}")
        except (ValueError, KeyError, TypeError) as error:
            raise StoreError(f"{self.url}: {name}: expected a list of files, found a damaged list ({error})") from error
        return entries

    def pull(self, names: Iterable[str], folder: Path) -> list[str]:
        """Copies the files in the lists `names` into a folder. Returns the names of lists that do
        not exist.

        A file that already has the content that its list states is not written again. Several lists may
        name a file, such as the plan's notes. Then the version of the last list is used.
        """
        wanted: dict[str, dict[str, Any]] = {}
        missing = []
        for name in names:
            entries = self.entries(name)
            if entries is None:
                missing.append(name)
            wanted.update((entry["path"], entry) for entry in entries or ())
        for path, entry in wanted.items():
            to = folder / path
            if not (to.is_file() and to.stat().st_size == entry["bytes"] and _hash(to) == entry["hash"]):
                self.fetch(entry, to)
        return missing


class Run:
    """A planned run in a store."""

    def __init__(self, url: str, plan: str) -> None:
        self.store, self.plan = Store(url), plan

    def unit(self, unit: str) -> str:
        """Returns the name of the list of a unit's files."""
        return f"{self.plan}/units/{unit}.json"

    def begin(self, folder: Path, sent: list[Path]) -> None:
        """Copies the plan, the content of the run folder, and the files of the folders `sent` to the
        store."""
        for number, source in enumerate(sent):
            self.store.publish(f"{self.plan}/sent/{number}.json", source, _files(source))
        # start.json is written last, since it marks the beginning of the run
        self.store.publish(f"{self.plan}/start.json", folder, _files(folder))

    def is_done(self, unit: str) -> bool:
        return self.store.has(self.unit(unit))

    def collect(self, folder: Path, units: Iterable[str]) -> None:
        """Copies the files that units have written into the run folder of the client."""
        self.store.pull([self.unit(unit) for unit in units], folder)

    def has_begun(self) -> bool:
        return self.store.has(f"{self.plan}/start.json")


class Mirror:
    """The run folder of one thread of a worker."""

    # The mirrors of this worker: one for each run and thread.
    known: dict[tuple[str, str, int], Mirror] = {}

    def __init__(self, run: Run) -> None:
        self.run = run
        self.place = Path(tempfile.mkdtemp(prefix="lumistack-", dir=_local_directory()))
        self.folder = self.place / "run"
        self.folder.mkdir()
        self.begun = False
        self.taken: set[str] = set()
        # The unit whose attempt runs: set by `take`, and None after its files are published.
        self.unit: str | None = None
        self.before: dict[Path, tuple[int, int, int]] = {}
        # Files of units whose last attempt failed. A retry does not write finished files again, so
        # `publish` adds them.
        self.left: dict[str, set[Path]] = {}
        # The lists of the folders that the client sent, as they were copied.
        self.sent: dict[int, list[dict[str, Any]] | None] = {}

    @classmethod
    def of(cls, url: str, plan: str) -> Mirror:
        """Returns the mirror of this thread."""
        key = (url, plan, threading.get_ident())
        if key not in cls.known:
            cls.known[key] = cls(Run(url, plan))
        return cls.known[key]

    def take(self, unit: str, needs: list[str], sent: list[str]) -> list[str]:
        """Begins an attempt of a unit: copies the files of the units that it needs into the mirror. Returns
        the path mappings to the files that the client sent."""
        if self.unit is not None:
            self.left.setdefault(self.unit, set()).update(self.changed())
            self.unit = None
        run = self.run
        new = [need for need in needs if need not in self.taken]
        lists = [] if self.begun else [f"{run.plan}/start.json"]
        missing = run.store.pull(lists + [run.unit(need) for need in new], self.folder)
        maps = []
        for number, source in enumerate(sent):
            to = self.place / f"sent{number}"
            # The client sends a folder again if its files changed, so the list is read for each
            # unit.
            name = f"{run.plan}/sent/{number}.json"
            entries = run.store.entries(name)
            if entries is None or entries != self.sent.get(number):
                missing += run.store.pull([name], to)
                self.sent[number] = entries
            maps.append(f"{source}={to}")
        if missing:
            raise StoreError(f"{run.store.url}: expected {missing[0]}, found nothing")
        self.begun = True
        self.taken.update(new)
        self.before, self.unit = _states(self.folder), unit
        return maps

    def changed(self) -> set[Path]:
        """Returns the files that were written since the last `take`."""
        return {path for path, state in _states(self.folder).items() if self.before.get(path) != state}

    def publish(self, unit: str) -> None:
        """Stores the files that the unit wrote since `take` and in earlier attempts."""
        left = {path for path in self.left.get(unit, ()) if path.is_file()}
        self.run.store.publish(self.run.unit(unit), self.folder, self.changed() | left)
        self.taken.add(unit)
        self.left.pop(unit, None)
        self.unit = None


def _local_directory() -> str | None:
    """Returns the folder in which Dask keeps the files of this worker; Dask removes it with the worker."""
    try:
        from distributed import get_worker

        return str(get_worker().local_directory)
    except (ImportError, ValueError):
        return None


def _files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file() and path.name not in OWN]


def _states(folder: Path) -> dict[Path, tuple[int, int, int]]:
    """Returns the files of a folder. Each has the attributes that change when the file is written."""
    found = {}
    for path in _files(folder):
        state = path.stat()
        found[path] = (state.st_mtime_ns, state.st_size, state.st_ino)
    return found


def _hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _protocols(fs: Any) -> tuple[str, ...]:
    return (fs.protocol,) if isinstance(fs.protocol, str) else tuple(fs.protocol)


def _cause(error: BaseException) -> str:
    return str(error) or type(error).__name__

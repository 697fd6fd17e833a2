"""A folder of rendered views with which an interrupted run can be resumed.

Every view is written under another name and renamed when it is complete, so an existing view is
always finished. Views belong to a key, a digest of everything that they depend on, and are in a
folder named after this key.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from pathlib import Path

#: The name of a folder of views contains this number of characters of the views' key.
NAMED_BY = 16
View = tuple[int, int]


def key_of(parts: object) -> str:
    """Returns a digest of settings, which may be any values that JSON can express."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, ensure_ascii=False).encode()).hexdigest()


class Views:
    """The views of one key: `folder/views-KEY/view_YY_XX.exr`, scene-linear."""

    def __init__(self, folder: str | os.PathLike[str], rows: int, columns: int, key: str) -> None:
        if rows < 1 or columns < 1:
            raise ValueError(f"views: expected at least 1 × 1, found {columns} × {rows}")
        self.folder = Path(folder) / f"views-{key[:NAMED_BY]}"
        self.rows, self.columns = rows, columns
        self.folder.mkdir(parents=True, exist_ok=True)

    def all(self) -> Iterator[View]:
        """Returns the indices (view_y, view_x) of all views, row by row. View (0, 0) is at the top left."""
        return ((row, column) for row in range(self.rows) for column in range(self.columns))

    def path(self, view: View) -> Path:
        return self.folder / f"view_{view[0]:02}_{view[1]:02}.exr"

    def is_there(self, view: View) -> bool:
        return self.path(view).is_file()

    def missing(self) -> list[View]:
        """Returns the views that are not rendered yet, row by row."""
        return [view for view in self.all() if not self.is_there(view)]

    def begin(self, view: View) -> Path:
        """Returns the path to which a view is written until it is complete. Removes a file that an
        interrupted run left at this path."""
        path = self.folder / f"unfinished_{self.path(view).name}"
        path.unlink(missing_ok=True)
        return path

    def keep(self, view: View) -> Path:
        """Marks a completely written view as finished."""
        written = self.folder / f"unfinished_{self.path(view).name}"
        if not written.is_file() or written.stat().st_size == 0:
            raise FileNotFoundError(f"{written}: expected the view that was just rendered, found nothing")
        with open(written, "rb") as file:
            os.fsync(file.fileno())
        os.replace(written, self.path(view))
        return self.path(view)

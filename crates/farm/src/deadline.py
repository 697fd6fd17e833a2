#!/usr/bin/env python3
"""Submits the jobs of this folder to Deadline: python3 submit.py. If deadlinecommand is not on PATH, the environment variable DEADLINE_COMMAND must name it."""

import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path


def main() -> int:
    here = Path(__file__).resolve().parent
    program = os.environ.get("DEADLINE_COMMAND", "deadlinecommand")
    ids: dict[str, str] = {}
    for entry in json.loads((here / "jobs.json").read_text()):
        stem = entry["job"]
        info = (here / f"{stem}.job").read_text()
        if entry["inputs"]:
            info += "JobDependencies=" + ",".join(ids[name] for name in entry["inputs"]) + "\n"
        with tempfile.NamedTemporaryFile("w", suffix=".job", delete=False) as file:
            file.write(info)
        try:
            done = subprocess.run([program, file.name, str(here / f"{stem}.plugin")], capture_output=True, text=True)
        finally:
            os.unlink(file.name)
        found = re.search(r"JobID=(\S+)", done.stdout)
        if done.returncode != 0 or found is None:
            print(f"{stem}: Deadline refused the job: {(done.stderr or done.stdout).strip()}", file=sys.stderr)
            return 1
        ids[stem] = found[1]
        print(f"{stem}: {found[1]}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

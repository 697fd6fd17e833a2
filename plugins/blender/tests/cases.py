# SPDX-License-Identifier: GPL-3.0-or-later
"""Cases that must pass in a real Blender, each in its own process.

    python cases.py all ZIP FOLDER              runs the cases of `CASES`, one after the other
    python cases.py full ZIP FOLDER             also runs the cases of `MORE`, which take long
    python cases.py CASE,CASE ZIP FOLDER        runs these cases
    python cases.py inside CASE ZIP FOLDER      runs one case in this process, in the Blender of
                                                this Python's module bpy

`cargo xtask blender --check` runs the first command. With `--full` it runs the second command in
every version of Blender.
"""

import os
import shutil
import subprocess
import sys
import time
import traceback
from pathlib import Path

import follow
import pictures
import runs
from common import HERE

#: Seconds after which a case is killed.
LONGEST = 420
CASES = ["lifecycle", "silhouettes", "radiance", "look", "make", "views", "animation", "faults", "handover", "beyond", "resume", "headless", "digest", "overlay", "live"]
#: Cases that take long, or have special requirements.
MORE = ["exporters", "eevee"]


def run_all(zip_path, folder, names):
    failed = []
    for name in names:
        place = folder / name
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
        environment = {**os.environ, "BLENDER_USER_RESOURCES": str(place / "user"), "PYTHONPATH": str(HERE), "PYTHONUTF8": "1"}
        start = time.monotonic()
        try:
            done = subprocess.run([sys.executable, __file__, "inside", name, str(zip_path), str(place)], env=environment, capture_output=True, text=True, timeout=LONGEST)
            code, said = done.returncode, done.stdout + done.stderr
        except subprocess.TimeoutExpired as error:
            code, said = -1, f"{error.stdout or b''}\nhangs"
        ok = code == 0
        lines = [line for line in said.split("\n") if line.startswith(("case:", "note:", "OBLIQUE", "PERSPECTIVE"))]
        for line in lines:
            if line.startswith("case: skipped") and os.environ.get("LUMISTACK_SKIPPED"):
                # `cargo xtask` lists skipped cases, and CI treats them as failures.
                with open(os.environ["LUMISTACK_SKIPPED"], "a") as list_of_skips:
                    list_of_skips.write(f"Blender {name}: {line.removeprefix('case: skipped: ')}\n")
        print(f"{'ok  ' if ok else 'FAIL'} {name} ({time.monotonic() - start:.0f} s)", *lines if ok else [said[-6000:]], sep="\n     ", flush=True)
        failed += [] if ok else [name]
    return failed


def main():
    name, zip_path, folder = sys.argv[-3], Path(sys.argv[-2]).resolve(), Path(sys.argv[-1]).resolve()
    if sys.argv[1] != "inside":
        failed = run_all(zip_path, folder, {"all": CASES, "full": CASES + MORE}.get(name) or name.split(","))
        sys.exit(1 if failed else 0)
    try:
        case = next(getattr(module, f"case_{name}") for module in (pictures, runs, follow) if hasattr(module, f"case_{name}"))
        said = case(folder, zip_path)
        print(f"case: {said}" if said else "case: done")
        code = 0
    except BaseException:
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    if code == 0 and said == "ends by itself":
        return
    # End without cleanup: the module bpy may hang or crash if Python ends with registered classes.
    os._exit(code)


if __name__ == "__main__":
    main()

"""`python -m lumistack.farm FOLDER`: executes the plan in a run folder. `lumistack farm` starts it.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from typing import Any

from lumistack.farm import _work
from lumistack.farm._engine import FarmError, execute


def _line_of(event: dict[str, Any]) -> str:
    match event["event"]:
        case "done_unit":
            return f"{event['done']:>5}/{event['units']}  {event['id']}  {event['seconds']:.1f} s"
        case "failed_unit":
            return f"       {event['id']} failed (attempt {event['attempt']}): {event['message']}"
        case "refused":
            return f"       worker {event['worker']} is not used: {event['reason']}"
        case "dashboard":
            return f"       dashboard: {event['address']}"
    return str(event)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m lumistack.farm", description="Executes the units of work in a run folder.")
    parser.add_argument("folder")
    parser.add_argument("--program", default="null", help="command that starts lumistack on this machine, a JSON list of words")
    parser.add_argument("--dask", metavar="ADDRESS")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--map", action="append", default=[], metavar="/HERE=/THERE")
    parser.add_argument("--tls-ca")
    parser.add_argument("--tls-cert")
    parser.add_argument("--tls-key")
    parser.add_argument("--insecure", action="store_true")
    parser.add_argument("--store", metavar="URL")
    parser.add_argument("--send", action="append", default=[], metavar="FOLDER")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args(arguments)
    tell = (lambda event: print(json.dumps(event), flush=True)) if given.json else (lambda event: print(_line_of(event), file=sys.stderr, flush=True))
    program = json.loads(given.program)
    tls = (given.tls_ca, given.tls_cert, given.tls_key) if given.tls_ca else None
    words = [*_work._program(program), "--json", "farm", "show", given.folder]
    # Read the plan, then execute it; errors and Ctrl-C become exit codes.
    try:
        found = subprocess.run(words, capture_output=True, text=True)
        planned = _work._answer(found.stdout, "farm_plan")
        if planned is None:
            raise FarmError((found.stderr or found.stdout).strip().removeprefix("error: "))
        outcome = execute(
            planned,
            address=given.dask,
            workers=given.workers,
            threads=given.threads,
            maps=given.map,
            tls=tls,
            insecure=given.insecure,
            program=program,
            store=given.store,
            send=given.send,
            tell=tell,
        )
    except FarmError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("error: stopped; the same command continues with the units of work that are not finished", file=sys.stderr)
        return 130
    if given.json:
        print(json.dumps({"event": "done", "seconds": outcome.seconds, "units": len(outcome.done), "lost": outcome.lost}))
    else:
        lost = f" (units that were executed again since their worker was lost: {outcome.lost})" if outcome.lost else ""
        print(f"units finished: {len(outcome.done)}{lost}, finished by earlier runs: {outcome.before}; {outcome.seconds:.0f} s")
        print(f"{given.folder}/report.html" if "finish" in outcome.done else given.folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())

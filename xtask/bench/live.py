"""Sends random edits to `lumistack live`, and checks the states that two pages receive, the memory, and the reaction to Ctrl-C.
`cargo xtask bench live` runs this script."""

from __future__ import annotations

import argparse
import hashlib
import json
import random
import signal
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
import zlib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
# Largest growth of memory from the first third of the edits to the end, as a fraction of the memory
# after the first third.
GROWTH = 0.10
# Longest time from Ctrl-C to the last state, seconds.
FREEZE_S = 0.3


def edit(random: random.Random) -> dict[str, Any]:
    """Makes a random request, sometimes an invalid one."""
    pick = random.random()
    if pick < 0.2:
        return {"set": {"display.brightness": round(random.uniform(0.1, 1.0), 2)}}
    if pick < 0.3:
        return {"set": {"display.frames": random.choice([2, 3, 4])}}
    if pick < 0.45:
        return {"set": {"window.depth_scale": round(random.uniform(0.5, 1.0), 2)}}
    if pick < 0.6:
        return {"set": {"window.look_from": [random.uniform(-30, 30), random.uniform(-10, 20)], "window.from": "bounds"}}
    if pick < 0.7:
        return {"set": {"light.exposure_ev": round(random.uniform(-1, 1), 2)}}
    if pick < 0.75:
        return {"set": {"light.background": random.choice(["#203040", "environment"])}}
    if pick < 0.9:
        return {"viewers": [[random.uniform(-150, 150), 0.0, 600.0] for _ in range(random.choice([0, 1, 2]))]}
    if pick < 0.95:
        return {"time": round(random.uniform(0, 2), 2)}
    return random.choice([{"set": {"display.brightness": -1}}, {"set": {"no.such": 1}}, {"viewers": [[0, 0, -1]]}, {"reload": True}])


class Watcher(threading.Thread):
    """Requests states as a page does, and checks that each state is complete."""

    def __init__(self, address: str) -> None:
        super().__init__(daemon=True)
        self.address, self.seen, self.wrong = address, {}, []
        self.last = 0.0

    def run(self) -> None:
        number = 0
        while True:
            try:
                with urllib.request.urlopen(f"{self.address}.live?after={number}", timeout=20) as answer:
                    frame = answer.read()
            except OSError:
                return
            if not frame:
                continue
            self.last = time.monotonic()
            length = struct.unpack_from("<I", frame)[0]
            head = json.loads(frame[4 : 4 + length])
            if head["number"] <= number:
                self.wrong.append(f"expected a state after {number}, found state {head['number']}")
            number = head["number"]
            at = 4 + length
            for size in head["files"]:
                if not is_whole(frame[at : at + size]):
                    self.wrong.append(f"state {number}: a pattern is damaged")
                at += size
            if at != len(frame):
                self.wrong.append(f"state {number}: expected {at} bytes, found {len(frame)}")
            self.seen[number] = hashlib.sha256(frame[4 + length :]).hexdigest()


def is_whole(png: bytes) -> bool:
    """Returns true if every chunk of a PNG file matches its checksum."""
    at = 8
    while at + 12 <= len(png):
        size = struct.unpack_from(">I", png, at)[0]
        part = png[at + 4 : at + 8 + size]
        if zlib.crc32(part) != struct.unpack_from(">I", png, at + 8 + size)[0]:
            return False
        at += 12 + size
    return at == len(png) and png[-8:-4] == b"IEND"


def memory_mb(process: int) -> float:
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("program")
    parser.add_argument("--quick", action="store_true")
    args = parser.parse_args()
    edits, seconds = (100, 30.0) if args.quick else (1000, 300.0)
    with tempfile.TemporaryDirectory() as folder:
        words = [args.program, "--json", "live", str(ROOT / "scenes/still-life/still-life.gltf"), "-o", f"{folder}/run", "--no-open"]
        words += ["--resolution", "160x100", "--frames", "4", "--views", "5x5", "--zone-samples", "200"]
        live = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert live.stdin and live.stdout
        events: list[dict[str, Any]] = []
        address = ""
        while not address:
            event = json.loads(live.stdout.readline())
            address = event.get("address", "")
            events.append(event)
        threading.Thread(target=lambda: events.extend(map(json.loads, live.stdout)), daemon=True).start()
        watchers = [Watcher(address), Watcher(address)]
        for watcher in watchers:
            watcher.start()
        source, memory = random.Random(1), []
        for number in range(edits):
            live.stdin.write(json.dumps(edit(source)) + "\n")
            live.stdin.flush()
            time.sleep(seconds / edits * source.uniform(0.2, 1.8))
            if number % (edits // 50) == 0:
                memory.append(memory_mb(live.pid))
        stopped = time.monotonic()
        live.send_signal(signal.SIGINT)
        for watcher in watchers:
            watcher.join(10)
        frozen = max(watcher.last for watcher in watchers) - stopped
        code = live.wait(120)
        whole = time.monotonic() - stopped
        wrong = [text for watcher in watchers for text in watcher.wrong]
        first, second = (watcher.seen for watcher in watchers)
        wrong += [f"state {number}: two pages got different contents" for number in first.keys() & second.keys() if first[number] != second[number]]
        early, late = statistics.median(memory[15:20]), statistics.median(memory[-5:])
        states = [event for event in events if event["event"] == "state"]
        print(f"{edits} edits in {seconds:.0f} s: {len(states)} states, {len(first)} and {len(second)} seen by two pages")
        print(f"refused {sum(event['event'] == 'refused' for event in events)} edits; median step {statistics.median(event['step_s'] for event in states):.3f} s")
        print(f"memory {early:.0f} MB after a third, {late:.0f} MB at the end, {max(memory):.0f} MB at most")
        print(f"last state {frozen:+.3f} s after Ctrl-C; run folder after {whole:.2f} s; exit code {code}")
        if late > (1 + GROWTH) * early:
            wrong.append(f"memory grew by {late - early:.0f} MB")
        if frozen > FREEZE_S or code != 0:
            wrong.append("after Ctrl-C: expected no late state and the exit code 0, found a late state or another code")
        if wrong:
            sys.exit("\n".join(wrong[:20]))


main()

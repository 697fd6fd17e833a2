"""Runs whose workers share no folder: files go through an object store, and results have the same
bytes as on one machine."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import lumistack.farm
from conftest import ROOT
from lumistack.farm._engine import connected
from lumistack.farm._store import Mirror, Run, Store, StoreError
from test_farm import BLOCKS, JOB, command, results

pytest.importorskip("distributed")


@pytest.fixture
def job(tmp_path: Path) -> Path:
    scene = tmp_path / "here" / "scene"
    shutil.copytree(ROOT / "scenes" / "letters", scene)
    path = tmp_path / "here" / "walk.toml"
    path.write_text(JOB.format(scene=json.dumps(str(scene / "letters.gltf"))))
    return path


@pytest.fixture
def s3(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A bucket of an S3 server on this machine."""
    pytest.importorskip("moto")
    pytest.importorskip("s3fs")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = subprocess.Popen(
        [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    for name, value in {
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}",
    }.items():
        monkeypatch.setenv(name, value)
    import boto3

    for _ in range(100):
        try:
            boto3.client("s3").create_bucket(Bucket="shots")
            break
        except Exception:
            time.sleep(0.1)
    yield "s3://shots/one"
    server.kill()
    server.wait()


def test_workers_without_a_shared_folder_give_the_bytes_of_one_machine(tmp_path: Path, job: Path, s3: str) -> None:
    command("run", job, "-o", tmp_path / "one")
    expected = results(tmp_path / "one")
    scene, away, kills = job.parent / "scene", tmp_path / "away", list[int]()
    with connected(None, None, 2, None) as client:

        def tell(event: dict[str, Any]) -> None:
            if event["event"] == "done_unit" and not away.exists():
                # Workers must use the files that were sent to the store, since the scene's folder
                # is renamed.
                scene.rename(away)
            if event["event"] == "done_unit" and event["done"] == 6:
                # The worker's run folder and the fetched files are lost with the worker.
                kills.extend(list(client.run(os.getpid).values())[:1])
                os.kill(kills[0], signal.SIGKILL)

        lumistack.farm.run(job, tmp_path / "run", options=BLOCKS, client=client, threads=1, store=s3, send=[scene], tell=tell)
        assert kills and results(tmp_path / "run") == expected
        away.rename(scene)
        # Another client finds the results of all other units in the store, and executes only the
        # last unit.
        again = lumistack.farm.run(job, tmp_path / "other", options=BLOCKS, client=client, threads=1, store=s3, send=[scene])
        assert again.done == ["finish"]
    assert results(tmp_path / "other") == expected


def test_a_folder_is_a_store_and_the_command_takes_one(tmp_path: Path, job: Path) -> None:
    text = job.read_text()
    job.write_text(text[: text.index("[sequence]")])
    command("run", job, "-o", tmp_path / "one")
    url = f"file://{tmp_path}/store"
    words = [sys.executable, "-m", "lumistack", "farm", str(job), "-o", str(tmp_path / "run"), *BLOCKS, "--store", url]
    done = subprocess.run(words, capture_output=True, text=True, env={**os.environ, "LUMISTACK_PYTHON": sys.executable})
    assert done.returncode == 0, done.stderr
    assert results(tmp_path / "run") == results(tmp_path / "one")
    assert not list((tmp_path / "store").rglob("*.part"))


def test_a_store_that_cannot_be_used_is_named(tmp_path: Path, job: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    with connected(None, None, 1, None) as client:
        for url, part in [
            (f"file://{tmp_path}/file/store", "cannot be written"),
            ("nothing://here", "Protocol not known: nothing"),
        ]:
            with pytest.raises(lumistack.farm.FarmError, match=part) as caught:
                lumistack.farm.run(job, tmp_path / "run", client=client, store=url)
            assert url in str(caught.value)
    with pytest.raises(lumistack.farm.FarmError, match="send: expected a `store`"):
        lumistack.farm.run(job, tmp_path / "run", send=[tmp_path])
    with pytest.raises(lumistack.farm.FarmError, match="expected a folder to send, found none"):
        lumistack.farm.run(job, tmp_path / "run", store=f"file://{tmp_path}/store", send=[tmp_path / "missing"])


def test_a_retry_publishes_the_files_of_the_failed_attempt(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A retry in the same mirror keeps files that the failed attempt finished. They belong to the
    unit's list, and not to the list of a unit that ran in between."""
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "plan.json").write_text("{}")
    run = Run(f"file://{tmp_path}/store", "plan")
    run.begin(tmp_path / "run", [])
    mirror = Mirror(run)

    def listed(unit: str) -> set[str]:
        return {entry["path"] for entry in run.store.entries(run.unit(unit)) or ()}

    mirror.take("first", [], [])
    (mirror.folder / "views").write_text("finished")
    (mirror.folder / "part").write_text("removed by the retry")
    mirror.take("other", [], [])
    (mirror.folder / "other").write_text("done")
    mirror.publish("other")
    mirror.take("first", [], [])
    (mirror.folder / "part").unlink()
    (mirror.folder / "patterns").write_text("done")
    # The files also stay if the store fails while they are published.
    with monkeypatch.context() as broken:
        broken.setattr(run.store, "put", lambda *_: (_ for _ in ()).throw(StoreError("full")))
        with pytest.raises(StoreError, match="full"):
            mirror.publish("first")
    mirror.take("first", [], [])
    mirror.publish("first")
    assert (listed("first"), listed("other")) == ({"views", "patterns"}, {"other"})
    assert mirror.taken == {"first", "other"}


def test_lists_and_files_of_a_store_are_checked(tmp_path: Path) -> None:
    source, to = tmp_path / "source", tmp_path / "to"
    (source / "deep").mkdir(parents=True)
    (source / "deep" / "a").write_bytes(b"one")
    run = Run(f"file://{tmp_path}/store", "plan")
    run.store.publish("plan/units/a.json", source, [source / "deep" / "a"])
    run.collect(to, ["a", "never"])
    assert (to / "deep" / "a").read_bytes() == b"one"

    entry = run.store.entries("plan/units/a.json")
    assert entry is not None
    (tmp_path / "store" / "files" / entry[0]["hash"]).write_bytes(b"two")
    with pytest.raises(StoreError, match="deep/a: expected content with the SHA-256"):
        run.collect(tmp_path / "new", ["a"])
    assert not list((tmp_path / "new").rglob("*.part"))

    for path in ["../out", "/etc/x", "a/../../b", "", "a\\..\\b", "c:x"]:
        text = json.dumps({"files": [{**entry[0], "path": path}]})
        run.store.put("plan/units/b.json", text.encode())
        with pytest.raises(StoreError, match="expected paths inside the folder"):
            run.collect(to, ["b"])
    for text in ["[]", "{", json.dumps({"files": [{**entry[0], "hash": "../../x"}]})]:
        run.store.put("plan/units/b.json", text.encode())
        with pytest.raises(StoreError, match="damaged"):
            run.collect(to, ["b"])


def test_an_object_is_there_whole_or_not_at_all(tmp_path: Path) -> None:
    store = Store(f"file://{tmp_path}/store")
    assert store.read("a/b") is None and not store.has("a/b")
    store.put("a/b", b"x")
    store.put("a/b", b"y")
    assert store.read("a/b") == b"y" and store.has("a/b")
    assert [path.name for path in (tmp_path / "store" / "a").iterdir()] == ["b"]

"""Sweeps on a real Dask cluster: a scheduler, two worker processes on loopback, and deaths among them."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from pinmobile import InvalidArgument, SchedulerError, Sweep, sweep
from pinmobile.sweeps import connected
from tests.sweeping import CHUNK, contents, gains_and_errors
from tests.test_cli import typed

pytestmark = pytest.mark.once

distributed: Any = pytest.importorskip("distributed")
ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Sweep:
    """Return the sweep of this process alone, by which the compiled code is in the cache too."""
    return sweep(gains_and_errors(), tmp_path_factory.mktemp("sweep") / "store", chunk=CHUNK)


@pytest.fixture(scope="module")
def cluster(done: Sweep) -> Iterator[Any]:
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": ":0", "host": "127.0.0.1"}
    with distributed.LocalCluster(processes=True, silence_logs=50, **options) as cluster:
        yield cluster


@pytest.fixture
def client(cluster: Any) -> Iterator[Any]:
    with distributed.Client(cluster) as client:
        client.wait_for_workers(2, timeout=30)
        yield client


def test_the_store_of_a_cluster_is_that_of_one_process(done: Sweep, client: Any, tmp_path: Path) -> None:
    found = sweep(gains_and_errors(), tmp_path / "store", chunk=CHUNK, client=client)
    assert contents(found.path) == contents(done.path)


def test_a_worker_may_be_killed(done: Sweep, client: Any, tmp_path: Path) -> None:
    workers = [worker["pid"] for worker in client.run(_process).values()]
    assert len(set(workers) - {os.getpid()}) == 2

    def kill(now: int, total: int) -> None:
        if now >= total / 3 and len(workers) == 2:
            os.kill(workers.pop(), signal.SIGKILL)

    found = sweep(gains_and_errors(), tmp_path / "store", chunk=CHUNK, client=client, progress=kill)
    assert len(workers) == 1
    assert contents(found.path) == contents(done.path)


def _process() -> dict[str, int]:
    return {"pid": os.getpid()}


def test_the_driver_may_be_killed(done: Sweep, client: Any, tmp_path: Path) -> None:
    store = tmp_path / "store"
    words = [sys.executable, "-m", "tests.sweeping", str(store), "300", client.scheduler.address]
    assert subprocess.run(words, cwd=ROOT, check=False, timeout=100).returncode == -signal.SIGKILL
    heard: list[int] = []
    sweep(gains_and_errors(), store, client=client, progress=lambda now, total: heard.append(now))
    assert 300 <= heard[0] < 800
    assert contents(store) == contents(done.path)


def test_an_error_of_a_worker_comes_back_and_what_is_done_is_kept(
    done: Sweep, client: Any, tmp_path: Path
) -> None:
    def stop(now: int, total: int) -> None:
        if now >= 400:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweep(gains_and_errors(), tmp_path / "store", chunk=CHUNK, client=client, progress=stop)
    found = sweep(gains_and_errors(), tmp_path / "store")
    assert contents(found.path) == contents(done.path)


def test_a_scheduler_that_does_not_answer_is_given_up() -> None:
    before = time.monotonic()
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(SchedulerError, match=rf"scheduler {address} does not answer within 0\.5 s"):
            connected(address, timeout=0.5)
    with pytest.raises(SchedulerError, match=r"does not answer within 0\.5 s"):
        connected(address, timeout=0.5)
    with pytest.raises(InvalidArgument, match="scheduler is 'tcp//1', expected an address such as tcp://"):
        connected("tcp//1", timeout=0.5)
    assert time.monotonic() - before < 20


def test_what_is_no_scheduler_is_told(cluster: Any) -> None:
    before = time.monotonic()
    with socket.create_server(("127.0.0.1", 0)) as other:

        def serve() -> None:
            with suppress(OSError):
                while True:
                    with other.accept()[0] as answered:
                        answered.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n" * 4)
                        answered.recv(1)

        serving = Thread(target=serve)
        serving.start()
        with pytest.raises(SchedulerError, match=r"^tcp://127\.0\.0\.1:\d+ is no Dask scheduler"):
            connected(f"tcp://127.0.0.1:{other.getsockname()[1]}", timeout=5)
        other.shutdown(socket.SHUT_RDWR)
        serving.join()
    with pytest.raises(SchedulerError, match="is no Dask scheduler but a Worker"):
        connected(cluster.workers[0].worker_address, timeout=5)
    assert time.monotonic() - before < 30


def test_a_closed_client_and_a_cluster_without_workers_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pinmobile.sweeps.workers._ANSWER", 0.5)
    with distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=":0") as empty:
        client = distributed.Client(empty)
        with client, pytest.raises(SchedulerError, match=r"has no worker after 0\.5 s"):
            sweep(gains_and_errors(), tmp_path / "store", client=client)
        with pytest.raises(InvalidArgument, match="client is closed, expected one that is connected"):
            sweep(gains_and_errors(), tmp_path / "store", client=client)


def test_a_lost_scheduler_is_told_and_what_is_done_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pinmobile.sweeps.workers._LOOK", 0.1)
    file = str(tmp_path / "scheduler.json")
    words = "--host", "127.0.0.1", "--port", "0", "--scheduler-file", file, "--no-dashboard"
    with ExitStack() as running:
        scheduler = running.enter_context(_started("distributed.cli.dask_scheduler", *words))
        running.enter_context(_started("distributed.cli.dask_worker", "--scheduler-file", file, "--no-nanny"))
        client = running.enter_context(distributed.Client(scheduler_file=file, timeout=30))
        client.wait_for_workers(1, timeout=30)

        def lose(now: int, total: int) -> None:
            if now == 200:
                scheduler.kill()

        with pytest.raises(SchedulerError, match="start the same sweep again to go on"):
            sweep(gains_and_errors(), tmp_path / "store", chunk=200, client=client, progress=lose)
    heard: list[int] = []
    sweep(gains_and_errors(), tmp_path / "store", progress=lambda now, total: heard.append(now))
    assert 200 <= heard[0] < 800


@contextmanager
def _started(module: str, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    command = [sys.executable, "-m", module, *words]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            yield process
        finally:
            process.kill()


def test_the_command_takes_a_scheduler(
    capsys: pytest.CaptureFixture[str], cluster: Any, tmp_path: Path
) -> None:
    file = tmp_path / "mass.toml"
    file.write_text("[trajectory]\nduration = 6\n[ensemble]\nn = 30\n[grid]\nspread.mass.percent = [5, 10]\n")
    words = "sweep", str(file), "--chunk", "20"
    alone = typed(capsys, *words, "--out", str(tmp_path / "alone"))
    there = typed(capsys, *words, "--out", str(tmp_path / "there"), "--scheduler", cluster.scheduler_address)
    assert (alone[0], there[0]) == (0, 0)
    assert alone[1].splitlines()[:5] == there[1].splitlines()[:5]
    assert contents(tmp_path / "alone" / "sweep.zarr") == contents(tmp_path / "there" / "sweep.zarr")
    code, _, err = typed(capsys, *words, "--out", str(tmp_path / "none"), "--scheduler", "tcp//1")
    assert (code, err.count("\n")) == (2, 1)
    assert "scheduler is 'tcp//1', expected an address" in err

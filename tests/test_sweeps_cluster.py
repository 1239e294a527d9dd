"""Sweeps on a real Dask cluster: a scheduler, two worker processes on loopback, and deaths among them."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pinmobile import InvalidArgument, Sweep, law, sweep
from pinmobile.errors import SchedulerError
from pinmobile.sweeps import connect
from tests.sweeping import contents, scenario, swept

pytestmark = [pytest.mark.once, pytest.mark.long]

distributed: Any = pytest.importorskip("distributed")
ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Sweep:
    """Return the sweep of this process alone, by which the compiled code is in the cache too."""
    return swept(tmp_path_factory.mktemp("sweep") / "store")


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


def test_a_killed_worker_changes_nothing_in_the_store(done: Sweep, client: Any, tmp_path: Path) -> None:
    workers = list(client.run(os.getpid).values())
    assert len(set(workers) - {os.getpid()}) == 2

    def kill(now: int, total: int) -> None:
        if now >= total / 3 and len(workers) == 2:
            os.kill(workers.pop(), signal.SIGKILL)

    found = swept(tmp_path / "store", client=client, progress=kill)
    assert len(workers) == 1
    assert contents(found.path) == contents(done.path)


def test_the_driver_may_be_killed_or_stopped(done: Sweep, client: Any, tmp_path: Path) -> None:
    store = tmp_path / "store"
    words = [sys.executable, "-m", "tests.sweeping", str(store), "300", client.scheduler.address]
    assert subprocess.run(words, cwd=ROOT, check=False, timeout=100).returncode == -signal.SIGKILL
    heard: list[int] = []

    def stop(now: int, total: int) -> None:
        heard.append(now)
        if now >= 600:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        swept(store, client=client, progress=stop)
    assert 300 <= heard[0] < 800
    swept(store)
    assert contents(store) == contents(done.path)


def test_the_users_code_comes_with_the_scenario(client: Any, tmp_path: Path) -> None:
    """A module that workers cannot import is sent to them by Dask."""
    module = tmp_path / "own_module.py"
    module.write_text("def gain():\n    return 9.0\n")
    client.upload_file(str(module))
    code = "from own_module import gain\ndef push(t, q, v, r): return gain() * (r.q - q) - 6.0 * v"
    own: dict[str, Any] = {"__name__": "__main__"}
    sys.path.insert(0, str(tmp_path))
    try:
        exec(code, own)
        one = scenario(controller=law(own["push"]), n=20, duration=0.5)
        there = sweep(one, tmp_path / "there", client=client, chunk=5)
        assert contents(there.path) == contents(sweep(one, tmp_path / "here", chunk=5).path)
    finally:
        sys.path.remove(str(tmp_path))


def test_what_is_no_scheduler_is_given_up() -> None:
    before = time.monotonic()
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(
            SchedulerError, match=rf"scheduler is '{address}', which does not answer within 0\.5 s"
        ):
            connect(address, timeout=0.5)
    for wrong in (address, "tcp//1"):
        with pytest.raises(SchedulerError, match=r"which does not answer .* expected an address such as"):
            connect(wrong, timeout=0.5)
    assert time.monotonic() - before < 15


def test_a_closed_client_and_no_workers_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pinmobile.sweeps._sweep._ANSWER_TIME", 0.5)
    with distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=":0") as empty:
        client = distributed.Client(empty)
        with client, pytest.raises(SchedulerError, match=r"has no worker after 0\.5 s"):
            swept(tmp_path / "store", client=client)
        with pytest.raises(InvalidArgument, match=r"expected a distributed\.Client that is connected"):
            swept(tmp_path / "store", client=client)


def test_a_lost_scheduler_is_told_and_results_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pinmobile.sweeps._sweep._CHECK_TIME", 0.1)
    file = str(tmp_path / "scheduler.json")
    words = ("--host", "127.0.0.1", "--port", "0", "--no-dashboard"), ("--no-nanny",)
    modules = "distributed.cli.dask_scheduler", "distributed.cli.dask_worker"
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    running = [
        subprocess.Popen([sys.executable, "-m", module, *more, "--scheduler-file", file], **quiet)
        for module, more in zip(modules, words, strict=True)
    ]
    try:
        with distributed.Client(scheduler_file=file, timeout=30) as client:
            client.wait_for_workers(1, timeout=30)

            def lose(now: int, total: int) -> None:
                if now >= 200:
                    running[0].kill()

            with pytest.raises(SchedulerError, match="start the same sweep again to resume"):
                swept(tmp_path / "store", client=client, progress=lose)
    finally:
        for process in running:
            process.kill()
            process.wait()
    heard: list[int] = []
    swept(tmp_path / "store", progress=lambda now, total: heard.append(now))
    assert 200 <= heard[0] < 800

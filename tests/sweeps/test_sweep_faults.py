"""Sweeps on a real Dask cluster, and what befalls them: nothing lost, nothing doubled, the hash of the serial one."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import dask
import psutil
import pytest
from distributed import Client, LocalCluster, WorkerPlugin, default_client

import nontwist
from nontwist import sweep
from nontwist.errors import SweepError
from nontwist.sweeps import sweeping
from nontwist.sweeps.store import SweepStore, open_store

BLOCK, BLOCKS = 4, 12
OVER = '{ key = "start.angular_velocity.body", kind = "uniform", low = [-1.0, -1.0, 0.0], high = [1.0, 1.0, 0.0] }'
FILE = f"""
body = {{ kind = "nontwisting", inertia = [3.0, 4.0, 5.0] }}
time = {{ t_end = 1.0, step = 0.01 }}
sweep = {{ samples = 46, over = [{OVER}] }}
"""


class Fault(WorkerPlugin):
    """What kills every worker, those that come later among them, when it makes the block `guilty`."""

    name = "fault"

    def __init__(self, guilty, once=None):
        self.guilty, self.once = guilty, once

    def setup(self, worker):
        sound, fault = SweepStore.make, self

        def make(self, k):
            if k == fault.guilty and (fault.once is None or not os.path.exists(fault.once)):
                if fault.once is not None:
                    Path(fault.once).touch()
                os.kill(os.getpid(), signal.SIGKILL)
            return sound(self, k)

        SweepStore.make = make


@pytest.fixture
def file(write):
    return write(FILE, "sweep.toml")


@pytest.fixture
def serial(file, tmp_path):
    """The hash of the sweep made by one thread, in other blocks."""
    sweep(file, tmp_path / "serial", workers=1, block=46)
    return open_store(tmp_path / "serial").verified().sha256


def cluster_of(workers, processes=True):
    how = {"threads_per_worker": 1, "dashboard_address": ":0", "silence_logs": 50}
    return LocalCluster(n_workers=workers, processes=processes, **how)


@pytest.fixture
def client():
    with cluster_of(1) as cluster, Client(cluster) as one:
        yield one


def is_whole(store, serial):
    found = open_store(store).verified()
    assert (found.sha256, found.missing) == (serial, ())
    return sum(1 for _ in Path(store).glob("blocks/*/*.json")) == BLOCKS


@pytest.mark.parametrize("is_killed", [False, pytest.param(True, marks=pytest.mark.long)])
def test_killed_worker(is_killed, file, tmp_path, serial):
    """Nor one that lives, in a thread."""
    seen = []
    with cluster_of(1, processes=is_killed) as cluster, Client(cluster) as client:
        if is_killed:
            client.register_plugin(Fault(3, once=str(tmp_path / "killed")))
        sweep(file, tmp_path / "store", dask=client, block=BLOCK, progress=seen.append)
    assert (tmp_path / "killed").exists() == is_killed
    assert (len(seen), seen[-1].done) == (BLOCKS, 46)
    assert is_whole(tmp_path / "store", serial)


def test_address_without_port(file, tmp_path):
    with pytest.raises(ValueError, match="port"):
        sweep(file, tmp_path / "store", dask="nowhere")
    with pytest.raises(ValueError, match="No client"):
        default_client()


@pytest.mark.long
def test_block_that_kills_workers(file, tmp_path, serial, client):
    client.register_plugin(Fault(5))
    store, seen = tmp_path / "store", []
    words = r"^1 of 12 blocks could not be computed, the first is 5, members 20 to 23: "
    with pytest.raises(SweepError, match=words) as caught:
        sweep(file, store, dask=client, block=BLOCK)
    ((k, reason),) = caught.value.failed.items()
    assert (k, reason.partition(": ")[0], open_store(store).verified().missing) == (5, "KilledWorker", (5,))
    sweep(file, store, workers=1, progress=seen.append)
    assert [one.done for one in seen] == [46]
    assert is_whole(store, serial)


@pytest.mark.long
def test_lost_workers_are_replaced(file, tmp_path, serial, monkeypatch):
    """A worker that dies while it is restarted is given up; without any the blocks would wait for ever."""
    monkeypatch.setattr(sweeping, "POLL", 0.1)
    with (
        dask.config.set({"distributed.deploy.lost-worker-timeout": "100ms"}),
        cluster_of(2) as cluster,
        Client(cluster) as client,
    ):
        for nanny in list(cluster.workers.values()):
            cluster.sync(nanny.close)
        sweep(file, tmp_path / "store", dask=client, block=BLOCK)
    assert is_whole(tmp_path / "store", serial)


STOPPED = """
import os, signal
from nontwist.cli import app
from nontwist.sweeps.store import Blocks
mark, marked = Blocks.mark, []
def stopping(self, done):
    mark(self, done)
    marked.append(done)
    if len(marked) == 5:
        os.kill(os.getpid(), signal.SIGSTOP)
Blocks.mark = stopping
app()
"""


@pytest.mark.long
@pytest.mark.parametrize("how", [["--dask", "local"], []])
def test_killed_client(how, write, tmp_path):
    """The client stops when five blocks are done; it is killed; its workers notice, and write what they had in hand."""
    file = write(FILE.replace("samples = 46", "samples = 4000").replace("step = 0.01", "step = 0.001"))
    store = tmp_path / "store"
    environment = {**os.environ, "PYTHONPATH": str(Path(nontwist.__file__).parents[1])}
    command = [sys.executable, "-c", STOPPED, "sweep", str(file), "--out", str(store), "--block", "8", *how]
    with subprocess.Popen([*command, "--workers", "2"], env=environment, stderr=subprocess.DEVNULL) as client:
        _, status = os.waitpid(client.pid, os.WUNTRACED)
        assert os.WIFSTOPPED(status), f"the client ended with {status}"
        with pytest.raises(BlockingIOError, match="another process is writing"):
            sweep(file, store)
        workers = psutil.Process(client.pid).children(recursive=True)
        client.kill()
    psutil.wait_procs(workers)
    there = sum(1 for _ in store.glob("blocks/*/*.json"))
    assert there == 5
    seen = []
    sweep(file, store, workers=2, progress=seen.append)
    assert len(seen) == 500 - there
    sweep(file, tmp_path / "serial", workers=1)
    serial, found = (open_store(place).verified() for place in (tmp_path / "serial", store))
    assert (found.complete, found.sha256) == (True, serial.sha256)

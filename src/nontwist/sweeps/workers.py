"""The workers that compute blocks: threads of this process, or the workers of a Dask cluster, behind one interface.

Threads share the store of the caller. A process of a cluster opens it once, and compiles its kernels once.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import lru_cache
from importlib import import_module
from typing import Any, NamedTuple

from ..driver.notices import duration, progress_bar
from ..geometry.values import as_whole, short_repr
from ..integrators import INTEGRATORS
from ..loads import LOADS
from ..machine import cores, library
from ..models.bodies import BODIES
from .store import MISSING, Done, SweepStore, open_store

_opening = threading.Lock()


def own_modules() -> tuple[str, ...]:
    """Return the modules outside the package that add loads, bodies and integrators: workers must import them."""
    registered = [*LOADS.values(), *INTEGRATORS.values(), *(kind.make for kind in BODIES.values())]
    names = {one.__module__ for one in registered} & (sys.modules.keys() - {"__main__"})
    return tuple(sorted(name for name in names if name.partition(".")[0] != "nontwist"))


def make_there(path: str, seal: str, k: int, modules: tuple[str, ...]) -> Done:
    """Make block `k` of the store at `path` that has this seal, with what these modules add."""
    for name in modules:
        import_module(name)
    with _opening:
        store = _opened(path, seal)
    return store.make(k)


@lru_cache(maxsize=4)
def _opened(path: str, seal: str) -> SweepStore:
    store = open_store(path)
    if store.blocks.seal != seal:
        raise ValueError(f"{path} is another store on this worker")
    return store


class Workers(NamedTuple):
    """Threads, or with a Dask `client` the workers of its cluster, now and later."""

    executor: Any
    threads: int
    client: Any = None

    def submit(self, store: SweepStore, k: int) -> Future[Done]:
        """Begin to make a block of a store."""
        there = str(store.blocks.path), store.blocks.seal, k, own_modules()
        what = (store.make, k) if self.client is None else (make_there, *there)
        return self.executor.submit(*what)

    @property
    def capacity(self) -> int:
        """The number of workers now."""
        return self.threads if self.client is None else max(1, sum(self.client.nthreads().values()))

    def revive(self) -> None:
        """Restart the workers of a local cluster where none is left, as blocks would wait for ever.

        A worker that dies while Dask restarts it is given up by Dask.
        """
        if self.client is None:
            return
        dask, cluster = library("distributed", MISSING), self.client.cluster
        if isinstance(cluster, dask.LocalCluster) and not self.client.nthreads():
            cluster.scale(len(cluster.worker_spec))


@contextmanager
def open_workers(where: Any, count: int | None) -> Iterator[Workers]:
    """Open threads, or workers on a Dask cluster.

    Parameters
    ----------
    where : None, "local", address, Client or Cluster
        None: threads; kernels release the interpreter's lock. "local": processes on this machine.
    count : int, optional
        How many threads or processes; by default one for each processor.

    Raises
    ------
    ValueError
        `count` is no whole number >= 1, or `where` is none of these.
    """
    number = cores() if count is None else as_whole(count, "workers", 1)
    with ExitStack() as stack:
        if where is None:
            pool = ThreadPoolExecutor(number)
            stack.callback(pool.shutdown, cancel_futures=True)
            yield Workers(pool, number)
            return
        client = _client(where, number, stack)
        executor = client.get_executor(pure=False)
        stack.callback(executor.shutdown, wait=False)
        yield Workers(executor, number, client)


def _client(where: Any, count: int, stack: ExitStack) -> Any:
    dask = library("distributed", MISSING)
    if not isinstance(where, (str, dask.Client, dask.deploy.Cluster)):
        raise ValueError(f'dask must be "local", an address, a Client or a Cluster; got {short_repr(where)}')
    if where == "local":
        where = stack.enter_context(dask.LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=":0"))
    elif isinstance(where, str):
        dask.comm.get_address_host_port(where)  # a ValueError now: a client that fails would remain Dask's default
    return where if isinstance(where, dask.Client) else stack.enter_context(dask.Client(where))


# A bar on stderr: members done, rate, time left.


class Progress(NamedTuple):
    """The progress of a sweep."""

    done: int  #: members
    members: int
    failed: int  #: members that have failed
    rate: float  #: members a second since the beginning of this call
    left: float  #: s


@contextmanager
def bar(members: int) -> Iterator[Callable[[Progress], None]]:
    """Show a bar; yield the function that takes a `Progress`."""
    with progress_bar(members, "members") as report:
        yield lambda now: report(now.done / members, f"{now.done} of {members}, {words(now)}")


def words(now: Progress) -> str:
    """Return rate, time left and failures in words."""
    failures = f", {now.failed} failed" if now.failed else ""
    return f"{now.rate:.3g}/s, {duration(now.left)} left{failures}"

"""The workers that compute blocks: threads of this process, or the workers of a Dask cluster, behind one interface.

Threads share the store of the caller. A process of a cluster opens it once, and compiles or loads its kernels once.
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

from ..driver.notices import cores, duration, progress_bar
from ..geometry.values import as_whole, short_repr
from ..integrators import INTEGRATORS
from ..loads import LOADS
from ..models.bodies import BODIES
from .store import MISSING, Done, SweepStore, open_store

_opening = threading.Lock()


class Workers(NamedTuple):
    """Functions that submit a block of a store, return the number of workers now, and restart lost workers."""

    submit: Callable[[SweepStore, int], Future[Done]]
    capacity: Callable[[], int]
    revive: Callable[[], None]


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


@contextmanager
def threads(count: int) -> Iterator[Workers]:
    """Work in threads: kernels release the interpreter's lock."""
    pool = ThreadPoolExecutor(count)
    try:
        yield Workers(lambda store, k: pool.submit(store.make, k), lambda: count, lambda: None)
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def dask(where: Any, count: int) -> Iterator[Workers]:
    """Work on a Dask cluster.

    Parameters
    ----------
    where : "local", address, Client or Cluster
        "local": `count` processes on this machine. Otherwise the workers of the cluster, now and later.
    """
    try:
        import distributed
    except ImportError as error:
        raise ImportError(MISSING) from error
    dask: Any = distributed
    if not isinstance(where, (str, dask.Client, dask.deploy.Cluster)):
        raise ValueError(f'dask must be "local", an address, a Client or a Cluster; got {short_repr(where)}')
    if isinstance(where, str) and where != "local":
        dask.comm.get_address_host_port(where)  # a ValueError now, before a client waits for it
    with ExitStack() as stack:
        if where == "local":
            where = stack.enter_context(
                dask.LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=":0")
            )
        client = where if isinstance(where, dask.Client) else stack.enter_context(dask.Client(where))
        executor = client.get_executor(pure=False)

        def submit(store: SweepStore, k: int) -> Future[Done]:
            begun: Future[Done] = executor.submit(make_there, str(store.path), store.blocks.seal, k, own_modules())
            return begun

        def revive() -> None:
            """Restart the workers of a local cluster where none is left, as blocks would wait for ever.

            A worker that dies while Dask restarts it is given up by Dask.
            """
            cluster = client.cluster
            if isinstance(cluster, dask.LocalCluster) and not client.nthreads():
                cluster.scale(len(cluster.worker_spec))

        try:
            yield Workers(submit, lambda: max(1, sum(client.nthreads().values())), revive)
        finally:
            executor.shutdown(wait=False)


def open_workers(where: Any, count: int | None) -> Any:
    """Return the context of the requested workers.

    Raises
    ------
    ValueError
        `count` is no whole number >= 1.
    """
    number = cores() if count is None else as_whole(count, "workers", 1)
    return threads(number) if where is None else dask(where, number)


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

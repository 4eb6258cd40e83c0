"""`sweep`: computes missing blocks, a few at a time, and marks them; running it again resumes a sweep.

At most twice the number of workers plus two blocks are in flight, so that a sweep of any length needs the memory of a
few blocks. A block that fails, by an exception or because its worker died, is retried up to twice after the others, one
at a time, so that the death of a worker is attributed to the right block. After many failures in a row no more blocks
are begun.

The cost of a sweep, measured on a few of its members: time, bytes, and its blocks.

A block takes at most 10 s and 64 MiB. There are a few blocks for every worker, but none so small that its overhead
exceeds its work.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import nullcontext
from itertools import zip_longest
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..driver.notices import notice
from ..driver.problem import Problem
from ..errors import SweepError, SweepStoreError, warn
from ..geometry.arrays import Dataset
from ..geometry.values import as_function, as_path, as_whole, short_repr
from ..integrators.costs import Cost
from ..io.whole import locked
from ..models.system import as_system
from ..runfile import RunFile, read_run_file
from ..runfile.document import checked, forecast
from ..runfile.files import Folder, bounded, parsed, plain
from ..runfile.writing import file_of
from .members import REFUSED, Members, spread
from .opening import dataset
from .store import Done, SweepStore, create, open_store
from .workers import Progress, Workers, bar, open_workers

LONGEST, LARGEST, MOST = 10.0, 2**26, 2**18  # s, bytes, members of a block
SHORTEST, SHARE = 0.25, 4  # s of a block; blocks for each worker
SHORTEST_MEASUREMENT, LONGEST_MEASUREMENT, FIRST = 0.05, 5.0, 16  # s, s; members of the first measurement


class Plan(NamedTuple):
    """The estimated cost of a sweep."""

    members: int
    block: int  #: members of a block
    blocks: int
    bytes_each: int  #: of a member on disk
    bytes: int
    files: int
    seconds_each: float  #: of a member on one core, as measured here
    seconds: float  #: of all on the workers
    workers: int
    refused: float  #: fraction of the tried members whose numbers define no run
    reason: str  #: of the first of these


def plan(members: Members, workers: int, block: int | None = None) -> Plan:
    """Return the estimated cost of a sweep on `workers` cores like this one; a few of its members are run.

    Raises
    ------
    ValueError
        All members that were tried are refused; a `block` that is no whole number >= 1.
    """
    most = None if block is None else as_whole(block, "block", 1)
    each, refused, reason = _measured(members)
    m, size = len(members), members.bytes_each
    fits = _block(m, each, size, workers) if most is None else min(most, m)
    blocks = -(-m // fits)
    files = (len(members.kept) + 2) * blocks
    seconds = m * each / min(workers, blocks)
    return Plan(m, fits, blocks, size, m * size, files, each, seconds, workers, refused, reason)


def _block(members: int, each: float, size: int, workers: int) -> int:
    """Return the members of a block, such that all blocks but the last are equal and the last is not much smaller."""
    target = min(max(members * each / (SHARE * workers), SHORTEST), LONGEST / 2)
    most = max(1, int(min(target / each, LARGEST / size, MOST)))
    return -(-members // -(-members // most))


def _measured(members: Members) -> tuple[float, float, str]:
    """Return seconds for each member, the refused fraction, and why the first one is."""
    count = FIRST
    while True:
        numbers = spread(members.sweep, count)
        m = len(next(iter(numbers.values())))
        few = {key: array[:: max(m - 1, 1)] for key, array in numbers.items()}
        for tried in (few, numbers, numbers):  # kernels are compiled at first, those of many steps once more
            begin = perf_counter()
            results = members.run(tried)
            if (seconds := perf_counter() - begin) >= LONGEST_MEASUREMENT and tried is numbers:
                break
        if seconds >= SHORTEST_MEASUREMENT or m >= min(len(members), MOST) // 2:
            break
        count = min(16 * count, len(members), MOST)
    bad = np.flatnonzero(results.status == REFUSED)
    reason = results.reasons[int(bad[0])] if bad.size else ""
    if bad.size == m:
        raise ValueError(f"all {m} members tried are refused, the first because: {reason}")
    return seconds / m, bad.size / m, reason


NEAR = 40  # letters of a line before and behind the one that differs
POLL = 5.0  # s between checks for lost workers
RETRIES = 2  # of a block that failed
MOST_FAILURES = 10  # in a row, after which no block is begun


Report = Callable[[Progress], None]


def sweep(
    problem: Problem | RunFile | str | os.PathLike[str],
    path: str | os.PathLike[str],
    *,
    over: Mapping[str, ArrayLike | Mapping[str, Any]] | None = None,
    workers: int | None = None,
    dask: Any = None,
    block: int | None = None,
    progress: bool | Report = False,
    **table: Any,
) -> Dataset:
    """Run all members of a sweep and store their results; complete blocks are not run again.

    Parameters
    ----------
    problem : Problem or path
        A run file with a table ``[sweep]``, see the page of run files; with `over` any problem that has no functions.
    path : path
        The store, a folder (Zarr), created if it does not exist. An existing store of the same file is completed: every
        byte is read and compared with its hash, and blocks that are missing, damaged, exchanged or from another store
        are computed.
    over : mapping, optional
        What varies, by keys of run files: a list of values, or a table with a `kind` as in ``[[sweep.over]]``. Lists of
        several keys form a product, in which the last varies fastest; ``combine="together"`` pairs them.
    workers : int, optional
        Number of threads, or, with ``dask="local"``, of processes; by default one per processor.
    dask : "local", address, Client or Cluster, optional
        Run on a Dask cluster, for instance "tcp://host:8786", whose workers must see the store under the same path.
    block : int, optional
        Number of members per block of a new store. By default as many as require at most 10 s and 64 MiB, as measured.
    progress : bool or callable
        Show a progress bar on stderr; or a function to call with a `Progress` after every block.
    **table
        With `over`: other keys of ``[sweep]``, as ``variables=["kinetic_energy"]`` or ``combine="together"``.

    Returns
    -------
    xarray.Dataset
        As returned by `open_sweep`.

    Raises
    ------
    ValueError
        The table ``[sweep]`` is missing or wrong; the problem has functions; or all members that were tried are
        refused.
    SweepStoreError
        The store belongs to another file, or has damaged metadata.
    BlockingIOError
        Another process is writing this store.
    SweepError
        Some blocks failed.
    KeyboardInterrupt
        Ctrl-C was pressed; completed blocks are kept.

    Warns
    -----
    UserWarning
        A new sweep is expected to take more than 10 s, or more than 1 GB on disk.

    Notes
    -----
    A member that fails does not stop the others: its `status` is not 0, and its numbers are NaN. The results of a
    member do not depend on workers and blocks, bit for bit.

    Examples
    --------
    >>> from nontwist import Problem, nontwisting, sweep
    >>> problem = Problem(nontwisting([3, 4, 5]), t_end=1, step=0.1, material_angular_velocity=(0, 1, 0))
    >>> over = {"start.angular_velocity.body.1": [1, 2, 3, 4]}
    >>> sweep(problem, "energies", over=over, variables=["kinetic_energy"]).kinetic_energy.values.round(9)
    array([ 2.,  8., 18., 32.])
    """
    report: Report = as_function(progress, "progress") if not isinstance(progress, bool) else lambda now: None
    file = problem if isinstance(problem, RunFile) else as_file(problem, over, table)
    members, place = Members(file), Path(os.path.realpath(as_path(path, "path")))
    if not place.parent.is_dir():
        raise FileNotFoundError(f"there is no folder {place.parent}; make it first")
    with locked(place, str(path)), open_workers(dask, workers) as pool:
        kept = _store(place, members, pool.capacity, block)
        found = kept.verified()
        again = sorted([*found.missing, *found.damaged])
        kept.clear(again)
        with bar(len(members)) if progress is True else nullcontext(report) as shown:
            _make(kept, again, pool, _counter(kept, again, found.failed, shown))
    return dataset(open_store(place, members=kept.members))


def as_file(given: Any, over: Mapping[str, Any] | None, table: Mapping[str, Any]) -> RunFile:
    """Return the run file of a problem or of a path, with the table [sweep] where `over` says what varies.

    Raises
    ------
    TypeError
        Keys of the table are given without `over`.
    ValueError
        There is no file and nothing varies; keys or values are wrong; the problem has what no run file can say.
    """
    if over is None:
        if table:
            raise TypeError(f"sweep() got an unexpected keyword argument {next(iter(table))!r} without over=")
        if not isinstance(given, Problem):
            return read_run_file(as_path(given, "problem"))
        if given.file is None:
            raise ValueError("give over= with what varies, or the problem of a run file with [sweep]")
        return given.file
    if not isinstance(over, Mapping):
        raise ValueError(f"over must be a mapping of keys to values, got {short_repr(over)}")
    problem = given if isinstance(given, Problem) else Problem.read(as_path(given, "problem"))
    whole = file_of(problem, Path("problem.toml") if problem.file is None else problem.file.folder / "problem.toml")
    unknown = problem.file is None and whole.body.mass is not None and not as_system(problem.system).weight
    for key, one in over.items():
        if unknown and str(key).startswith(("body.mass", "body.centre_of_mass", "body.gravity")):
            raise ValueError(f"{key}: of this body a force is known, no mass; make it by heavy_top or with_gravity")
        if isinstance(one, Mapping) and "key" in one:
            raise ValueError(f"over[{short_repr(key)}] has a key of its own, {short_repr(one['key'])}; leave it out")
    each = {key: one if isinstance(one, Mapping) else {"values": one} for key, one in over.items()}
    rows = [{"key": key, **{name: plain(value) for name, value in one.items()}} for key, one in each.items()]
    varied = bounded({"over": rows, **{name: plain(value) for name, value in table.items()}})
    return checked("over=", parsed("over=", whole.text(sweep=False)) | {"sweep": varied}, Folder(whole.folder))


def _store(place: Path, members: Members, count: int, block: int | None) -> SweepStore:
    if not place.exists():
        planned = plan(members, count, block)
        seconds = (forecast(members.file).sweep_seconds or 0.0) / min(count, planned.blocks)
        cost = Cost(planned.members, "members", seconds, planned.bytes)
        if (text := notice(cost, "sweep", "on the disk")) is not None:
            warn(text)
        return create(place, members, planned.block)
    store = open_store(place, members=members)
    if store.members.text != members.text:
        raise SweepStoreError(f"{place} is the store of another file: {_difference(store.members.text, members.text)}")
    if block is not None and block != store.blocks.block:
        raise SweepStoreError(f"{place} has blocks of {store.blocks.block} members, not of {block}; leave block out")
    return store


def _difference(old: str, new: str) -> str:
    """Return the first lines that differ."""
    pairs = zip_longest(old.splitlines(), new.splitlines(), fillvalue="nothing")
    lines = next(([was, now] for was, now in pairs if was != now), ["nothing"] * 2)
    at = next((k for k, (a, b) in enumerate(zip(*lines, strict=False)) if a != b), min(map(len, lines)))
    was, now = (_near(line, at) for line in lines)
    return f"it was made with {was}, the file now has {now}; choose another store, or remove this one"


def _near(line: str, at: int) -> str:
    """Return a line, of a long one its key and the value about the letter at which it differs."""
    key, sign, value = line.partition(" = ")
    if len(line) <= 3 * NEAR:
        return line
    first = max(at - len(key + sign) - NEAR, 0)
    part = value[first : first + 2 * NEAR]
    return f"{key}{sign}{'...' * (first > 0)}{part}{'...' * (first + len(part) < len(value))}"


def _counter(store: SweepStore, again: list[int], failed: int, report: Report) -> Callable[[Done], None]:
    """Return what marks a block as done, counts it and reports."""
    begin, members = perf_counter(), len(store.members)
    first = done = members - sum(last - first for first, last in map(store.blocks.span, again))

    def finish(block: Done) -> None:
        nonlocal done, failed
        store.blocks.mark(block)
        a, b = store.blocks.span(block.block)
        done, failed = done + b - a, failed + block.failed
        rate = (done - first) / max(perf_counter() - begin, 1e-9)
        report(Progress(done, members, failed, rate, (members - done) / rate))

    return finish


def _make(store: SweepStore, blocks: list[int], pool: Workers, finish: Callable[[Done], None]) -> None:
    try:
        failed = _pass(store, blocks, pool, lambda: 2 * pool.capacity + 2, finish)
        for _ in range(RETRIES):
            if len(failed) < MOST_FAILURES:
                failed = _pass(store, failed, pool, lambda: 1, finish)
    except KeyboardInterrupt as stop:
        there = sum(store.blocks.present())
        done = f"{there} of {store.blocks.count} blocks are done and kept in {store.blocks.path}; run again to resume"
        raise KeyboardInterrupt(f"{str(stop) or 'interrupted'}; {done}") from stop
    if failed:
        k, reason = next(iter(failed.items()))
        first, last = store.blocks.span(k)
        missing = store.blocks.count - sum(store.blocks.present())
        raise SweepError(
            f"{missing} of {store.blocks.count} blocks could not be computed, the first is {k}, members {first} to "
            f"{last - 1}: {reason}; the others are kept in {store.blocks.path}; run again to try these once more",
            failed,
        )


def _pass(
    store: SweepStore, blocks: Iterable[int], pool: Workers, window: Callable[[], int], finish: Callable[[Done], None]
) -> dict[int, str]:
    """Make blocks, a window of them at a time, finish each that is made; return why others failed."""
    in_flight: dict[Future[Done], int] = {}
    failed: dict[int, str] = {}
    left, in_a_row = iter(blocks), 0
    try:
        while True:
            while len(in_flight) < window() and in_a_row < MOST_FAILURES and (k := next(left, None)) is not None:
                in_flight[pool.submit(store, k)] = k
            if not in_flight:
                return failed
            ready, _ = wait(in_flight, timeout=POLL, return_when=FIRST_COMPLETED)
            if not ready:
                pool.revive()
            for future in ready:
                k = in_flight.pop(future)
                if (error := future.exception()) is not None:
                    failed[k], in_a_row = f"{type(error).__name__}: {error}", in_a_row + 1
                    continue
                finish(future.result())
                in_a_row = 0
    except KeyboardInterrupt:  # blocks that have not begun are cancelled, those that are running are waited for
        running = [future for future in in_flight if not future.cancel()]
        for future in wait(running, timeout=30).done:
            if future.exception() is None:
                finish(future.result())
        raise

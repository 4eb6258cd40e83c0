"""Processes to be killed, starved and locked out; forked from one that has imported everything, so each is quick."""

from __future__ import annotations

import multiprocessing
import os
import traceback
from collections.abc import Callable
from multiprocessing.context import ForkServerProcess
from typing import Any

PRELOADED = ["nontwist.io.results", "nontwist.io.exports", "xarray", "h5netcdf", "pandas", "numba", "scipy.linalg"]
CONTEXT = multiprocessing.get_context("forkserver")
CONTEXT.set_forkserver_preload(PRELOADED)
NOBODY = 65534


def child(function: Callable[..., None], *arguments: Any) -> ForkServerProcess:
    """Start a process that calls `function` with the arguments."""
    process = CONTEXT.Process(target=function, args=arguments)
    process.start()
    return process


def answer(function: Callable[..., Any], *arguments: Any, patience: float = 120) -> Any:
    """Return what `function` returns in a process of its own, which must end by itself."""
    ours, theirs = CONTEXT.Pipe()
    process = child(_answering, theirs, function, arguments)
    theirs.close()
    process.join(patience)
    assert process.exitcode == 0, f"the process ended with {process.exitcode}"
    result, failure = ours.recv()
    assert failure is None, failure
    return result


def _answering(pipe: Any, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    try:
        pipe.send((function(*arguments), None))
    except BaseException:
        pipe.send((None, traceback.format_exc()))


def without_rights() -> None:
    """Give up the rights of root for this process, for which no folder is read-only."""
    if os.geteuid() == 0:
        os.setegid(NOBODY)
        os.seteuid(NOBODY)

"""Processes to be killed, starved and locked out; forked from one that has imported everything, so each is quick."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import sys
import traceback
from collections.abc import Callable
from functools import cache
from multiprocessing import forkserver
from multiprocessing.connection import wait
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any

CONTEXT = multiprocessing.get_context("forkserver")
CONTEXT.set_forkserver_preload(["faults.preloaded"])
TESTS = str(Path(__file__).parents[1])
CAPABILITIES, WRITE_ANYWHERE = 0x20080522, 1 << 1  # version 3 of the interface; CAP_DAC_OVERRIDE


@cache
def _start_server() -> None:
    """Start what processes are forked from; it finds its modules by the environment alone."""
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join([TESTS, *([before] if before else [])])
    try:
        forkserver.ensure_running()
    finally:
        del os.environ["PYTHONPATH"]
        if before:
            os.environ["PYTHONPATH"] = before


def child(function: Callable[..., None], *arguments: Any) -> ForkServerProcess:
    """Start a process that calls `function` with the arguments."""
    _start_server()
    process = CONTEXT.Process(target=function, args=arguments, daemon=True)
    process.start()
    return process


def answer(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return what `function` returns in a process of its own, which must end by itself."""
    ours, theirs = CONTEXT.Pipe(duplex=False)
    process = child(_answering, theirs, function, arguments)
    theirs.close()
    wait([ours, process.sentinel])
    result, failure = ours.recv() if ours.poll() else (None, "the process ended without an answer")
    process.join()
    assert failure is None, failure
    assert process.exitcode == 0, f"the process ended with {process.exitcode}"
    return result


def _answering(pipe: Any, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    try:
        pipe.send((function(*arguments), None))
    except BaseException:
        pipe.send((None, traceback.format_exc()))


def happened(process: ForkServerProcess, event: Any) -> None:
    """Wait until `process` sends something through the pipe `event`, or has ended without doing so, a failure."""
    wait([event, process.sentinel])
    assert event.poll(), f"the process ended with {process.exitcode}"
    event.recv()


def without_rights() -> None:
    """Give up root's right to write where the permissions forbid it; what root may read and enter stays open.

    So a read-only folder is read-only, and modules can still be imported from a checkout that only root may enter.
    """
    if os.geteuid() != 0:
        return
    assert sys.platform == "linux", "root's rights can be given up one by one on Linux only: run the tests as a user"
    libc = ctypes.CDLL(None, use_errno=True)
    header, sets = (ctypes.c_uint32 * 2)(CAPABILITIES, 0), (ctypes.c_uint32 * 6)()
    assert libc.capget(header, sets) == 0, os.strerror(ctypes.get_errno())
    for effective_or_permitted in (0, 1):
        sets[effective_or_permitted] &= ~WRITE_ANYWHERE
    assert libc.capset(header, sets) == 0, os.strerror(ctypes.get_errno())

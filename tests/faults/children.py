"""Processes to be killed, starved and locked out; forked from one that has imported everything, so each is quick."""

import ctypes
import multiprocessing
import os
import sys
import traceback
from functools import cache
from multiprocessing import forkserver
from multiprocessing.connection import wait
from pathlib import Path

import pytest

CONTEXT = multiprocessing.get_context("forkserver")
CONTEXT.set_forkserver_preload(["faults.preloaded"])
TESTS = str(Path(__file__).parents[1])
CAPABILITIES, WRITE_ANYWHERE = 0x20080522, 1 << 1  # version 3 of the interface; CAP_DAC_OVERRIDE


@cache
def _start_server():
    """Start what processes are forked from; it finds its modules by the environment alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", TESTS, prepend=os.pathsep)
        forkserver.ensure_running()


def child(function, *arguments):
    """Start a process that calls `function` with the arguments."""
    _start_server()
    process = CONTEXT.Process(target=function, args=arguments, daemon=True)
    process.start()
    return process


def answer(function, *arguments):
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


def _answering(pipe, function, arguments):
    try:
        pipe.send((function(*arguments), None))
    except BaseException:
        pipe.send((None, traceback.format_exc()))


def happened(process, event):
    """Wait until `process` sends something through the pipe `event`, or has ended without doing so, a failure."""
    wait([event, process.sentinel])
    assert event.poll(), f"the process ended with {process.exitcode}"
    event.recv()


def without_rights():
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

"""Faults of processes: killed, interrupted, two at a time."""

from __future__ import annotations

import os
import pty
import random
import re
import select
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

import nontwist
from nontwist import SimulationInterrupt, integrate, nontwisting, open_run, save_run, simulate, sine, standard
from nontwist.driver import sigterm_interrupts
from nontwist.io import reserved

from .children import CONTEXT, answer, child
from .files import a_run

KILLS = 20


def _kill(folder: Path, before: int | None) -> tuple[int, int, int]:
    """Kill processes that write `run.nc`: how often it was as before, the new one, and how many files were left."""
    path, old, new, left = folder / "run.nc", 0, 0, 0
    run, small, draw = a_run(20_000), a_run(), random.Random(2)
    save_run(run, path)
    start = time.perf_counter()
    save_run(run, path, force=True)
    takes = time.perf_counter() - start
    for number in range(KILLS):
        path.unlink()
        if before is not None:
            save_run(small.assign_attrs(number=before), path)
        ours, theirs = os.pipe()
        process = os.fork()
        if not process:
            one = run.assign_attrs(number=number)
            os.write(theirs, b"!")
            save_run(one, path, force=True)
            os._exit(0)
        os.read(ours, 1)
        time.sleep(draw.uniform(0, 2 * takes))
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
        left += len(os.listdir(folder)) - path.exists()
        found = open_run(path).attrs["number"] if path.exists() else None
        assert found in (before, number), f"{found} is another run, or the old file is gone"
        new += found == number
        old += found == before
        save_run(small, path, force=True)
        assert os.listdir(folder) == ["run.nc"], os.listdir(folder)
    return old, new, left


def killed_while_writing(folder: Path) -> str:
    """SIGKILL at 20 random moments while a run of 8 MB is written."""
    absent, whole, left = answer(_kill, folder, None)
    return f"{absent} times no file, {whole} times the whole file; {left} temporary files, removed by the next writer"


def killed_while_replacing(folder: Path) -> str:
    """SIGKILL at 20 random moments while a result is replaced (--force)."""
    old, new, left = answer(_kill, folder, -1)
    return f"{old} times the old file, {new} times the new one, each whole; {left} temporary files, removed later"


def _holding(path: Path, ready: Any) -> None:
    with reserved(path) as write:
        ready.set()
        time.sleep(1.0)
        write(a_run())


def two_writers(folder: Path) -> str:
    """Two processes with the same output; then the first is done."""
    path, ready = folder / "run.nc", CONTEXT.Event()
    process = child(_holding, path, ready)
    assert ready.wait(60)
    try:
        save_run(a_run(), path, force=True)
    except BlockingIOError as error:
        message = str(error).replace(f"{folder}/", "")
    else:
        raise AssertionError("both wrote")
    process.join(60)
    open_run(path)
    save_run(a_run(), path, force=True)
    return f"the second is refused: “{message}”; afterwards it may write"


def killed_holder(folder: Path) -> str:
    """A process that holds an output is killed; another wants the output."""
    path, ready = folder / "run.nc", CONTEXT.Event()
    process = child(_holding, path, ready)
    assert ready.wait(60)
    process.kill()
    process.join()
    assert os.listdir(folder) == [".run.nc.lock"], os.listdir(folder)
    save_run(a_run(), path)
    assert os.listdir(folder) == ["run.nc"], os.listdir(folder)
    return "the lock ended with its process, the other writes and removes what was left"


NOTHING = sine((0, 0, 0), frequency=1)  # without a load split takes no steps
LONG_RUN = {"t_end": 1e5, "step": 1 / 128, "material_angular_velocity": (1, 2, 0), "load": NOTHING}


def _signal_after(seconds: float, number: int) -> None:
    """Send this process a signal when it has worked for so long, however busy the machine is."""
    start = time.process_time()
    while time.process_time() - start < seconds:
        time.sleep(0.01)
    os.kill(os.getpid(), number)


def _marching(path: Path, number: int, integrator: str, twisting: bool, store: Any) -> None:
    body = (standard if twisting else nontwisting)([3, 4, 5])
    integrate(body, **{**LONG_RUN, "t_end": 1.0}, integrator=integrator)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs in the background of a shell ignore it
    threading.Thread(target=_signal_after, args=(2.0, number)).start()
    with sigterm_interrupts(), reserved(path) as write:
        try:
            simulate(body, **LONG_RUN, integrator=integrator, store=store)
        except SimulationInterrupt as stopped:
            write(stopped.partial.to_dataset())


def _stop(folder: Path, number: int, integrator: str, twisting: bool, store: Any, drift: float = 1e-12) -> str:
    path = folder / f"{integrator}-{twisting}-{store}.nc"
    answer(_marching, path, number, integrator, twisting, store)
    run = open_run(path)
    assert run.attrs["status"] == 6
    assert 0 < float(run["time"][-1]) < LONG_RUN["t_end"], "nothing was kept, or the run was complete"
    energy = run["kinetic_energy"].values
    assert abs(energy / energy[0] - 1).max() < drift
    steps = np.rint(run["time"].values * 128)
    assert np.array_equal(steps / 128, run["time"])
    return str(run.attrs["message"])


def interrupted(folder: Path) -> str:
    """Ctrl-C (SIGINT) in runs of 12.8 million steps: three integrators, every 1000th state or the last one kept."""
    cases = [("lie-midpoint", True, 1000), ("energy-momentum", False, 1000), ("split", True, "end", 1e-8)]
    messages = [_stop(folder, signal.SIGINT, *case) for case in cases]
    return f"the part done is kept, marked by status 6 and, for one, “{messages[0]}”"


def terminated(folder: Path) -> str:
    """SIGTERM in the middle of such a run, as job schedulers send it."""
    return f"the same: “{_stop(folder, signal.SIGTERM, 'lie-midpoint', False, 1000)}”"


def hung_up(folder: Path) -> str:
    """SIGHUP in the middle of such a run, as a shell sends it when its terminal closes."""
    return f"the same: “{_stop(folder, signal.SIGHUP, 'lie-midpoint', False, 1000)}”"


BILLION_STEPS = """
body = { kind = "nontwisting", inertia = [3, 4, 5] }
start.angular_velocity = { body = [1, 2, 0] }
time = { t_end = 1e7, step = 0.01, store = "end" }
integrator = { name = "lie-midpoint", order = 2 }
"""
ATTACH = """
import os, sys
terminal = os.open(sys.argv[1], os.O_RDWR)  # of a session without one it becomes the controlling terminal
for number in range(3):
    os.dup2(terminal, number)
os.execv(sys.executable, [sys.executable, "-m", "nontwist", "run", "run.toml"])
"""


def closed_terminal(folder: Path) -> str:
    """The terminal of `nontwist run` is closed while the bar moves."""
    (folder / "run.toml").write_text(BILLION_STEPS)
    ours, theirs = pty.openpty()
    known = {**os.environ, "PYTHONPATH": str(Path(nontwist.__file__).parents[1]), "TERM": "xterm"}
    command = [sys.executable, "-c", ATTACH, os.ttyname(theirs)]
    shown = b""
    with subprocess.Popen(command, cwd=folder, env=known, start_new_session=True) as process:
        while not re.search(rb"\b[1-9]\d?%", shown):
            if select.select([ours], [], [], 0.1)[0]:
                shown += os.read(ours, 4096)
            assert process.poll() is None, shown.decode()
        os.close(theirs)
        os.close(ours)
    run = open_run(folder / "run.nc")
    assert sorted(os.listdir(folder)) == ["run.nc", "run.toml"], os.listdir(folder)
    assert 0 < float(run["time"][-1]) < 1e7
    assert run.attrs["status"] == 6
    assert re.match(r"interrupted \(SIGHUP\) at t = ", run.attrs["message"]), run.attrs["message"]
    return "the part done is kept, although nothing can be printed any more"


FAULTS = (
    killed_while_writing,
    killed_while_replacing,
    two_writers,
    killed_holder,
    interrupted,
    terminated,
    hung_up,
    closed_terminal,
)
LONG = ()

"""Faults of processes: killed, interrupted, two at a time."""

import os
import pty
import re
import select
import signal
import subprocess
import sys
import threading
from collections import Counter
from contextlib import nullcontext
from pathlib import Path

import numpy as np

import nontwist
from nontwist import nontwisting, open_run, save_run, simulate, sine, standard
from nontwist.driver import single_run
from nontwist.errors import SimulationInterrupt
from nontwist.io import run_files, whole
from nontwist.io.run_files import reserved

from .children import CONTEXT, answer, child, happened
from .files import a_run

KILLS, WRITER = 8, {whole.__file__, run_files.__file__}


class _Lines:
    """A trace function that counts the lines of the writer that are run, and kills the process before the `last`."""

    def __init__(self, last=None):
        self.lines, self.last = 0, last

    def __call__(self, frame, event, argument):
        if frame.f_code.co_filename not in WRITER:
            return None
        if event == "line":
            self.lines += 1
            if self.lines == self.last:
                os.kill(os.getpid(), signal.SIGKILL)
        return self


def _kill(folder):
    """Kill processes that write `run.nc`, each later: how often it was not there, old, new; and what files stay."""
    os.fsync = lambda file: None  # a killed process loses nothing that the system has
    path, ends, left = folder / "run.nc", Counter(), 0
    run, small, counter = a_run(1000), a_run(), _Lines()
    sys.settrace(counter)
    save_run(run, path)
    sys.settrace(None)
    for k, number in enumerate(np.linspace(1, counter.lines, KILLS).round().astype(int).tolist()):
        path.unlink(missing_ok=True)
        if before := -(k % 2):
            save_run(small.assign_attrs(number=before), path)
        process = os.fork()
        if not process:
            sys.settrace(_Lines(number))
            save_run(run.assign_attrs(number=number), path, force=True)
            os._exit(0)
        _, status = os.waitpid(process, 0)
        assert os.waitstatus_to_exitcode(status) == -signal.SIGKILL
        left += len(os.listdir(folder)) - path.exists()
        found = open_run(path).attrs["number"] if path.exists() else 0
        assert found in (before, number), f"{found} is another run, or the old file is gone"
        ends[min(found, 1)] += 1
        save_run(small, path, force=True)
        assert os.listdir(folder) == ["run.nc"], os.listdir(folder)
    return ends[0], ends[-1], ends[1], left


def killed_while_writing(folder):
    """SIGKILL at 8 places between the first line of the writer and its last, every second time as it replaces."""
    absent, old, new, left = answer(_kill, folder)
    ends = f"{absent} times no file, {old} times the old one, {new} times the new one, whole"
    return f"{ends}; {left} temporary files, removed by the next writer"


def _holding(path, ready):
    with reserved(path):
        ready.send("ready")
        signal.pause()


def two_writers(folder):
    """Two processes with the same output file; later the first one, which holds its lock, is killed."""
    path = folder / "run.nc"
    ready, ours = CONTEXT.Pipe()
    process = child(_holding, path, ours)
    happened(process, ready)
    try:
        save_run(a_run(), path, force=True)
    except BlockingIOError as error:
        message = str(error).replace(f"{folder}/", "")
    else:
        raise AssertionError("both wrote")
    process.kill()
    process.join()
    assert os.listdir(folder) == [".run.nc.lock"], os.listdir(folder)
    save_run(a_run(), path)
    assert os.listdir(folder) == ["run.nc"], os.listdir(folder)
    return f"the second is refused: “{message}”; the lock ends with its process, and the temporary files are removed"


NOTHING = sine((0, 0, 0), frequency=1)  # without a load split takes no steps
LONG_RUN = {"t_end": 1e5, "step": 1 / 128, "material_angular_velocity": (1, 2, 0), "load": NOTHING}


class _Interrupter:
    """A progress report that has a thread send SIGINT while the block of steps after the first is marched.

    The last blocks wait for it, so that it strikes before the end on a machine of any speed.
    """

    def __init__(self):
        self.begun, self.sent = threading.Event(), threading.Event()
        threading.Thread(target=self._send, daemon=True).start()

    def _send(self):
        self.begun.wait()
        os.kill(os.getpid(), signal.SIGINT)
        self.sent.set()

    def __call__(self, part):
        self.begun.set()
        if part > 0.5:
            self.sent.wait()


def _marching(path, integrator, twisting, store):
    body = (standard if twisting else nontwisting)([3, 4, 5])
    single_run.progress_bar = lambda steps: nullcontext(_Interrupter())
    signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs in the background of a shell ignore it
    with reserved(path) as write:
        try:
            simulate(body, **LONG_RUN, integrator=integrator, store=store, progress=True)
        except SimulationInterrupt as stopped:
            write(stopped.partial.to_dataset())


def interrupted(folder):
    """Ctrl-C (SIGINT) in runs of 12.8 million steps: three integrators, every 1000th or only the last state stored."""
    for integrator, twisting, store, drift in (
        ("lie-midpoint", True, 1000, 1e-12),
        ("energy-momentum", False, 1000, 1e-12),
        ("split", True, "end", 1e-8),
    ):
        path = folder / f"{integrator}.nc"
        answer(_marching, path, integrator, twisting, store)
        run = open_run(path)
        assert run.attrs["status"] == 6
        assert 0 < float(run["time"][-1]) < LONG_RUN["t_end"], "nothing was kept, or the run was complete"
        energy = run["kinetic_energy"].values
        assert abs(energy / energy[0] - 1).max() < drift
        steps = np.rint(run["time"].values * 128)
        assert np.array_equal(steps / 128, run["time"])
    return f"the completed part is saved, with status 6; one of the messages: “{run.attrs['message']}”"


LONG_FILE = """
body = { kind = "nontwisting", inertia = [3, 4, 5] }
start.angular_velocity = { body = [1, 2, 0] }
time = { t_end = 2e6, step = 0.01, store = "end" }
integrator = { name = "lie-midpoint", order = 2 }
"""
ATTACH = """
import os, signal, sys
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # where the tests run under nohup
terminal = os.open(sys.argv[1], os.O_RDWR)  # of a session without one it becomes the controlling terminal
for number in range(3):
    os.dup2(terminal, number)
os.execv(sys.executable, [sys.executable, "-m", "nontwist", "run", "run.toml"])
"""


def closed_terminal(folder):
    """The terminal of `nontwist run` is closed while the progress bar moves."""
    (folder / "run.toml").write_text(LONG_FILE, encoding="utf-8")
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
    assert 0 < float(run["time"][-1]) < 2e6
    assert run.attrs["status"] == 6
    assert re.match(r"interrupted \(SIGHUP\) at t = ", run.attrs["message"]), run.attrs["message"]
    return "the completed part is saved, although nothing can be printed any more"


FAULTS = (killed_while_writing, two_writers, interrupted, closed_terminal)
LONG = ()

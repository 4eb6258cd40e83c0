"""A run file is read and prepared once, each file that it names is read once, and its body is made once."""

import builtins
import io
import os
from collections import Counter
from pathlib import Path

import pytest
from typer.testing import CliRunner

from nontwist import DirectorSystem
from nontwist.cli import app
from nontwist.errors import RunFileError
from nontwist.runfile import checks, read_run_file
from nontwist.runfile.body import Body
from nontwist.runfile.tables import Time

RUN = """
[body]
kind = "standard"
inertia = { mesh = { file = "box.obj", mass = 6 } }
[start]
angular_velocity = { body = [1, 2, 3] }
[[load]]
kind = "csv"
frame = "body"
file = "load.csv"
[[load]]
kind = "sine"
frame = "body"
amplitude = [1, 0, 0]
frequency = 1
[time]
t_end = 1
step = 0.01
"""
SWEEP = '[sweep]\nover = [{{ key = "{}", kind = "list", values = [0.25, 0.5, 0.75, 1] }}]\n'
ONCE = {"run.toml": 1, "load.csv": 1, "box.obj": 1, "bodies": 1}


@pytest.fixture
def counted(tmp_path, monkeypatch):
    """Count files that are read and bodies that are made, from here on."""
    trimesh = pytest.importorskip("trimesh")
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box((1, 2, 3)).export("box.obj")
    Path("load.csv").write_text("t,a,b,c\n0,1,2,3\n1,0,0,0\n", encoding="utf-8")
    found = Counter()
    opened, meshed, made = io.open, trimesh.load_mesh, DirectorSystem.__post_init__

    def count_open(file, *how, **more):
        found.update({os.path.basename(str(file))} & {"run.toml", "load.csv"})
        return opened(file, *how, **more)

    def count_mesh(file, **how):
        found.update([os.path.basename(file)])
        return meshed(file, **how)

    def count_body(self):
        found.update(["bodies"])
        made(self)

    for module in (io, builtins):
        monkeypatch.setattr(module, "open", count_open)
    monkeypatch.setattr(trimesh, "load_mesh", count_mesh)
    monkeypatch.setattr(DirectorSystem, "__post_init__", count_body)
    return found


def nontwist(*arguments):
    result = CliRunner().invoke(app, list(arguments))
    assert result.exit_code == 0, result.output


@pytest.mark.parametrize(("command", "bodies"), [("run", 3), ("check", 1)])
def test_a_command_reads_once(command, bodies, counted):
    """The summary of a run makes the body twice more, from the result."""
    Path("run.toml").write_text(RUN, encoding="utf-8")
    counted.clear()
    nontwist(command, "run.toml")
    assert counted == ONCE | {"bodies": bodies}


@pytest.mark.parametrize("key", ["start.angular_velocity.body.0", "load.0.scale", "time.t_end"])
def test_a_sweep_of_four_members_reads_once(key, counted):
    """One ensemble for all, one with other loads and one with other times for each."""
    Path("run.toml").write_text(RUN + SWEEP.format(key), encoding="utf-8")
    for arguments in (["--dry-run"], [], []):
        counted.clear()
        nontwist("sweep", "run.toml", *arguments)
        assert counted == ONCE


@pytest.mark.parametrize("command", ["run", "check", "sweep"])
def test_a_command_prepares_once(command, counted, monkeypatch):
    """Start, load, integrator and time grid: for a sweep of four velocities as for one run."""
    Path("run.toml").write_text(RUN + SWEEP.format("start.angular_velocity.body.0"), encoding="utf-8")
    calls = []
    for name in ("start_of_one", "count_steps", "stacked"):
        made = getattr(checks, name)
        monkeypatch.setattr(checks, name, lambda *given, made=made, name=name: calls.append(name) or made(*given))
    nontwist(command, "run.toml")
    assert sorted(calls) == ["count_steps", "stacked", "start_of_one"]


def test_a_changed_copy_is_prepared_anew(counted):
    Path("run.toml").write_text(RUN, encoding="utf-8")
    run_file = read_run_file("run.toml")
    later = run_file.model_copy(update={"time": Time(t_end=2, step=0.01)})
    assert [one.prepared.grid.steps for one in (run_file, later)] == [100, 200]
    assert run_file.model_copy() == run_file != later
    wrong = run_file.model_copy(update={"time": Time(t_end=-1), "body": Body(kind="standard", inertia=[1, 2, 4])})
    with pytest.raises(RunFileError) as info:
        wrong.simulate()
    assert [problem.key for problem in info.value.problems] == ["body.inertia", "time.t_end"]


def test_what_was_read_is_what_is_run_and_hashed(counted):
    """Even where the file was changed since."""
    Path("run.toml").write_text(RUN, encoding="utf-8")
    run_file = read_run_file("run.toml")
    first = run_file.simulate()
    Path("load.csv").write_text("t,a,b,c\n0,9,2,3\n1,0,0,0\n", encoding="utf-8")
    assert run_file.simulate().identical(first)
    assert not read_run_file("run.toml").simulate().directors.identical(first.directors)

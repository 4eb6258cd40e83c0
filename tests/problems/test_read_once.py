"""A run file is what was read, whatever becomes of its files; a changed copy is prepared anew."""

from pathlib import Path

import pytest

from nontwist import simulate
from nontwist.errors import RunFileError
from nontwist.runfile import read_run_file
from nontwist.runfile.basic_tables import Time
from nontwist.runfile.body import Body

RUN = """
body = { kind = "standard", inertia = { mesh = { file = "box.obj", mass = 6 } } }
start.angular_velocity.body = [1, 2, 3]
load = [{ kind = "csv", frame = "body", file = "load.csv" }]
time = { t_end = 1, step = 0.01 }
"""


def test_file_is_read_once(tmp_path, monkeypatch):
    """Even where a mesh or a table that the run file names was changed since."""
    trimesh = pytest.importorskip("trimesh")
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box((1, 2, 3)).export("box.obj")
    Path("load.csv").write_text("t,a,b,c\n0,1,2,3\n1,0,0,0\n", encoding="utf-8")
    Path("run.toml").write_text(RUN, encoding="utf-8")
    run_file = read_run_file("run.toml")
    later = run_file.model_copy(update={"time": Time(t_end=2, step=0.01)})
    assert [one.prepared.grid.steps for one in (run_file, later)] == [100, 200]
    assert run_file.model_copy() == run_file != later
    wrong = run_file.model_copy(update={"time": Time(t_end=-1), "body": Body(kind="standard", inertia=[1, 2, 4])})
    with pytest.raises(RunFileError) as info:
        simulate(wrong.problem)
    assert [problem.key for problem in info.value.problems] == ["body.inertia", "time.t_end"]
    first = simulate(run_file.problem)
    Path("load.csv").write_text("t,a,b,c\n0,9,2,3\n1,0,0,0\n", encoding="utf-8")
    trimesh.creation.box((1, 2, 4)).export("box.obj")
    assert simulate(run_file.problem).identical(first)
    assert not simulate(read_run_file("run.toml").problem).directors.identical(first.directors)

import importlib
import json
import pickle
import re
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated
from unittest.mock import patch

import numpy as np
import pytest

from conftest import BODIES
from nontwist import (
    Load,
    body_moment,
    damping,
    integrate,
    moment,
    open_sweep,
    pulse,
    rotor,
    simulate,
    sine,
    space_moment,
    standard,
    sweep,
    view,
)
from nontwist.loads import LOADS, Term
from nontwist.loads.kinds import load_of
from nontwist.runfile import read_run_file
from nontwist.runfile.document import json_schema
from nontwist.spec import Spec
from nontwist.validation import conserved
from refusals import refused_as

ROOT = Path(__file__).parents[1]


def test_a_table_is_piecewise_linear_and_zero_outside():
    load = body_moment([1, 2, 4], [[0, 0, 0], [2, 4, 6], [0, 0, 2]])
    got = load.sample([0.5, 1.5, 2, 3, 5], "body")
    assert np.array_equal(got, [[0, 0, 0], [1, 2, 3], [2, 4, 6], [1, 2, 4], [0, 0, 0]])
    assert load.breakpoints == (1, 2, 4)
    assert not load.sample([1.5], "space").any()


def test_a_function_of_time():
    load = space_moment(lambda t: (t, t**2, 0), breakpoints=[1, 0.5])
    assert np.array_equal(load.sample([2, 3], "space"), [[2, 4, 0], [3, 9, 0]])
    assert load.breakpoints == (0.5, 1)


@pytest.mark.parametrize(("shape", "impulse"), [("triangle", 1 / 2), ("rectangle", 1), ("half-sine", 2 / np.pi)])
def test_pulses_have_the_impulse_of_their_shape(shape, impulse):
    load = pulse([2, 0, 0], 1, 3, shape=shape)
    t = 1 + 2 * (np.arange(20000) + 0.5) / 20000
    assert load.sample(t, "body").mean(0)[0] * 2 == pytest.approx(4 * impulse, rel=1e-7)
    assert not load.sample([0.999, 3.0, 4], "body").any()
    assert load.breakpoints[0] == 1
    assert load.breakpoints[-1] == 3


def test_the_triangle_is_the_papers_f():
    t = np.array([0.1, 0.25, 0.5, 0.75, 0.9, 1.0])
    f = np.where(t < 0.5, 2 * t, np.where(t < 1, 2 - 2 * t, 0))
    assert pulse([1, 0, 0]).sample(t, "body")[:, 0] == pytest.approx(f, abs=1e-15)
    assert pulse([1, 0, 0]).breakpoints == (0, 0.5, 1)


def test_sine():
    load = sine([0, 2, 0], 3, phase=0.3, frame="space")
    assert load.sample([0.2], "space")[0] == pytest.approx([0, 2 * np.sin(6 * np.pi * 0.2 + 0.3), 0])


def test_sums_and_multiples():
    a, b = body_moment([0, 2], [[1, 0, 0], [1, 0, 0]]), sine([0, 1, 0], 1)
    load = 2 * a - b * 0.5 + -damping(0.1)
    assert load.sample([0.25], "body")[0] == pytest.approx([2, -0.5, 0])
    assert load.state_moment(0.0, np.eye(3), np.array([1.0, 0, 0])) == pytest.approx([0.1, 0, 0])
    assert load.depends_on_state
    assert not (a + b).depends_on_state
    assert not Load().sample([1.0], "body").any()
    assert [term["scale"] for term in load.description] == [2, -0.5, -1]


def test_damping_in_body_components():
    q = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])
    w = np.array([1.0, 2, 3])
    expected = -(q.T @ np.diag([1, 2, 3]) @ q) @ w
    assert damping([1, 2, 3]).state_moment(0, q, w) == pytest.approx(expected)
    assert damping(np.diag([1, 2, 3])).state_moment(0, q, w) == pytest.approx(expected)
    assert damping(0.5).state_moment(0, q, w) == pytest.approx(-0.5 * w)


def test_a_load_cannot_change_the_state():
    def careless(t, directors, w):
        w[:] = 0
        directors[:] = 0
        return w

    q, w = np.eye(3), np.ones(3)
    moment(careless).state_moment(0, q, w)
    assert w.all()
    assert q.any()


STATE = 0.25, np.eye(3), np.zeros(3)


@dataclass(frozen=True, eq=False)
class Heat(Term):
    times: Annotated[float, Spec("")]


class Bare(Term):
    pass


test_refused_with_the_time_or_the_value = refused_as(
    {
        "raises": lambda: body_moment(lambda t: (1 / (t - 2), 0, 0)).sample([1, 2.0], "body"),
        "shape": lambda: body_moment(lambda t: (0, 0)).sample([0.5], "body"),
        "nan": lambda: space_moment(lambda t: (0, np.nan, 0)).sample([0.5], "space"),
        "of the state": lambda: moment(lambda t, d, w: 1 / 0).state_moment(*STATE),
        "arguments of a function of the state": lambda: moment(lambda t, w: (0, 0, 1)).state_moment(*STATE),
        "arguments of a function of time": lambda: body_moment(lambda t, w: (0, 0, 1)).sample([1], "body"),
        "no values": lambda: body_moment([0, 1]),
        "order": lambda: body_moment([0, 2, 1], np.zeros((3, 3))),
        "damping": lambda: damping(-1),
        "pulse": lambda: pulse([1, 0, 0], 2, 1),
        "no text": lambda: Bare(),
        "a list": lambda: integrate(BODIES["standard"](), t_end=1, load=[damping(1), damping(2)]),
        "a key that is taken": lambda: LOADS.update(table=Heat),
        "a field that is taken": lambda: LOADS.update(heat=Heat),
        "no field": lambda: LOADS.update(bare=Bare),
        "no term": lambda: LOADS.update(other=Heat(1.0)),
        "a kind of run files": lambda: LOADS.update(csv=Heat),
    }
)


def swing(t, d, w):
    return 2 * d[2, 1] - 0.1 * w[0], -2 * d[2, 0] - 0.1 * w[1], -0.1 * w[2]


def spring(stiffness):
    return lambda t, d, w: (stiffness * d[2, 1], -stiffness * d[2, 0], 0.0)


VALUES = {
    "table": lambda: body_moment([0, 2], [[1, 0, 0], [0, -0.0, 3]]),
    "function of time": lambda: space_moment(np.cross, breakpoints=[1]),
    "pulse": lambda: pulse([1, 2, 3], 0, 2, shape="half-sine", frame="space"),
    "sine": lambda: sine([1, 2, 3], 0.5, phase=1),
    "damping": lambda: damping([1, 2, 3]),
    "rotor": lambda: rotor([0, 0, 2], 1.5),
    "rotor that spins up": lambda: rotor([0, 0, 2], [0, 1], [0, 1.5]),
    "function of the state": lambda: moment(swing),
    "compiled": lambda: moment(swing, compiled=True),
}
BY_VALUE = {
    "a function without a name": lambda: body_moment(lambda t: (t, 0, 1)),
    "a closure": lambda: moment(spring(2.0)),
    "a compiled closure": lambda: moment(spring(2.0), compiled=True),
}


@cache
def value(name):
    return VALUES[name]()


@pytest.mark.parametrize("name", VALUES)
def test_loads_are_values(name):
    load, same = value(name), VALUES[name]()
    assert load == same == pickle.loads(pickle.dumps(load))
    assert len({load, same, 2 * load, 1.0 * load}) == 2
    assert load not in [value(other) for other in VALUES if other != name]
    assert load != 3
    assert len(repr(load)) < 120


def end_of(load):
    return integrate(BODIES["standard"](), t_end=0.2, step=0.1, angular_velocity=(1, 2, 3), load=load).directors[-1]


@pytest.mark.filterwarnings("ignore:the load .* runs in Python")
def test_other_processes_take_every_load():
    loads = [make() for name, make in (VALUES | BY_VALUE).items() if name != "function of time"]
    loads.append(sum(loads, Load()))
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        for there, here in zip(pool.map(end_of, loads), map(end_of, loads), strict=True):
            assert np.array_equal(there, here)


@pytest.fixture
def magnet(monkeypatch):
    """The load of the example for contributors, registered while the test runs."""
    monkeypatch.syspath_prepend(ROOT / "examples")
    with patch.dict(LOADS):
        yield importlib.import_module("own_load").Magnet
    del sys.modules["own_load"]


FILE = """
[body]
kind = "standard"
inertia = [3, 4, 5]
[start]
angular_velocity = { body = [0.5, 0, 2] }
[[load]]
kind = "magnet"
dipole = [0.3, 0.0, 1.2]
field = [0, 1, -2]
[time]
t_end = 0.2
step = 0.1
"""
OVER = '[sweep]\nover = [{ key = "load.0.dipole.1", kind = "list", values = [0, 1, 2] }]\n'


def test_a_load_that_is_registered_later_is_known_everywhere(magnet, tmp_path):
    pytest.importorskip("zarr")
    load, path = magnet([0.3, 0, 1.2], [0, 1, -2]).load, tmp_path / "run.toml"
    assert pickle.loads(pickle.dumps(load)) == load != magnet([0.3, 0, 1.2], [0, 1, -3]).load
    path.write_text(FILE, encoding="utf-8")
    run_file = read_run_file(path)
    assert run_file.problem.load == load
    assert 'kind = "magnet"\ndipole = [0.3, 0.0, 1.2]' in run_file.text()
    run = simulate(run_file.problem)
    assert json.loads(run.attrs["load"]) == load.description
    assert load_of(json.loads(run.attrs["load"])) == load
    assert "magnet: dipole (0.3, 0, 1.2) A m², field (0, 1, −2) T" in view(run).html
    schema = json_schema()
    assert {"$ref": "#/$defs/Magnet"} in schema["properties"]["load"]["items"]["oneOf"]
    path.write_text(FILE.replace("field = [0, 1, -2]", "field = [0, 1]"), encoding="utf-8")
    with pytest.raises(ValueError, match=r"load\.0\.field: \[0, 1\] -> 3 numbers, T: along fixed axes"):
        read_run_file(path)
    path.write_text(FILE + OVER, encoding="utf-8")
    sweep(path, tmp_path / "store", progress=False)
    found = open_sweep(tmp_path / "store").material_angular_velocity.values
    for k in range(3):
        one = simulate(run_file.problem, load=magnet([0.3, k, 1.2], [0, 1, -2]))
        assert found[k] == pytest.approx(one.material_angular_velocity.values[-1], abs=1e-14)
    rows = [row for row in conserved.balances() if row.name.endswith("K + V changes by the work of the load 'magnet'")]
    assert [row.name.partition(":")[0] for row in rows] == ["lie-midpoint", "energy-momentum"]
    assert all(row.holds for row in rows)
    assert conserved.unchecked() == ()


def test_the_page_for_contributors_names_every_line():
    page = (ROOT / "docs" / "contributing" / "load.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`(\w+)` in\s+`([\w./]+)`", page))
    for name, path in named:
        place = next(p for p in (ROOT / path, ROOT / "src" / "nontwist" / path) if p.is_file())
        assert re.search(rf"^{name}\b.* = ", place.read_text(encoding="utf-8"), re.MULTILINE), (name, path)
    wanted = {"LOADS": "loads/kinds.py", "OF_TERMS": "validation/conserved.py"}
    assert set(wanted.items()) <= named
    assert conserved.OF_TERMS.keys() == LOADS.keys()


def test_a_load_knows_when_it_may_act():
    table = body_moment([0, 1, 2, 3, 5, 6, 7], np.outer([0, 0, 1, 0, 0, 0, 2], [0, 1, 0]))
    assert table.acting.tolist() == [[1, 3], [6, 7]]
    assert (table + pulse([1, 0, 0], 2.5, 4)).acting.tolist() == [[1, 4], [6, 7]]
    assert (table + pulse([1, 0, 0], 3, 6)).acting.tolist() == [[1, 7]]
    assert (table + sine([1, 0, 0], 2)).acting.tolist() == [[-np.inf, np.inf]]
    assert (Load().acting.size, Load().end, table.end) == (0, -np.inf, 7)


@pytest.mark.parametrize(
    ("integrator", "order", "times", "shortest", "longest"),
    [
        ("lie-midpoint", 2, [0.5], 0.95, 1.0),
        ("energy-momentum", 2, [0.5], 0.95, 1.0),
        ("gauss", 4, [0.5 - 3**0.5 / 6, 0.5 + 3**0.5 / 6], 0.95, 1.2),
    ],
)
@pytest.mark.filterwarnings("ignore:the load .* runs in Python")
def test_a_function_is_called_at_the_stages_with_directors_that_are_no_unit_vectors(
    integrator, order, times, shortest, longest
):
    """Steps turn by about 0.46 rad: the mean of directors at both ends has the length cos(0.23) = 0.97."""
    fractions, lengths = [], []

    def recording(t, directors, w):
        fractions.append(round(t / 0.2 % 1, 9))
        lengths.extend(np.linalg.norm(directors, axis=1))
        return -0.1 * w

    how = {"t_end": 1, "step": 0.2, "integrator": integrator, "order": order, "material_angular_velocity": (1, 2, 0.5)}
    integrate(standard([3, 4, 5]), load=moment(recording), **how)
    assert sorted(set(fractions)) == pytest.approx(times, abs=1e-8)
    assert shortest < min(lengths) < 1
    assert max(lengths) < longest
    assert (max(lengths) > 1) == (integrator == "gauss")
    assert len(lengths) / 3 > 4 * 5 * len(times)

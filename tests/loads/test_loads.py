"""Loads as values and as texts: tables, pulses, functions; loads of one's own, one class each, from which all else
follows."""

import importlib
import json
import pickle
import re
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated
from unittest.mock import patch

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import BODIES, thinned
from nontwist.analysis.invariants import drifts
from nontwist.geometry.arrays import Array
from nontwist.loads import LOADS, DirectorForces, Potential, Term
from nontwist.loads.kinds import load_of
from nontwist.runfile import read_run_file
from nontwist.runfile.document import json_schema
from nontwist.spec import Spec
from nontwist.validation import conserved
from refusals import refused_as

ROOT = Path(__file__).parents[2]


def test_moments_and_breaks():
    table = nt.body_moment([1, 2, 4], [[0, 0, 0], [2, 4, 6], [0, 0, 2]])
    got = table.sample([0.5, 1.5, 2, 3, 5], "body")
    assert np.array_equal(got, [[0, 0, 0], [1, 2, 3], [2, 4, 6], [1, 2, 4], [0, 0, 0]])
    assert not table.sample([1.5], "space").any()
    function = nt.space_moment(lambda t: (t, t**2, 0), breakpoints=[1, 0.5])
    assert np.array_equal(function.sample([2, 3], "space"), [[2, 4, 0], [3, 9, 0]])
    assert (table.breakpoints, function.breakpoints) == ((1, 2, 4), (0.5, 1))
    wave = nt.sine([0, 2, 0], 3, phase=0.3, frame="space")
    assert wave.sample([0.2], "space")[0] == pytest.approx([0, 2 * np.sin(6 * np.pi * 0.2 + 0.3), 0])


SHAPES = {
    "triangle": (lambda s: np.minimum(2 * s, 2 - 2 * s), (1, 2, 3)),  # the paper's f
    "rectangle": (np.ones_like, (1, 3)),
    "half-sine": (lambda s: np.sin(np.pi * s), (1, 3)),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_pulses_have_their_shape(shape):
    load, t, (f, kinks) = nt.pulse([2, 0, 0], 1, 3, shape=shape), np.linspace(1, 2.99, 50), SHAPES[shape]
    assert load.sample(t, "body") == pytest.approx(np.outer(f((t - 1) / 2), [2, 0, 0]), abs=1e-15)
    assert not load.sample([0.999, 3.0, 4], "body").any()
    assert load.breakpoints == kinks


def test_sums_and_multiples():
    a, b = nt.body_moment([0, 2], [[1, 0, 0], [1, 0, 0]]), nt.sine([0, 1, 0], 1)
    load = 2 * a - b * 0.5 + -nt.damping(0.1)
    assert load.sample([0.25], "body")[0] == pytest.approx([2, -0.5, 0])
    assert load.state_moment(0.0, np.eye(3), np.array([1.0, 0, 0])) == pytest.approx([0.1, 0, 0])
    assert load.depends_on_state
    assert not (a + b).depends_on_state
    assert not nt.Load().sample([1.0], "body").any()
    assert [term["scale"] for term in load.description] == [2, -0.5, -1]


def test_damping_in_body_components():
    q = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])
    w = np.array([1.0, 2, 3])
    expected = -(q.T @ np.diag([1, 2, 3]) @ q) @ w
    assert nt.damping([1, 2, 3]).state_moment(0, q, w) == pytest.approx(expected)
    assert nt.damping(np.diag([1, 2, 3])).state_moment(0, q, w) == pytest.approx(expected)
    assert nt.damping(0.5).state_moment(0, q, w) == pytest.approx(-0.5 * w)


def careless(t, directors, w):
    w[:] = directors[:] = 0
    return w


def test_load_cannot_change_the_state():
    q, w = np.eye(3), np.ones(3)
    nt.moment(careless).state_moment(0, q, w)
    assert (q.sum(), w.sum()) == (3, 3)


STATE = 0.25, np.eye(3), np.zeros(3)


@dataclass(frozen=True, eq=False)
class Heat(Term):
    times: Annotated[float, Spec("")]


class Bare(Term):
    pass


def test_unsorted_times_are_named():
    with pytest.raises(ValueError, match=r"times\[3\] = 1 follows times\[2\] = 2"):
        nt.body_moment([0, 1, 2, 1, 3], np.zeros((5, 3)))


def test_remedy_for_a_jump():
    """It is a moment that jumps from 1 to 3 N m about the third axis: J W' = 1 for 1 s, and 3 for another."""
    values = np.outer([1, 1, 3, 3], [0, 0, 1])
    with pytest.raises(ValueError, match="for a jump there") as told:
        nt.body_moment([0, 1, 1, 2], values)
    times = [0, 1, float(re.search(r"give (\S+) as", str(told.value))[1]), 2]
    run = nt.simulate(nt.standard([3, 4, 5]), t_end=2, load=nt.body_moment(times, values))
    assert run.angular_velocity.values[-1] == pytest.approx([0, 0, 4 / 5], abs=1e-8)


test_refused_with_time_or_value = refused_as(
    {
        "raises": lambda: nt.body_moment(lambda t: (1 / (t - 2), 0, 0)).sample([1, 2.0], "body"),
        "shape": lambda: nt.body_moment(lambda t: (0, 0)).sample([0.5], "body"),
        "nan": lambda: nt.space_moment(lambda t: (0, np.nan, 0)).sample([0.5], "space"),
        "of the state": lambda: nt.moment(lambda t, d, w: 1 / 0).state_moment(*STATE),
        "arguments of a function of the state": lambda: nt.moment(lambda t, w: (0, 0, 1)).state_moment(*STATE),
        "arguments of a function of time": lambda: nt.body_moment(lambda t, w: (0, 0, 1)).sample([1], "body"),
        "no values": lambda: nt.body_moment([0, 1]),
        "no times": lambda: nt.body_moment([0, 0, 1]),
        "order": lambda: nt.body_moment([0, 2, 1], np.zeros((3, 3))),
        "jump": lambda: nt.body_moment([0, 1, 1], np.zeros((3, 3))),
        "divisor": lambda: nt.damping(1) / 0,
        "damping": lambda: nt.damping(-1),
        "pulse": lambda: nt.pulse([1, 0, 0], 2, 1),
        "no text": lambda: Bare(),
        "a list": lambda: nt.integrate(BODIES["standard"](), t_end=1, load=[nt.damping(1), nt.damping(2)]),
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
    "table": lambda: nt.body_moment([0, 2], [[1, 0, 0], [0, -0.0, 3]]),
    "function of time": lambda: nt.space_moment(np.cross, breakpoints=[1]),
    "pulse": lambda: nt.pulse([1, 2, 3], 0, 2, shape="half-sine", frame="space"),
    "constant": lambda: nt.constant([1, 0, 2], frame="space"),
    "sine": lambda: nt.sine([1, 2, 3], 0.5, phase=1),
    "damping": lambda: nt.damping([1, 2, 3]),
    "rotor": lambda: nt.rotor([0, 0, 2], 1.5),
    "rotor that spins up": lambda: nt.rotor([0, 0, 2], [0, 1], [0, 1.5]),
    "function of the state": lambda: nt.moment(swing),
    "compiled": lambda: nt.moment(swing, compiled=True),
}
BY_VALUE = {
    "a function without a name": lambda: nt.body_moment(lambda t: (t, 0, 1)),
    "a closure": lambda: nt.moment(spring(2.0)),
    "a compiled closure": lambda: nt.moment(spring(2.0), compiled=True),
}


@cache
def value(name):
    return VALUES[name]()


@pytest.mark.parametrize("name", VALUES)
def test_loads_are_values(name):
    load, same = value(name), VALUES[name]()
    assert load == same == pickle.loads(pickle.dumps(load))
    assert len({load, same, 2 * load, 1.0 * load}) == 2
    assert load / 4 == 0.25 * load
    assert load not in [value(other) for other in VALUES if other != name]
    assert load != 3
    assert len(repr(load)) < 120


def end_of(load):
    return nt.integrate(BODIES["standard"](), t_end=0.2, step=0.1, angular_velocity=(1, 2, 3), load=load).directors[-1]


@pytest.mark.filterwarnings("ignore:the load .* runs in Python")
@pytest.mark.parametrize("apart", [False, pytest.param(True, marks=pytest.mark.long)])
def test_other_processes_take_every_load(apart):
    loads = [make() for name, make in (VALUES | BY_VALUE).items() if name != "function of time"]
    loads.append(sum(loads, nt.Load()))
    if apart:
        with ProcessPoolExecutor(1, get_context("spawn")) as pool:
            there = list(pool.map(end_of, loads))
    else:
        there = [end_of(pickle.loads(pickle.dumps(load))) for load in loads]
    assert np.array_equal(there, [end_of(load) for load in loads])


@pytest.fixture
def magnet(monkeypatch):
    """The load of the example for contributors, registered while the test runs."""
    monkeypatch.syspath_prepend(ROOT / "examples")
    with patch.dict(LOADS):
        yield importlib.import_module("own_load").Magnet
    del sys.modules["own_load"]


FILE = """
body = { kind = "standard", inertia = [3, 4, 5] }
start.angular_velocity.body = [0.5, 0, 2]
load = [{ kind = "magnet", dipole = [0.3, 0.0, 1.2], field = [0, 1, -2] }]
time = { t_end = 0.2, step = 0.1 }
"""
OVER = '[sweep]\nover = [{ key = "load.0.dipole.1", kind = "list", values = [0, 1, 2] }]\n'


def test_later_registered_load(magnet, write, tmp_path):
    pytest.importorskip("zarr")
    load, run_file = magnet([0.3, 0, 1.2], [0, 1, -2]).load, read_run_file(write(FILE))
    assert pickle.loads(pickle.dumps(load)) == load != magnet([0.3, 0, 1.2], [0, 1, -3]).load
    assert run_file.problem.load == load
    assert 'kind = "magnet"\ndipole = [0.3, 0.0, 1.2]' in run_file.text()
    run = nt.simulate(run_file.problem)
    assert json.loads(run.attrs["load"]) == load.description
    assert load_of(json.loads(run.attrs["load"])) == load
    assert "magnet: dipole (0.3, 0, 1.2) A m², field (0, 1, −2) T" in nt.view(run).html
    schema = json_schema()
    assert {"$ref": "#/$defs/Magnet"} in schema["properties"]["load"]["items"]["oneOf"]
    with pytest.raises(ValueError, match=r"load\.0\.field: \[0, 1\] -> 3 numbers, T: along fixed axes"):
        read_run_file(write(FILE), ["load.0.field=[0, 1]"])
    nt.sweep(write(FILE + OVER), tmp_path / "store", progress=False)
    store = nt.open_sweep(tmp_path / "store")
    assert store["load.0.dipole.1"].units == "A m2"
    found = store.material_angular_velocity.values
    for k in range(3):
        one = nt.simulate(run_file.problem, load=magnet([0.3, k, 1.2], [0, 1, -2]))
        assert found[k] == pytest.approx(one.material_angular_velocity.values[-1], abs=1e-14)
    of_package = {"APART": conserved.OF_TERMS.keys() - {"damping"}, "sample_bodies": lambda: {"": BODIES["standard"]()}}
    with patch.multiple(conserved, **of_package):
        rows = list(islice(conserved.balances(), 2, 4))  # behind those of the package
    words = [
        f"{scheme}: K + V changes by the work of the load 'magnet'" for scheme in ("lie-midpoint", "energy-momentum")
    ]
    assert [(row.name, row.holds) for row in rows] == [(one, True) for one in words]
    assert conserved.unchecked() == []


def test_contributor_page_names_lines():
    page = (ROOT / "docs" / "contributing" / "load.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`(\w+)` in\s+`([\w./]+)`", page))
    for name, path in named:
        place = next(p for p in (ROOT / path, ROOT / "src" / "nontwist" / path) if p.is_file())
        assert re.search(rf"^{name}\b.* = ", place.read_text(encoding="utf-8"), re.MULTILINE), (name, path)
    wanted = {"LOADS": "loads/kinds.py", "OF_TERMS": "validation/conserved.py"}
    assert set(wanted.items()) <= named
    assert conserved.OF_TERMS.keys() == LOADS.keys()


def test_load_knows_when_it_acts():
    table = nt.body_moment([0, 1, 2, 3, 5, 6, 7], np.outer([0, 0, 1, 0, 0, 0, 2], [0, 1, 0]))
    assert table.support.tolist() == [[1, 3], [6, 7]]
    assert (table + nt.pulse([1, 0, 0], 2.5, 4)).support.tolist() == [[1, 4], [6, 7]]
    assert (table + nt.pulse([1, 0, 0], 3, 6)).support.tolist() == [[1, 7]]
    assert (table + nt.sine([1, 0, 0], 2)).support.tolist() == [[-np.inf, np.inf]]
    assert (nt.Load().support.size, nt.Load().end, table.end) == (0, -np.inf, 7)


MIDDLE, OF_GAUSS = [0.5], 0.5 + np.array([-1, 1]) / 12**0.5
STAGES = {("lie-midpoint", 2): (MIDDLE, 1), ("energy-momentum", 2): (MIDDLE, 1), ("gauss", 4): (OF_GAUSS, 1.2)}


@pytest.mark.parametrize("scheme", STAGES)
@pytest.mark.filterwarnings("ignore:the load .* runs in Python")
def test_stages_without_unit_directors(scheme):
    """Steps turn by about 0.46 rad: the mean of directors at both ends has the length cos(0.23) = 0.97."""
    fractions, lengths, (times, longest) = [], [], STAGES[scheme]

    def recording(t, directors, w):
        fractions.append(round(t / 0.2 % 1, 9))
        lengths.extend(np.linalg.norm(directors, axis=1))
        return -0.1 * w

    how = {"step": 0.2, "integrator": scheme[0], "order": scheme[1], "material_angular_velocity": (1, 2, 0.5)}
    nt.integrate(nt.standard([3, 4, 5]), t_end=1, load=nt.moment(recording), **how)
    assert sorted(set(fractions)) == pytest.approx(times, abs=1e-8)
    assert 0.95 < min(lengths) < 1
    assert longest - 0.2 < max(lengths) < longest
    assert len(lengths) / 3 > 4 * 5 * len(times)


J = np.array([[3, 0.2, 0.4], [0.2, 4, -0.3], [0.4, -0.3, 5]])
DIPOLE, FIELD = np.array([0.3, -0.5, 1.2]), np.array([0.6, 1.0, -2.0])
START = {"rotation": Rotation.from_euler("XYZ", [0.3, 0.5, -0.2]), "material_angular_velocity": (0.4, -1.1, 0.7)}
NAMES = ("d_rotation", "d_material_angular_velocity")


@dataclass(frozen=True, eq=False)
class Needle(Term):
    """The moment of a field on a dipole."""

    needle: Annotated[Array, Spec("along the directors", unit="A m²", shape=(3,))]
    field: Annotated[Array, Spec("in space", unit="T", shape=(3,))]

    def moment(self, t, directors, angular_velocity):
        return np.cross(self.needle @ directors, self.field)


@dataclass(frozen=True, eq=False)
class Cord(Potential):
    """A spring between a point of the body and one of space."""

    cord: Annotated[float, Spec("the stiffness", unit="N/m", rule="positive")]
    point: Annotated[Array, Spec("in the body", unit="m", shape=(3,))]
    rest: Annotated[float, Spec("length", unit="m", rule="not negative")] = 0.0

    def potential(self, directors):
        apart = self.point @ directors - np.array([1.0, 0.5, 1.0])
        return 0.5 * self.cord * (np.sqrt(apart @ apart) - self.rest) ** 2


@dataclass(frozen=True, eq=False)
class Wave(Term):
    """A sine along fixed axes."""

    wave: Annotated[Array, Spec("the peak", unit="N m", shape=(3,))]
    rate: Annotated[float, Spec("of the wave", unit="Hz", rule="positive")]

    def space_moment(self, t):
        return np.sin(2 * np.pi * self.rate * t) * self.wave


@dataclass(frozen=True, eq=False)
class Headed(Term):
    heading: Annotated[Array, Spec("", shape=(3,), rule="direction in space")]

    def space_moment(self, t):
        return np.sin(2 * np.pi * 0.7 * t) * self.heading


@dataclass(frozen=True, eq=False)
class Tips(DirectorForces):
    """A dead force on each director."""

    tips: Annotated[Array, Spec("in space, a row for each director", unit="N m", shape=(3, 3))]

    def forces(self, t, directors, angular_velocity):
        return self.tips


@dataclass(frozen=True, eq=False)
class Ruled(Wave):
    """One with more fields."""

    times: Annotated[Array, Spec("", shape=(None,), rule="increasing")]
    matrix: Annotated[Array, Spec("", shape=(2, 2), rule="symmetric")]


@pytest.mark.parametrize("wrong", [{"times": [1, 1]}, {"matrix": [[1, 2], [2.1, 3]]}, {"rate": 0}, {"wave": (1, 2)}])
def test_user_field_rules(wrong):
    good = {"wave": (1, 2, 3), "rate": 1, "times": [0, 1], "matrix": [[1, 2], [2 + 4e-13, 3]]}
    assert Ruled(**good).matrix.tolist() == [[1, 2 + 2e-13], [2 + 2e-13, 3]]
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Ruled(**good | wrong)


KINDS = {"needle": Needle, "cord": Cord, "wave": Wave, "tips": Tips, "headed": Headed}
SPRING, CORD = nt.spring(3, (0, 0.2, 1), (1, 0.5, 1), 0.8), Cord(3, (0, 0.2, 1), 0.8)
WAVE = Wave((1, 2, 3), 0.7)
PAIRS = {  # a load, that of the package, and a number of the first as one of the other, and how many times it changes
    "needle": (Needle(DIPOLE, FIELD), nt.dipole(DIPOLE, FIELD), {"needle[2]": ("linear[2]", -1)}),
    "cord": (CORD, SPRING, {"cord": ("stiffness", 1), "rest": ("rest_length", 1)}),
    "wave": (WAVE, nt.sine((1, 2, 3), 0.7, frame="space"), {"wave[y]": ("sine[y]", 1), "rate": ("frequency", 1)}),
    "tips": (Tips(np.outer(DIPOLE, FIELD)), nt.dipole(DIPOLE, FIELD), {}),
}


@pytest.fixture
def registered():
    with patch.dict(LOADS, KINDS):
        yield


@pytest.mark.usefixtures("registered")
@pytest.mark.filterwarnings("ignore:.*runs in Python")
@pytest.mark.parametrize(("compiled", "name"), thinned(2, [True, False], PAIRS))
def test_user_load_moves_the_body(name, compiled):
    own, known, numbers = PAIRS[name]
    own = type(own)(*(getattr(own, field) for field in type(own).__annotations__), compiled=compiled)
    how = {"t_end": 0.5, "step": 0.1, "integrator": "gauss", "order": 8, "store": "end", **START}

    def derivatives(load, words):
        wrt = ["rotation", "load_scale", *(f"load[0].{word.partition('[')[0]}" for word in words)]
        return nt.sensitivities(nt.standard(J), load=0.5 * load, wrt=wrt, **how)

    found, truth = derivatives(own, numbers), derivatives(known, [word for word, _ in numbers.values()])
    assert abs(found.directors - truth.directors).max() < 1e-13
    columns = {name: (name, 1) for name in ("rotation[1]", "rotation[3]", "load_scale")}
    columns |= {f"load[0].{one}": (f"load[0].{other}", factor) for one, (other, factor) in numbers.items()}
    for own_column, (column, factor) in columns.items():
        for variable in NAMES:
            mine = found[variable].sel(parameter=own_column).values
            assert mine == pytest.approx(factor * truth[variable].sel(parameter=column).values, rel=1e-11, abs=1e-12)


@pytest.mark.usefixtures("registered")
@pytest.mark.parametrize("scheme", ["lie-midpoint", "energy-momentum"])
def test_user_potential_is_conserved(scheme):
    """By a discrete gradient of its text; its axes are three, so that no momentum is."""
    run = nt.simulate(nt.standard(J), t_end=20, step=0.1, load=CORD, integrator=scheme, **START)
    total = run.kinetic_energy + run.potential_energy
    assert abs(total - total[0]).max() < 1e-12
    assert set(drifts(run)) == {"total_energy", "orthonormality"}


@pytest.mark.usefixtures("registered")
def test_fields_are_parameters():
    body, load = nt.standard(J), Needle(DIPOLE, FIELD) + nt.damping(0.1) - 0.5 * WAVE
    how, wrt, last = {"t_end": 1, "step": 0.1, "load": load}, ["needle", "rate"], np.zeros((11, 3))
    d = nt.sensitivities(body, wrt=wrt, **how, **START)
    assert load == load_of(json.loads(d.attrs["load"]))
    for given, one in zip(nt.propagator(body, **how).jacobian(wrt=wrt, **START), NAMES, strict=True):
        assert given[-1] == pytest.approx(d[one].values[-1], abs=1e-14)
    last[-1] = 1, -2, 0.5
    g = nt.gradient(body, wrt=wrt, d_rotation=last, **how, **START)
    assert g.gradient.values == pytest.approx(last[-1] @ d.d_rotation.values[-1], abs=1e-13)
    many = nt.simulate_ensemble(body, **how, **START, load_scale=[1.0, 2.0])
    assert abs(many.quaternion[0, -1] - d.quaternion[-1]).max() < 1e-14
    n = np.array([1, 2, 2]) / 3  # of a direction changes across it alone count
    pairs = (Wave(n, 0.7), "wave"), (Headed(3 * n), "heading")
    by_wave, by_heading = (
        nt.sensitivities(body, **how | {"load": one}, wrt=[name], **START).d_rotation.values[-1] for one, name in pairs
    )
    assert by_heading == pytest.approx(by_wave @ (np.eye(3) - np.outer(n, n)), abs=1e-14)

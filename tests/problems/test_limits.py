"""The limits that pages state: each number is taken, one beyond it is refused at the key or argument that has it."""

from pathlib import Path

import numpy as np
import pytest

import nontwist as nt
from nontwist import Problem, exact, integrate, rotations, sine, sphere, standard, wheel
from nontwist.curves import nontwisting_frame, ribbon_twist, writhe
from nontwist.errors import RunFileError
from nontwist.runfile import files

ROOT = Path(__file__).parents[2]
BEGIN = """
body = {{ kind = "standard", inertia = [3, 4, 5] }}
start.angular_velocity.body = [0, 0, 1]
time = {{ t_end = {}, step = {}, store = "end" }}
"""
PULSE = "[[load]]\nkind = 'pulse'\nframe = 'body'\namplitude = [{}, 0, 0]\nend = 1\n"
EVENT = "[[event]]\nkind = 'spin-below'\nvalue = 0.1\nname = 'e{}'\n"
OVER = "[[sweep.over]]\nkey = 'load.{}.amplitude.0'\nkind = 'uniform'\nlow = 1\nhigh = 2\n"
GRID = "[sweep]\n[[sweep.over]]\nkey = 'time.t_end'\nkind = 'grid'\nstart = 1\nend = 5\ncount = {}\n"
USUAL = BEGIN.format(5.0, 0.01)


def long(size):
    return USUAL.ljust(size, "#")


def swept(count):
    loads = "".join(PULSE.format(1) for _ in range(count))
    return USUAL + loads + "[sweep]\nsamples = 2\n" + "".join(OVER.format(k) for k in range(count))


FILES = {  # what the page of run files says: its run file, the last number that is taken, one beyond it, the key
    "at most 1e60": (lambda x: USUAL + PULSE.format(x), 1e60, 1.01e60, "load.0.amplitude.0"),
    "at most 1 MB": (long, 10**6, 10**6 + 1, "the file"),
    "1000 tables": (lambda n: USUAL + n * PULSE.format(1), 1000, 1001, "load"),
    "100 tables `[[event]]`": (lambda n: USUAL + "".join(map(EVENT.format, range(n))), 100, 101, "event"),
    "100 tables `[[sweep.over]]`": (swept, 100, 101, "sweep.over"),
    "numbers smaller than 1e-60": (lambda x: BEGIN.format(x, x), 1e-60, 0.99e-60, "time.t_end", "time.step"),
    "10¹¹ steps": (lambda n: BEGIN.format(10.0, 10 / n), 10**11, 1.01e11, "time.step"),
    "at most 10 million values": (lambda n: USUAL + GRID.format(n), 10**7, 10**7 + 1, "sweep.over.0.count"),
}


@pytest.mark.parametrize("words", FILES)
def test_of_run_files(words, write, monkeypatch):
    text, last, beyond, *keys = FILES[words]
    assert words in " ".join((ROOT / "docs" / "run-files.md").read_text(encoding="utf-8").split())
    monkeypatch.setattr("nontwist.runfile.sweep_table.Grid.points", None)  # which is not made to be checked
    assert Problem.read(write(text(last))).system.name == "standard"
    with pytest.raises(RunFileError) as told:
        Problem.read(write(text(beyond)))
    assert sorted(fault.key for fault in told.value.problems) == sorted(keys)


@pytest.mark.parametrize("beyond", [0, 1])
def test_of_tables(beyond, write, monkeypatch):
    assert files.LARGEST_TABLE == 200_000_000
    monkeypatch.setattr(files, "LARGEST_TABLE", 20_000)
    write(bytes(20_000 + beyond), "table.csv")  # no table; but that is seen later
    table = "[[load]]\nkind = 'csv'\nframe = 'body'\nfile = 'table.csv'\ncolumns = ['t', 'x', 'y', 'z']\n"
    with pytest.raises(RunFileError) as told:
        Problem.read(write(USUAL + table))
    assert ("0.02 MB" in str(told.value)) == bool(beyond), told.value


def test_of_arguments():
    how = {"t_end": 1e-60, "step": 1e-61, "material_angular_velocity": (1e-3, 0, 0)}
    assert "finite, at most 1e100" in (ROOT / "SECURITY.md").read_text(encoding="utf-8")
    integrate(standard([1, 1, 1]), load=sine((1e100, 0, 0), 1.0), **how)
    with pytest.raises(ValueError, match=r"1e\+?100"):
        integrate(standard([1, 1, 1]), load=sine((1.01e100, 0, 0), 1.0), **how)


Z, CIRCLE = np.array([0, 0, 1]), np.array([(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0)])
DEPARTURES = {  # what pages call a vector, a rotation, a body: by how much it may be off; the rest is what is too small
    "d3": (lambda x: nontwisting_frame([Z, (0, 0, 1 + x)]), 1e-9),
    "tensor that splits": (lambda x: sphere.split_tensor([(2, 0, 0), (0, 1, 0), (2 * x, 0, 1)], Z, Z), 1e-9),
    "rotation": (lambda x: rotations.log(np.diag([1, 1, 1 + x])), 0.5e-9),
    "symmetric inertia": (lambda x: standard([(3, 5 * x, 0), (0, 4, 0), (0, 0, 5)]), 1e-12),
    "flat body": (lambda x: standard([1, 1, 2 + 8 * x]), 1e-9),
    "principal axis": (lambda x: nt.nontwisting([(3, 0, 5 * x), (0, 4, 0), (5 * x, 0, 5)]), 1e-9),
    "axis of a spin": (lambda x: nt.DirectorSystem([(3, 0, 5 * x), (0, 2, 0), (5 * x, 0, 1)], Z, spin=1), 1e-9),
    "curve that turns back": (lambda x: writhe([(0, 0, 0), (1, 0, 0), (0, 1e-14 / x, 0)], closed=False), 1e-7),
    "mass": (lambda x: nt.with_gravity(standard([3, 4, 5]), 1 + 12 * x, Z), 1e-9),
    "damping": (lambda x: nt.damping([1, 2, -2 * x]), 1e-12),
    "normal of an orbit": (lambda x: nt.gravity_gradient(1, (1, 0, 0), (x, 0, 1)), 1e-9),
    "no twist": (lambda x: exact.suslov_velocity([3, 4, 5], Z, (2, 0, 2 * x), [0]), 1e-9),
    "opposite d3": (lambda x: nontwisting_frame([Z, (0, np.sin(1e-14 / x), -np.cos(1e-14 / x))]), 1e-7),
    "d1 along d3": (lambda x: nontwisting_frame([Z], (1e-16 / x, 0, 1)), 1e-8),
    "d1 along a curve": (lambda x: ribbon_twist(CIRCLE, np.roll(CIRCLE, -1, axis=0) + 1e-16 / x * Z), 1e-8),
    "side of a polygon": (lambda x: exact.polygon_turn([(1, 0, 0), (1, 1e-24 / x, 0)]), 1e-12),
    "recorded quaternions": (lambda x: nt.twist((1 + x) * np.eye(4)[[3, 3, 3]], [0, 1, 2], scalar_first=False), 1e-2),
    "axes of friction": (lambda x: nt.dry_friction(1, (1e-24 / x, 0, 1)) + nt.dry_friction(1, Z), 1e-12),
}


@pytest.mark.filterwarnings("ignore:d3")
@pytest.mark.parametrize(("call", "limit"), DEPARTURES.values(), ids=DEPARTURES)
def test_departure_from_request(call, limit):
    call(0.98 * limit)
    with pytest.raises(ValueError):  # noqa: PT011 - of whatever sentence
        call(1.02 * limit)


@pytest.mark.parametrize(("scheme", "least"), [("gauss", 0.5), ("lie-midpoint", 2.0)])
def test_unresolved_sine_warns(scheme, least, recwarn):
    """Of so many steps a period its nodes see it twice; gauss has the order 8."""
    for count, told in ((1.001 * least, 0), (0.999 * least, 1)):
        load = sine([1, 0, 0], 1 / (0.1 * count))
        integrate(standard([20, 30, 40]), t_end=1, step=0.1, load=load, integrator=scheme)
        assert sum("does not resolve" in str(one.message) for one in recwarn.list) == told


def test_short_torque_ramps():
    def steps(ramp):
        load = wheel("z", 0.5, 1, torque=([0, ramp, 3, 3 + ramp], [0, 0.1, 0.1, 0]))
        return integrate(standard([3, 4, 5]), t_end=100, store="end", load=load).segments.steps

    assert steps(1e-4) <= steps(1) + 4


def test_of_the_shortest_span():
    with pytest.raises(ValueError, match="another unit of time"):
        integrate(standard([2, 3, 4]), t_end=5e-324, angular_velocity=(0, 0, 1))

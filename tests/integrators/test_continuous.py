import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conftest import BODIES, PAPER_J, STANDARD
from nontwist import damping, integrate, moment, nontwisting, pulse, resample, simulate, sine, space_moment, standard
from nontwist.errors import SimulationError, Status
from nontwist.integrators import Continuous, continuous
from refusals import refused_as
from tolerance_problems import generated, truth

FINE = {"rtol": 1e-13, "atol": 1e-14}
LOAD = sine([1, 2, 0.5], 0.7) + space_moment(lambda t: (np.cos(t), 0, 1)) + damping([0.1, 0.2, 0.3])


def test_breakpoints_are_integration_limits():
    """A rectangle in body components changes Π by exactly its impulse, with jumps at its ends."""
    load = pulse([3, -1, 0], 0.1, 0.35, shape="rectangle")
    run = simulate(nontwisting(PAPER_J), times=[0, 0.2, 0.5], load=load, integrator=Continuous(**FINE))
    assert run.material_momentum.values[:, :2] == pytest.approx(np.outer([0, 0.1, 0.25], [3, -1]), abs=1e-13)


test_refused_with_the_value = refused_as(
    {
        "order": lambda: simulate(standard([1, 1, 1]), t_end=1, integrator="continuous", order=4),
        "instance": lambda: simulate(standard([1, 1, 1]), t_end=1, integrator=Continuous(), order=4),
        "method": lambda: Continuous(method="Euler"),
        "form": lambda: Continuous(form="weak"),
        "rtol": lambda: Continuous(rtol=-1),
        "step": lambda: simulate(standard([1, 1, 1]), times=[0, 1], step=0.1, integrator="continuous"),
        "outside": lambda: simulate(standard([1, 1, 1]), times=[-1, 2], integrator="continuous"),
        "no end": lambda: simulate(standard([1, 1, 1]), integrator="continuous"),
    }
)


def test_failing_load():
    load = moment(lambda t, d, w: [0, 0, 1 / int(t < 0.5)], breakpoints=[0.5])
    with pytest.raises(SimulationError, match=r"raised ZeroDivisionError at t = 0\.5") as info:
        simulate(standard([1, 1, 1]), t_end=1, step=0.25, load=load, integrator="continuous")
    assert (info.value.status, info.value.partial.time.tolist()) == (Status.LOAD, [0, 0.25, 0.5])


def test_too_many_steps(monkeypatch):
    monkeypatch.setattr(continuous, "CHECK_EVERY", 100)
    monkeypatch.setattr(continuous, "PATIENCE", 100)
    how = {"t_end": 1, "step": 0.1, "material_angular_velocity": (0, 1e12, 1e12), "integrator": "continuous"}
    said, words = (
        r"^the run will take about 33 min 20 s",
        r"DOP853 would need more than 1e\+06 steps, after 100 it has",
    )
    with pytest.warns(UserWarning, match=said), pytest.raises(SimulationError, match=words):
        integrate(STANDARD, **how)


def test_jump_is_named(monkeypatch):
    monkeypatch.setattr(continuous, "BLOCK", 200)
    how = {"material_angular_velocity": (1, 0.5, 0.2), "integrator": "continuous"}
    how["load"] = moment(lambda t, d, w: -np.sign(w))
    words = r"stuck at t = 0\.776.* from (1 to -1|-1 to 1) N m.* dry_friction"
    with pytest.raises(SimulationError, match=words) as info:
        simulate(STANDARD, times=[0, 20], **how)
    assert info.value.status == Status.JUMP
    assert simulate(STANDARD, times=[0, 0.77], **how).time.size == 2


def test_both_forms_agree():
    """For other bodies it is a check of validation."""
    how = {"t_end": 1, "step": 0.25, "angular_velocity": [1, -2, 0.5], "project": True, "load": LOAD}
    a, b = (
        simulate(BODIES["nontwisting"](), integrator=Continuous(form=form, **FINE), **how)
        for form in ("split", "director")
    )
    for key in ("directors", "director_velocities", "load_work", "moment", "reaction_moment"):
        assert a[key].values == pytest.approx(b[key].values, abs=1e-11)
    energy = (a.kinetic_energy + a.potential_energy).values
    assert np.diff(energy) == pytest.approx(a.load_work.values, abs=1e-11)
    assert "newton_iterations" not in a


@pytest.mark.parametrize(
    ("method", "form", "most"), [("RK45", "split", 2e-6), ("DOP853", "split", 2e-6), ("DOP853", "director", 2e-5)]
)
def test_directors_stay_orthonormal(method, form, most):
    """Without that the error grows with the turn: to 2e-4 rad and more after 142 rad, under a load in space."""
    task = generated(560)
    R, _ = truth(task._replace(tolerance=1e-9), [task.t_end])
    how = {"times": [task.t_end], "load": task.load, **task.start}
    run = integrate(task.body, integrator=Continuous(method=method, form=form, rtol=1e-9, atol=1e-11), **how)
    assert (run.rotation[-1].inv() * R[0]).magnitude() < most


def test_resampling_is_exact():
    body, kick, x = standard([1, 2, 2.5]), {"angular_velocity": [1, 2, 3]}, np.linspace(0.013, 1.987, 57)
    fine = simulate(body, times=x, integrator=Continuous(**FINE), **kick)
    run = simulate(body, t_end=1, step=0.05, **kick)
    closed = resample(simulate(body, times=[0, 2], integrator="exact", **kick), x)
    same, stored = resample(run, run.time[::4]), run.isel(time=np.s_[::4])
    for got, known, near, bound in ((closed, fine, 1e-11, 1e-11), (same, stored, 1e-15, 1e-13)):
        assert got.directors.values == pytest.approx(known.directors.values, abs=near)
        assert got.angular_velocity.values == pytest.approx(known.angular_velocity.values, abs=bound)
        assert got.orthonormality_defect.max() < 1e-14
        assert "multipliers" not in got
    for outside in (-0.1, 1.1):
        with pytest.raises(ValueError, match=re.escape(f"times[1] = {outside} s lies outside of the run, 0 s to 1 s")):
            resample(run, [0.5, outside])


NEEDLE = np.array([2e-7, 5.6e-4, 5.6e-4])


@pytest.mark.parametrize("method", ["DOP853", "RK45", "RK23"])
def test_damped_needle_in_explicit_methods(method):
    """Turning about d2 it slows down as exp(-c t/J2); about d1, where c/J1 is 2800 times that, nothing may grow."""
    c, scheme = 0.6, Continuous(method=method, rtol=1e-6, atol=1e-8)
    how = {"t_end": 3e-4, "step": 1e-4, "angular_velocity": [1e-60, -400, 0], "integrator": scheme}
    run = simulate(standard(NEEDLE), load=damping(c), **how)
    expected = np.outer(np.exp(-c / NEEDLE[1] * run.time.values), [0, -400, 0])
    assert run.angular_velocity.values == pytest.approx(expected, rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("start", [1e-75, 1e-120])
def test_diverging_trials_are_rejected(start):
    """The same as a function: the solver finds out late, in a trial that overflows, and goes on with shorter steps."""
    c, end = 0.6, 8.1e-4
    load = moment(lambda t, d, w: -c * w)
    how = {"t_end": end, "step": end, "angular_velocity": [start, -400, 0], "integrator": "continuous"}
    run = simulate(standard(NEEDLE), load=load, **how)
    expected = [0, -400 * np.exp(-c / NEEDLE[1] * end), 0]
    assert run.angular_velocity.values[-1] == pytest.approx(expected, rel=1e-8, abs=1e-5)


@pytest.mark.parametrize("size", [1e-24, 1e12])
@pytest.mark.parametrize("form", ["split", "director"])
def test_tolerances_have_units(form, size):
    """The motion does not depend on the unit of mass: a grain of dust is as exact as the Earth."""
    scheme = Continuous(form=form, rtol=1e-8, atol=1e-10)
    how = {"t_end": 3, "step": 1, "material_angular_velocity": (0.01, 2, 0.01), "integrator": scheme}
    run = simulate(standard(size * np.array([3.0, 4, 5])), load=damping(0.1 * size), **how)
    one = simulate(STANDARD, load=damping(0.1), **how)
    assert run.directors.values == pytest.approx(one.directors.values, abs=1e-9)
    assert run.kinetic_energy.values / size == pytest.approx(one.kinetic_energy.values, rel=1e-9)


@pytest.mark.parametrize("speed", [1e-155, 1e-158, 1e-200])
def test_tiny_motions_end(speed):
    """A tolerance in units of energies near 1e-308 is 0: SciPy's first step became NaN, which it shortens for ever."""
    start = {"rotation": Rotation.from_rotvec([3, 2, 1]), "material_angular_velocity": (2 * speed, 0, speed)}
    how = {"t_end": 10, "step": 5, "integrator": "continuous", "project": True}
    run = simulate(nontwisting([1e-2, 700, 700]), **start, **how)
    assert run.material_angular_velocity.values[-1] / speed == pytest.approx([2, 0, 0], abs=1e-9)


def test_push_from_rest(monkeypatch):
    """The sizes that tolerances are relative to are those of the motion that begins."""
    counts, solver = [], continuous.solver_of("DOP853")
    counting = type("Counting", (solver,), {"step": lambda self: counts.append(self.t) or solver.step(self)})
    monkeypatch.setattr(continuous, "solver_of", lambda method: counting)
    taken = []
    for speed in (0.0, 1e-9):
        counts.clear()
        integrate(
            STANDARD, times=[1.0], load=sine((1, 2, 0), 1.0), angular_velocity=(speed, 0, 0), integrator=Continuous()
        )
        taken.append(len(counts))
    assert taken[1] <= taken[0] + 2

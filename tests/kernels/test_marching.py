"""The march of traced steps: what kernels it makes, and that its texts compute the same on floats."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from threading import Event

import numpy as np
import pytest

import nontwist as nt
from conftest import or_long
from covering.problems import BODIES, made_load, schemes
from nontwist.integrators import EnergyMomentum, gauss_newton
from nontwist.integrators import marched_stacks as stack_marching
from nontwist.integrators.compiled import Compiled
from nontwist.integrators.stack_march import StackMarch
from nontwist.integrators.stepping import in_threads
from nontwist.kernels import machine_code

START = {"angular_velocity": (0.3, -0.2, 1.5), "t_end": 0.25, "step": 0.05, "project": True}
STIFF = {**START, "t_end": 0.5, "step": 0.25}
FAST = {**STIFF, "angular_velocity": (6, -4, 8)}


def pushing(t, d, w):
    return (d[0][1] * 0.5, d[1][2] * w[0], -d[2][0])


def lagging(rate):
    """A moment that follows the angular velocity with a lag, and another that follows the first."""

    def derivative(t, z, directors, W):
        return np.array([rate * (W[0] + np.sin(t) - z[0]), 2 * z[0] * directors[0, 1] - z[1]])

    def moment(t, z, directors, W):
        return -z[0], 0.2 * z[1], 0.1 * z[0] * W[2]

    return nt.memory_load(derivative, moment, (0.3, 0.1), frame="body", compiled=True)


DRAG, MOMENT = nt.damping([50, 200, 300]), made_load("moment")
OWN = {"memory": lagging(2) + MOMENT, "drag": DRAG, "drag, moment": DRAG + MOMENT, "lag": lagging(300)}
OWN["lag, moment"] = OWN["lag"] + MOMENT
SCHEMES = schemes() | {"exact moments": EnergyMomentum(moments="exact")}
CASES = [
    ("energy-momentum 2", *pair) for pair in (("standard", "none"), ("nontwisting", "none"), ("suslov", "sum of all"))
]
CASES += [("energy-momentum 2", "heavy top", "moment"), ("exact moments", "standard", "sum of all")]
CASES += [
    ("energy-momentum 2 dissipative", "standard", "moment"),
    ("energy-momentum 1 dissipative", "standard", "none"),
]
PAIRS = [("nontwisting", "none"), ("standard", "none"), ("suslov principal", "body sine"), ("standard", "body sine")]
PAIRS += [("heavy top", "none"), ("heavy nontwisting", "none"), ("heavy top", "moment"), ("suslov", "sum of all")]
NEWTON = [("heavy top", "none", FAST), ("standard", "drag", STIFF), ("standard", "drag, moment", STIFF)]
NEWTON += [("suslov principal", "lag", STIFF), ("standard", "lag, moment", STIFF)]  # fixed points do not contract
CASES = [(*case, START) for case in CASES]
CASES += [(f"gauss {k}", *pair, START) for pair in [*PAIRS, ("standard", "memory")] for k in (2, 4)]
CASES += [(f"gauss {k}", *case) for case in NEWTON for k in (2, 4)]


@pytest.fixture
def on_floats(monkeypatch):
    """Let marches compute their texts on floats; return how often that was done."""
    count, called = [], []

    class OnFloats:
        def __init__(self, kernel):
            def compute(address):
                count.append(address)
                kernel.on_floats(address)

            self.function = machine_code.KIND(compute)
            called.append(self.function)

        def function_for(self, work):
            return self.function

    own = StackMarch.kernel
    monkeypatch.setattr(Compiled, "can_prepare", lambda *about: False)
    monkeypatch.setattr(StackMarch, "kernel", lambda *args, **changes: OnFloats(own(*args, **changes)))
    return count


@pytest.mark.filterwarnings("ignore:(damping slows|the step is coarse|internal states of the load decay):UserWarning")
@pytest.mark.parametrize(
    ("scheme", "body", "load", "how"), or_long(CASES[::4], CASES[1::4] + CASES[2::4] + CASES[3::4])
)
def test_floats_equal_machine_code(scheme, body, load, how, request, monkeypatch):
    """Where `gauss` needs Newton's iteration as well."""
    body, about = BODIES[body](1.0), how | {"load": OWN.get(load) or made_load(load), "integrator": SCHEMES[scheme]}
    machine = nt.simulate(body, **about)
    solved, own = [], gauss_newton.newton
    monkeypatch.setattr(gauss_newton, "newton", lambda *args: solved.append(1) or own(*args))
    count = request.getfixturevalue("on_floats")
    floats = nt.simulate(body, **about)
    assert count
    assert bool(solved) == (how is not START)
    for name in machine.data_vars:
        assert np.array_equal(machine[name].values, floats[name].values, equal_nan=True), name


@pytest.mark.parametrize("integrator", ["lie-midpoint", "energy-momentum", "gauss"])
def test_values_and_functions_are_arguments(integrator, monkeypatch):
    """Another inertia, step, table, stiffness, number of outputs, function or factor needs no other machine code."""
    compiled, own = [], machine_code.function_of
    monkeypatch.setattr(machine_code, "function_of", lambda *a, **b: compiled.append(a) or own(*a, **b))
    first, second = (nt.moment(f, compiled=True) for f in (pushing, lambda t, d, w: (t, w[2], d[0, 0] * 3)))
    memory, counts = lagging(2), []
    for k in range(1, 8):
        nodes = np.linspace(0.0, 0.25, 1 + k)
        load = nt.space_moment(nodes, np.outer(np.sin(k * nodes), (1, 2, 3))) + nt.sine((1, 2 + k, 3), 0.7 * k)
        load += (0.1 * k * first + 0.3 / k * second, 1.1 * k * second)[k % 2] + 0.4 * k * memory
        load += nt.spring(0.2 * k, (0.1 * k, 0, 0.5), (0, 0, 2), 0.1 * k)
        about = {"integrator": integrator, "load": load, **START, "step": 0.25 / k}
        run = nt.simulate(nt.standard([3 + 0.1 * k, 4, 5]), times=np.linspace(0.0, 0.25, 3 + k), **about)
        assert abs(run.load_work).max() > 1e-7
        counts.append(len(compiled))
    assert counts[0] > 0
    assert counts[1:] == [counts[1]] * 6


@pytest.mark.parametrize("threads", [1, 3])
def test_exception_cancels_later_blocks(threads, monkeypatch):
    """The first block fails, the others end when those that have not begun are cancelled."""
    begun, reported, cancelled = [], [], Event()

    class Pool(ThreadPoolExecutor):
        def shutdown(self, wait=True, **how):
            super().shutdown(wait=False, **how)
            cancelled.set()
            super().shutdown(wait=wait)

    def task(first, last):
        begun.append((first, last))

    def failing(first, last):
        task(first, last)
        if first == 0:
            raise ValueError
        cancelled.wait()

    monkeypatch.setattr("concurrent.futures.ThreadPoolExecutor", Pool)
    in_threads(task, (3, 25), 4, threads, reported.append)
    assert sorted(begun) == [(3, 7), (7, 11), (11, 15), (15, 19), (19, 23), (23, 25)]
    assert reported == [4, 4, 4, 4, 4, 2]
    begun.clear()
    cancelled.clear()
    with pytest.raises(ValueError):  # noqa: PT011 - of the task
        in_threads(failing, (0, 1000), 1, threads, reported.append)
    assert len(begun) <= (1 if threads == 1 else 1 + threads)


RUNS = [
    ("heavy top", "none", {}),
    ("standard", "drag", {"tolerance": 1e-6}),
    ("suslov", "sum of all", {"integrator": "gauss", "order": 4}),
    ("nontwisting", "body sine", {"times": [0.03, 0.1, 0.24]}),
    ("nontwisting", "body sine", {"tolerance": 1e-3, "integrator": "energy-momentum"}),
]


@pytest.mark.parametrize(("body", "load", "how"), RUNS)
def test_kept_marches_change_no_bit(body, load, how, monkeypatch):
    acting = OWN.get(load) or made_load(load)
    known = {"t_end": 0.25, "load": acting, "project": True, **how}

    def bits(*W):
        run = nt.simulate(BODIES[body](1.0), angular_velocity=W, **known)
        return run.attrs["memory"], {name: run[name].values.tobytes() for name in run.variables}

    starts = [(0.3, -0.2, 1.5), (0.3, -0.2, 1.4), (0.3, -0.2, 1.5)]
    kept = [bits(*W) for W in starts]
    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(lambda W: bits(*W), starts)) == kept
    monkeypatch.setattr(stack_marching, "KEPT_NODES", 0)
    assert [bits(*W) for W in starts] == kept


def test_scale_of_ensemble_of_one():
    how = {"t_end": 1, "step": 0.05, "load": nt.sine((1, -2, 0.5), 0.7) + nt.damping(0.3)}
    for scale in (2.0, 0.5, 2.0):
        run = nt.integrate(nt.standard([3, 4, 5]), **how | {"load": scale * how["load"]})
        one = nt.simulate_ensemble(nt.standard([3, 4, 5]), **how, load_scale=[scale])
        assert np.array_equal(one.material_angular_velocity.values[0, -1], run.material_angular_velocity[-1])


@pytest.mark.parametrize("how", [{}, {"step": 0.1}, {"times": [0.5, 1.0]}])
def test_python_functions_per_run(how):
    gain = [1.0]
    load = nt.body_moment(lambda t: np.array([gain[0] * np.cos(t), 0, 0]))

    def turned():
        return nt.integrate(nt.standard([3, 4, 5]), t_end=1, load=load, **how).material_angular_velocity[-1, 0]

    once, gain[0] = turned(), 2.0
    assert abs(turned() - 2 * once) <= 1e-9 * once

"""The march of traced steps: what kernels it makes, and that its texts compute the same on floats."""

from __future__ import annotations

import ctypes
import time

import numpy as np
import pytest

import nontwist as nt
from conftest import thinned
from nontwist.engine import marching
from nontwist.integrators import EnergyMomentum, Gauss, gauss_newton
from nontwist.integrators.compiled import Compiled
from nontwist.integrators.stack_march import StackMarch
from nontwist.integrators.stepping import in_threads
from nontwist.kernels import machine_code

TILTED = [[3, 0.1, 0.2], [0.1, 4, 0.3], [0.2, 0.3, 5]]
START = {"angular_velocity": (0.3, -0.2, 1.5), "t_end": 0.25, "step": 0.05, "project": True}
STIFF = {**START, "t_end": 0.5, "step": 0.25}
FAST = {**STIFF, "angular_velocity": (6, -4, 8)}


def pushing(t, d, w):
    return (d[0][1] * 0.5, d[1][2] * w[0], -d[2][0])


def loaded():
    load = nt.sine((1, 2, 3), 0.7) + nt.sine((1, 0.2, 3), 0.7, frame="space") + nt.damping([0.1, 0.2, 0.3])
    return load + nt.moment(pushing)


def lagging(rate):
    """A moment that follows the angular velocity with a lag, and another that follows the first."""

    def derivative(t, z, directors, W):
        return np.array([rate * (W[0] + np.sin(t) - z[0]), 2 * z[0] * directors[0, 1] - z[1]])

    def moment(t, z, directors, W):
        return -z[0], 0.2 * z[1], 0.1 * z[0] * W[2]

    return nt.memory_load(derivative, moment, (0.3, 0.1), frame="body", compiled=True)


FREE, HELD, TOP = nt.standard([3, 4, 5]), nt.nontwisting([3, 4, 5]), nt.heavy_top([3, 4, 5], 2.0, (0.1, 0, 0.5))
SUSLOV, SLANTED = nt.suslov(TILTED, (0, 0, 1)), nt.suslov(TILTED, (1, 2, 3))
DIRECTOR = {
    "free": (FREE, None, {}),
    "held": (HELD, None, {}),
    "suslov": (SLANTED, loaded(), {}),
    "top": (TOP, loaded(), {}),
    "exact": (FREE, loaded(), {"moments": "exact"}),
    "dissipation": (FREE, loaded(), {"dissipation": 0.5}),
    "first order": (FREE, None, {"dissipation": 0.5, "order": 1}),
}
GAUSS = {
    "steady": (HELD, None, START),
    "free": (FREE, None, START),
    "moved": (SUSLOV, nt.sine((1, 2, 3), 0.7), START),
    "driven": (FREE, nt.sine((1, 2, 3), 0.7), START),
    "heavy": (TOP, None, START),
    "held and heavy": (nt.with_gravity(HELD, 2.0, (0, 0, 0.5)), None, START),
    "all": (TOP, loaded(), START),
    "slanted": (SLANTED, loaded(), START),
    "memory": (FREE, lagging(2) + loaded(), START),
}
NEWTON = {  # whose fixed points do not contract
    "large steps": (TOP, None, FAST),
    "drag": (FREE, nt.damping([50, 200, 300]), STIFF),
    "drag and a function": (FREE, nt.damping([50, 200, 300]) + loaded(), STIFF),
    "memory held": (SUSLOV, lagging(300), STIFF),
    "fast memory": (nt.standard(TILTED), lagging(300) + loaded(), STIFF),
}
CASES = {name: (body, load, START, EnergyMomentum(**options)) for name, (body, load, options) in DIRECTOR.items()}
CASES |= {f"{name}, gauss {k}": (*case, Gauss(k)) for name, case in (GAUSS | NEWTON).items() for k in (2, 4)}


@pytest.fixture
def on_floats(monkeypatch):
    """Let marches compute their texts on floats; return how often that was done."""
    count, called = [], []

    class OnFloats:
        def __init__(self, kernel):
            def compute(address):
                count.append(address)
                kernel.on_floats(address)

            called.append(machine_code.KIND(compute))
            self.address = ctypes.cast(called[-1], ctypes.c_void_p).value

    own = StackMarch.kernel
    monkeypatch.setattr(Compiled, "can_prepare", lambda *about: False)
    monkeypatch.setattr(StackMarch, "kernel", lambda *args, **changes: OnFloats(own(*args, **changes)))
    return count


@pytest.mark.filterwarnings("ignore:(damping slows|the step is coarse|internal states of the load decay):UserWarning")
@pytest.mark.parametrize("case", thinned(3, CASES))
def test_texts_on_floats_have_the_bits_of_their_kernels(case, request, monkeypatch):
    """Where `gauss` needs Newton's iteration as well."""
    body, load, start, scheme = CASES[case]
    about = {**start, "load": load or nt.Load(), "integrator": scheme}
    machine = nt.simulate(body, **about)
    solved, own = [], gauss_newton.newton
    monkeypatch.setattr(gauss_newton, "newton", lambda *args: solved.append(1) or own(*args))
    count = request.getfixturevalue("on_floats")
    floats = nt.simulate(body, **about)
    assert count
    assert bool(solved) == (case.partition(",")[0] in NEWTON)
    for name in machine.data_vars:
        assert np.array_equal(machine[name].values, floats[name].values, equal_nan=True), name


def test_values_and_functions_are_arguments():
    """A body, a step and a load of other numbers, or with another function, need no other kernel."""

    def other(t, d, w):
        return (t, w[2], d[0, 0] * 3)

    before, about = None, {"integrator": "energy-momentum", **START}
    for k in range(1, 6):
        load, about["step"] = nt.sine((1, 2 + k, 3), 0.7 * k), 0.25 / k
        nt.simulate(nt.standard([3 + 0.1 * k, 4, 5]), load=load, **about)
        for functions in ([pushing], [other], [pushing, other]):
            load = sum((nt.moment(f, compiled=True) for f in functions), nt.Load())
            assert abs(nt.simulate(HELD, load=load, **about).load_work).max() > 1e-7
        before = before or marching.march_kernel.cache_info().currsize
        assert marching.march_kernel.cache_info().currsize == before


@pytest.mark.parametrize("threads", [1, 3])
def test_blocks_make_a_span_and_the_first_exception_cancels_those_that_have_not_begun(threads, monkeypatch):
    begun, reported = [], []

    def task(first, last):
        begun.append((first, last))

    def failing(first, last):
        task(first, last)
        if first == 0:
            raise ValueError
        time.sleep(0.01)

    in_threads(task, (3, 25), 4, threads, reported.append)
    assert sorted(begun) == [(3, 7), (7, 11), (11, 15), (15, 19), (19, 23), (23, 25)]
    assert reported == [4, 4, 4, 4, 4, 2]
    begun.clear()
    with pytest.raises(ValueError):  # noqa: PT011 - of the task
        in_threads(failing, (0, 5000), 1, threads, reported.append)
    assert len(begun) <= (1 if threads == 1 else 500)

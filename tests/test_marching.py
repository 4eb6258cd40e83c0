"""The march of traced steps: what kernels it makes, and that its texts compute the same on floats."""

from __future__ import annotations

import ctypes
from pathlib import Path

import pytest

import nontwist as nt
import texts_rule
from nontwist.integrators.compiled import Compiled
from nontwist.integrators.stack_march import StackMarch
from nontwist.kernels import machine_code

SOURCE = Path(nt.__file__).parent
START = {"angular_velocity": (0.3, -0.2, 1.5), "t_end": 0.25, "step": 0.05, "project": True}


def pushing(t, d, w):
    return (d[0][1] * 0.5, d[1][2] * w[0], -d[2][0])


def loaded():
    load = nt.sine((1, 2, 3), 0.7) + nt.sine((1, 0.2, 3), 0.7, frame="space") + nt.damping([0.1, 0.2, 0.3])
    return load + nt.moment(pushing)


CASES = {
    "free": (nt.standard([3, 4, 5]), None, {}),
    "held": (nt.nontwisting([3, 4, 5]), None, {}),
    "suslov": (nt.suslov([[3, 0.1, 0.2], [0.1, 4, 0.3], [0.2, 0.3, 5]], (1, 2, 3)), "all", {}),
    "top": (nt.heavy_top([3, 4, 5], 2.0, (0.1, 0, 0.5)), "all", {}),
    "exact": (nt.standard([3, 4, 5]), "all", {"moments": "exact"}),
    "dissipation": (nt.standard([3, 4, 5]), "all", {"dissipation": 0.5}),
    "first order": (nt.standard([3, 4, 5]), None, {"dissipation": 0.5, "order": 1}),
}


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


@pytest.mark.parametrize("case", CASES)
def test_texts_on_floats_have_the_bits_of_their_kernels(case, request):
    body, load, options = CASES[case]
    scheme = nt.integrators.EnergyMomentum(**options)
    about = {**START, "load": loaded() if load else nt.Load(), "integrator": scheme}
    machine = nt.simulate(body, **about)
    count = request.getfixturevalue("on_floats")
    floats = nt.simulate(body, **about)
    assert count
    for name in ("attitude", "angular_velocity", "multipliers", "load_work", "newton_iterations"):
        if name in machine:
            assert (machine[name].values == floats[name].values).all(), name


def test_values_are_arguments(monkeypatch):
    made = []
    own = machine_code.function_of
    monkeypatch.setattr(machine_code, "function_of", lambda *args: made.append(args) or own(*args))
    nt.simulate(nt.standard([3, 4, 5]), load=nt.sine((1, 2, 3), 0.7), integrator="energy-momentum", **START)
    made.clear()
    for k in range(1, 51):
        body, about = nt.standard([3 + 0.1 * k, 4, 5]), {**START, "step": 0.25 / k}
        load = nt.sine((1, 2 + k, 3), 0.7 * k)
        nt.simulate(body, load=load, integrator=nt.integrators.EnergyMomentum(), **about)
    assert not made


@pytest.mark.parametrize("place", ["engine", "integrators"])
def test_nothing_changes_behind_the_back_of_a_trace(place):
    for file in (SOURCE / place).glob("*.py"):
        assert not texts_rule.faults(file.read_text(encoding="utf-8")), file

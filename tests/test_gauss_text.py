"""The text of the step of `gauss`: on floats it has the bits of its kernels, where Newton is needed as well."""

from __future__ import annotations

import numpy as np
import pytest

import nontwist as nt
from nontwist.integrators import gauss_newton
from nontwist.integrators.gauss_newton import Dual, Matrix, Vector, pulled_back, pulled_back_duals, turned
from test_marching import START, loaded, on_floats

__all__ = ["on_floats"]
TILTED = [[3, 0.1, 0.2], [0.1, 4, 0.3], [0.2, 0.3, 5]]
NAMES = (
    "attitude",
    "angular_velocity",
    "multipliers",
    "load_work",
    "moment",
    "newton_iterations",
    "twist",
    "internal_state",
)
STIFF = {"angular_velocity": (0.3, -0.2, 1.5), "t_end": 0.5, "step": 0.25, "project": True}
FAST = {**STIFF, "angular_velocity": (6, -4, 8)}


def lagging(rate):
    """A moment that follows the angular velocity with a lag, and another that follows the first."""

    def derivative(t, z, directors, W):
        return np.array([rate * (W[0] + np.sin(t) - z[0]), 2 * z[0] * directors[0, 1] - z[1]])

    def moment(t, z, directors, W):
        return -z[0], 0.2 * z[1], 0.1 * z[0] * W[2]

    return nt.memory_load(derivative, moment, (0.3, 0.1), frame="body", compiled=True)


CASES = {
    "steady": (nt.nontwisting([3, 4, 5]), None, START),
    "free": (nt.standard([3, 4, 5]), None, START),
    "moved": (nt.suslov(TILTED, (0, 0, 1)), nt.sine((1, 2, 3), 0.7), START),
    "driven": (nt.standard([3, 4, 5]), nt.sine((1, 2, 3), 0.7), START),
    "heavy": (nt.heavy_top([3, 4, 5], 2.0, (0.1, 0, 0.5)), None, START),
    "held and heavy": (nt.with_gravity(nt.nontwisting([3, 4, 5]), 2.0, (0, 0, 0.5)), None, START),
    "all": (nt.heavy_top([3, 4, 5], 2.0, (0.1, 0, 0.5)), loaded(), START),
    "slanted": (nt.suslov(TILTED, (1, 2, 3)), loaded(), START),
    "large steps": (nt.heavy_top([3, 4, 5], 2.0, (0.1, 0, 0.5)), None, FAST),
    "drag": (nt.standard([3, 4, 5]), nt.damping([50, 200, 300]), STIFF),
    "drag and a function": (nt.standard([3, 4, 5]), nt.damping([50, 200, 300]) + loaded(), STIFF),
    "memory": (nt.standard([3, 4, 5]), lagging(2) + loaded(), START),
    "memory held": (nt.suslov(TILTED, (0, 0, 1)), lagging(300), STIFF),
    "fast memory": (nt.standard(TILTED), lagging(300) + loaded(), STIFF),
}
NEWTON = (
    "large steps",
    "drag",
    "drag and a function",
    "memory held",
    "fast memory",
)  # whose fixed points do not contract


@pytest.mark.filterwarnings("ignore:damping slows:UserWarning", "ignore:the step is coarse:UserWarning")
@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("case", CASES)
def test_texts_on_floats_have_the_bits_of_their_kernels(case, order, request, monkeypatch):
    body, load, start = CASES[case]
    about = {**start, "load": load or nt.Load(), "integrator": nt.integrators.Gauss(order)}
    machine = nt.simulate(body, **about)
    solved, own = [], gauss_newton.newton
    monkeypatch.setattr(gauss_newton, "newton", lambda *args: solved.append(1) or own(*args))
    count = request.getfixturevalue("on_floats")
    floats = nt.simulate(body, **about)
    assert count
    assert bool(solved) == (case in NEWTON)
    for name in NAMES:
        if name in machine:
            assert np.array_equal(machine[name].values, floats[name].values, equal_nan=True), name


def test_rows_that_turn_with_the_body():
    """Of C⁻¹ f, the derivatives by turns and by f are those of differences."""
    rng = np.random.default_rng(1)
    C, f, df = rng.normal(size=(3, 3)), rng.normal(size=3), rng.normal(size=(3, 6))
    rows = Matrix(*(turned(Vector(*row)) for row in C))
    given = Vector(*(Dual(x, list(row)) for x, row in zip(f, df, strict=True)))
    found, e = pulled_back_duals(rows, given), 1e-6
    for j in range(6):
        changes = []
        for sign in (1, -1):
            axis = np.eye(3)[j - 3] if j > 2 else np.zeros(3)
            turned_rows = C + sign * e * np.cross(C, axis)
            changes.append(pulled_back(Matrix(*map(tuple, turned_rows)), Vector(*(f + sign * e * df[:, j]))))
        slope = [(a - b) / (2 * e) for a, b in zip(*changes, strict=True)]
        assert [x.tangents[j] for x in found] == pytest.approx(slope, rel=1e-7, abs=1e-7)

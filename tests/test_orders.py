"""Measured orders of every scheme on every kind of body against the continuous equations."""

import numpy as np
import pytest

from conftest import BODIES, PAPER_J
from nontwist import Continuous, body_moment, integrate, nontwisting, space_moment, standard, suslov

TILTED = [[3, 0.2, 0.4], [0.2, 4, -0.3], [0.4, -0.3, 5]]


def push(t):
    return 3 * np.sin(3 * t), 1, 0.3


PROBLEMS = {
    "non-twisting, load in the body": (lambda: nontwisting(PAPER_J), [1, -2, 0], lambda: body_moment(push)),
    "non-twisting, load in space": (lambda: nontwisting(PAPER_J), [1, -2, 0], lambda: space_moment(push)),
    "free standard": (lambda: standard(TILTED), [1, -2, 3], lambda: None),
    "free Suslov, tilted axis": (lambda: suslov(TILTED, [0.3, 0.2, 1]), [1, -2, 0], lambda: None),
    "heavy top": (BODIES["heavy_top"], [1, 0.5, 4], lambda: None),
}


@pytest.mark.parametrize("scheme", ["lie-midpoint", "energy-momentum"])
@pytest.mark.parametrize("problem", PROBLEMS)
def test_order_two(problem, scheme):
    make, w, load = PROBLEMS[problem]
    kick = {"t_end": 1, "angular_velocity": w, "project": True, "load": load()}
    exact = integrate(make(), step=1, integrator=Continuous(rtol=1e-13, atol=1e-14), **kick)
    errors = []
    for n in (50, 100, 200):
        run = integrate(make(), step=1 / n, integrator=scheme, order=2, **kick)
        errors.append(np.linalg.norm(run.directors[-1] - exact.directors[-1]))
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(2, abs=0.05)
    assert errors[-1] > 1e-9

"""Measured orders of every scheme on every kind of body against the continuous equations."""

from functools import cache
from itertools import product

import numpy as np
import pytest

from conftest import BODIES, PAPER_J, compiled_load
from nontwist import damping, gravity_gradient, integrate, nontwisting, pulse, rotor, standard, suslov, with_gravity
from nontwist.integrators import INTEGRATORS, EnergyMomentum, LieMidpoint
from nontwist.validation.orders import swing
from nontwist.validation.problems import SHARP, pushed

TILTED = [[3, 0.2, 0.4], [0.2, 4, -0.3], [0.4, -0.3, 5]]
BOTH, STATE = pushed("body") + pushed("space"), compiled_load(swing)
HELD = with_gravity(suslov(np.diag([3.0, 4, 5]), [1, 0, 0]), 0.5, [0.1, 0.2, 0.3])
ROTORS = rotor((1, 2, -0.5), [0.5, 1.0], [2.0, 5.0]) + rotor((0, 0, 1), 1.5) + damping(0.1)
SPUN = nontwisting([3, 4, 5], spin=([0.5, 1.0], [0.4, 3.0]))
PROBLEMS = {
    "non-twisting": (nontwisting(PAPER_J), [1, -2, 0], BOTH),
    "non-twisting, kinks on the grid": (nontwisting(PAPER_J), [1, -2, 0], pulse([3, 1, 0], 0.5, 1.5)),
    "heavy, held about x": (HELD, [2, -4, 0], STATE),
    "standard": (standard(TILTED), [1, -2, 3], BOTH),
    "heavy top, load of the state": (BODIES["heavy_top"](), [1, 0.5, 4], STATE),
    "heavy top": (BODIES["heavy_top"](), [1, 0.5, 4], None),
    "free standard": (standard(TILTED), [1, -2, 3], None),
    "free Suslov, tilted axis": (suslov(TILTED, [0.3, 0.2, 1]), [2, -4, 0], None),
    "Suslov": (suslov(TILTED, [0.3, 0.2, 1]), [1, -2, 0], BOTH + STATE),
    "gyrostat": (standard(TILTED), [0.4, -1.1, 0.7], ROTORS),
    "gyrostat, Suslov": (suslov(TILTED, [0.3, 0.2, 1]), [0.4, -1.1, 0.7], ROTORS),
    "spun, heavy": (with_gravity(SPUN, 1.5, (0.1, 0, 0.3)), [1, 2, 0], damping(0.1)),
    "free, on an ellipse": (standard([1, 1.37, 1.4]), [0.1, 0.2, 1.2], gravity_gradient(1, eccentricity=0.25)),
}
SCHEMES = [kind(order=k) for kind in INTEGRATORS.values() for k in kind.orders if k < 8]  # test_gauss: of all orders
DISSIPATIVE = [kind(order, dissipation=0.7) for kind in (LieMidpoint, EnergyMomentum) for order in (1, 2)]


def cases():
    """Every scheme on every problem; in the quick suite one of the orders of a scheme on each problem."""
    for k, problem in enumerate(PROBLEMS):
        for scheme in SCHEMES:
            is_quick = len(scheme.orders) == 1 or scheme.order == 2 + 2 * (k % 3)
            refused = {"split": ("free", "Suslov", "kinks", "gyrostat", "spun"), "energy-momentum": ("spun",)}
            if not any(word in problem for word in refused.get(scheme.name, ())):
                yield pytest.param(problem, scheme, marks=[] if is_quick else pytest.mark.long)
    yield from product(("standard", "heavy top, load of the state"), DISSIPATIVE)


@cache
def exact(problem):
    body, w, load = PROBLEMS[problem]
    how = {"t_end": 2, "angular_velocity": w, "project": True, "load": load, "store": "end"}
    return body, how, integrate(body, step=0.5, integrator=SHARP, **how)


def velocity(run):
    return np.cross(run.directors[-1], run.director_velocities[-1]).sum(0) / 2


@pytest.mark.parametrize(("problem", "scheme"), list(cases()), ids=str)
def test_orders(problem, scheme):
    """Of the directors, and of the velocities."""
    body, how, end = exact(problem)
    steps = (1024, 2048) if scheme in DISSIPATIVE else scheme.measuring(scheme.order)[:2]
    runs = [integrate(body, step=2 / n, integrator=scheme, **how) for n in steps]
    errors = [np.linalg.norm(run.directors[-1] - end.directors[-1]) for run in runs]
    velocities = [np.linalg.norm(velocity(run) - velocity(end)) for run in runs]
    ratio = steps[1] / steps[0]
    assert errors[1] > 2e-12
    assert np.log(errors[0] / errors[1]) / np.log(ratio) == pytest.approx(
        scheme.order, abs=0.05 if scheme in DISSIPATIVE else 0.1
    )
    assert velocities[1] < max(velocities[0] * ratio ** (0.2 - scheme.order), 3e-12)

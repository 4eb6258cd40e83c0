"""The engine: one text for one body and for bodies in lanes, units in which no number is far from 1."""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np
import pytest

import nontwist as nt
from conftest import compiled_load
from covering.problems import BODIES as KINDS
from nontwist.integrators import INTEGRATORS
from nontwist.integrators.compiled import Compiled

BODIES = {name: KINDS[name](1.0) for name in ("standard", "nontwisting", "suslov", "heavy top")}
SCHEMES = {name: one for name, one in INTEGRATORS.items() if issubclass(one, Compiled)}
PAIRS = [pair for pair in product(SCHEMES, BODIES) if pair != ("split", "suslov")]  # whose axis is not principal


def marked(cases, every=1):
    """Return the cases, for the long suite those of gauss, slow to compile, and all but every so manieth."""
    is_long = [case[0] == "gauss" or k % every > 0 for k, case in enumerate(cases)]
    return [pytest.param(*case, marks=[pytest.mark.long] * late) for case, late in zip(cases, is_long, strict=True)]


def starts(body, m):
    rng = np.random.default_rng(5)
    W = rng.normal(size=(m, 3)) * np.linspace(0.1, 6, m)[:, None]
    return W if body.axis is None else W - np.outer(W @ body.axis, body.axis)


@cache
def slowed(r):
    return lambda t, d, w: (d[0, 1], d[1, 2], w[0] * (1 / r))


LOADS = {  # of moments s r², times over r, damping s r
    "none": lambda s, r: nt.Load(),
    "pulse": lambda s, r: s * r * r * nt.pulse((1, 2, 3), 0.0, 0.32 / r),
    "sines and damping": lambda s, r: (
        s * r * r * (nt.sine((1, 2, 3), 0.7 * r) + nt.sine((3, 2, 0.5), 0.9 * r, frame="space"))
        + s * r * nt.damping([0.1, 0.2, 0.3])
    ),
    "compiled": lambda s, r: s * r * r * compiled_load(slowed(r)),
    "about an axis": lambda s, r: s * r * r * nt.sine((1, 2, 0), 0.7 * r),
}


@pytest.mark.parametrize(("scheme", "body"), marked(PAIRS))
def test_statistics_change_no_bit(scheme, body):
    how = {"t_end": 0.5, "step": 0.02, "store": 5, "load": nt.sine((1, 2, 3), 0.7) + nt.damping([0.1, 0.2, 0.3])}
    how |= {"integrator": scheme, "order": SCHEMES[scheme].orders[:2][-1]}
    how["material_angular_velocity"] = starts(BODIES[body], 3)
    plain, observed = (nt.simulate_ensemble(BODIES[body], reduce=kept, **how) for kept in ((), ("drift", "averages")))
    for name in ("quaternion", "material_angular_velocity"):
        assert np.array_equal(plain[name], observed[name])


FREE = [(*pair, load) for pair in PAIRS for load in ("none", "pulse", "sines and damping")]
CALLED = [(*pair, "compiled") for pair in PAIRS if pair[1] in ("standard", "nontwisting")]  # compiles each anew
CLOSED = [("exact", "standard", "none"), ("exact", "symmetric", "none"), ("exact", "symmetric", "about an axis")]


@pytest.mark.parametrize(("scheme", "body", "load"), [*marked(FREE, 2), *marked(CALLED), *CLOSED])
def test_powers_of_two_scale_exactly(scheme, body, load):
    """J times s, W times r, times over r, moments times s r², damping times s r, dead forces times s r²."""
    own = BODIES.get(body) or nt.nontwisting([3, 3, 5])
    W = np.array([1, 2, 0]) if body == "symmetric" else starts(own, 3)[1]

    def run(s, r):
        system = nt.DirectorSystem(s * own.euler_inertia, own.axis, s * r * r * own.dead_force)
        how = {"times": np.linspace(0, 1, 11) / r} if scheme == "exact" else {"t_end": 1 / r, "step": 0.02 / r}
        return nt.integrate(system, material_angular_velocity=r * W, load=LOADS[load](s, r), integrator=scheme, **how)

    plain = run(1.0, 1.0)
    pairs = [(2.0**200, 2.0**40), (2.0**-330, 2.0**-100), (2.0**-20, 2.0**120)]
    for s, r in pairs if load != "compiled" else pairs[:1]:
        scaled, moments = run(s, r), s * r * r
        factors = {"directors": 1, "director_velocities": r, "multipliers": moments, "moment": moments}
        factors |= {"load_work": moments, "newton_iterations": 1, "dead_moment": moments, "twist": 1}
        for name, factor in factors.items():
            if getattr(plain, name) is not None:
                assert np.array_equal(getattr(scaled, name), factor * getattr(plain, name)), name

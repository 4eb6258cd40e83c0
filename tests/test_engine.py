"""The engine: one text for one body and for bodies in lanes, units in which no number is far from 1."""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np
import pytest

import nontwist as nt
from conftest import compiled_load
from nontwist.integrators import INTEGRATORS
from nontwist.integrators.compiled import Compiled
from nontwist.integrators.problem import IVP
from nontwist.integrators.stack_march import StackMarch

TILTED = [[3, 0.1, 0.2], [0.1, 4, 0.3], [0.2, 0.3, 5]]
AXIS = np.array([1.0, 2, 3])
BODIES = {
    "standard": nt.standard(TILTED),
    "nontwisting": nt.nontwisting([3, 4, 5]),
    "suslov": nt.suslov(TILTED, AXIS),
    "heavy_top": nt.heavy_top([3, 4, 5], 2.0, (0.1, 0, 0.5)),
}
SCHEMES = {name: one for name, one in INTEGRATORS.items() if issubclass(one, Compiled)}
PAIRS = [pair for pair in product(SCHEMES, BODIES) if pair != ("split", "suslov")]  # whose axis is not principal


def marked(cases):
    """Return the cases, those of gauss, whose kernels take long to compile, for the long suite."""
    return [pytest.param(*case, marks=[pytest.mark.long] if case[0] == "gauss" else []) for case in cases]


def pushing(t, d, w):
    return (d[0, 1] * 0.5, d[1, 2] * w[0], -d[2, 0])


LOADS = {
    "none": nt.Load(),
    "body": nt.sine((1, 2, 3), 0.7),
    "pulse": nt.pulse((1, 2, 3), 0.0, 0.32),
    "space": nt.sine((1, 0.2, 3), 0.7, frame="space"),
    "damping": nt.damping([0.1, 0.2, 0.3]) + nt.sine((1, 2, 3), 0.7),
    "compiled": None,  # when it is used
    "python": nt.moment(pushing) + nt.sine((1, 2, 3), 0.7),
}


def stack(bodies, W, load, scales, steps=60):
    load = compiled_load(pushing) + nt.damping(0.1) if load is None else load
    q = np.tile([0.5, 0.5, -0.5, 0.5], (len(W), 1))
    grid = 0.0, 0.02 * steps, steps, np.arange(steps + 1)
    return IVP(nt.DirectorSystem.stack(bodies), q, W, load, *grid, scales, intervals=True)


def starts(body, m):
    rng = np.random.default_rng(5)
    W = rng.normal(size=(m, 3)) * np.linspace(0.1, 6, m)[:, None]
    return W if body.axis is None else W - np.outer(W @ body.axis, body.axis)


@pytest.mark.parametrize("order", [2, 4, 6])
@pytest.mark.parametrize("load", ["none", "body", "pulse", "space"])
def test_members_of_any_form_have_the_bits_of_a_run_of_their_own(load, order):
    """Heavy bodies and others in one stack, whose loads split takes at other nodes."""
    held, m = nt.nontwisting([3, 4, 5]), 6
    heavy = nt.with_gravity(held, 0.5, [0.1, 0.2, 0.3])
    bodies, W, scales = [held, heavy] * (m // 2), starts(held, m), np.linspace(0, 2, m)
    together = StackMarch(stack(bodies, W, LOADS[load], scales), SCHEMES["split"](order=order))
    together.run(threads=2)
    for i in range(m):
        alone = stack(bodies[i : i + 1], W[i : i + 1], LOADS[load], scales[i : i + 1])
        alone = StackMarch(alone, SCHEMES["split"](order=order))
        alone.run()
        for name in ("quaternions", "velocities", "intervals", "states"):
            assert np.array_equal(alone.arrays[name][0], together.arrays[name][i]), (name, i)


@pytest.mark.parametrize(("scheme", "body"), marked(PAIRS))
def test_a_member_with_statistics_has_the_same_bits(scheme, body):
    W = starts(BODIES[body], 3)
    how = {
        "t_end": 0.5,
        "step": 0.02,
        "store": 5,
        "load": LOADS["damping"],
        "integrator": scheme,
        "order": SCHEMES[scheme].orders[:2][-1],
    }
    plain, observed = (
        nt.simulate_ensemble(BODIES[body], material_angular_velocity=W, reduce=reduce, **how)
        for reduce in ((), ("drift", "averages"))
    )
    for name in ("quaternion", "material_angular_velocity"):
        assert np.array_equal(plain[name], observed[name])


FREE = [(*pair, load) for pair in PAIRS for load in ("none", "body", "pulse", "space", "damping")]
CALLED = [(*pair, "compiled") for pair in PAIRS if pair[1] in ("standard", "nontwisting")]  # compiles each anew


@cache
def slowed(r):
    return lambda t, d, w: (d[0, 1], d[1, 2], w[0] * (1 / r))


@pytest.mark.parametrize(("scheme", "body", "load"), marked(FREE + CALLED))
def test_scaling_by_powers_of_two_changes_no_bit(scheme, body, load):
    """J times s, W times r, times over r, moments times s r², damping times s r, dead forces times s r²."""
    own, W = BODIES[body], starts(BODIES[body], 3)[1]

    def run(s, r):
        system = nt.DirectorSystem(s * own.euler_inertia, own.axis, s * r * r * own.dead_force)
        made = {
            "none": nt.Load,
            "body": lambda: s * r * r * nt.sine((1, 2, 3), 0.7 * r),
            "pulse": lambda: s * r * r * nt.pulse((1, 2, 3), 0.0, 0.32 / r),
            "space": lambda: s * r * r * nt.sine((1, 2, 3), 0.7 * r, frame="space"),
            "damping": lambda: s * r * nt.damping([0.1, 0.2, 0.3]),
            "compiled": lambda: s * r * r * compiled_load(slowed(r)),
        }[load]()
        return nt.integrate(
            system, t_end=1 / r, step=0.02 / r, material_angular_velocity=r * W, load=made, integrator=scheme
        )

    plain = run(1.0, 1.0)
    pairs = [(2.0**200, 2.0**40), (2.0**-330, 2.0**-100), (2.0**-20, 2.0**120)]
    for s, r in pairs if load != "compiled" else pairs[:1]:
        scaled = run(s, r)
        assert np.array_equal(scaled.directors, plain.directors)
        assert np.array_equal(scaled.director_velocities, r * plain.director_velocities)
        assert np.array_equal(scaled.multipliers, s * r * r * plain.multipliers)
        assert np.array_equal(scaled.moment, s * r * r * plain.moment)
        assert np.array_equal(scaled.load_work, s * r * r * plain.load_work)
        assert np.array_equal(scaled.newton_iterations, plain.newton_iterations)
        assert np.array_equal(scaled.dead_moment, s * r * r * plain.dead_moment)
        assert plain.twist is None or np.array_equal(scaled.twist, plain.twist)


@pytest.mark.parametrize(("body", "load"), [("standard", "none"), ("nontwisting", "none"), ("nontwisting", "body")])
def test_scaling_by_powers_of_two_changes_no_bit_of_closed_solutions(body, load):
    """The load turns the body about one axis, for which there is a solution."""
    own = BODIES["standard"] if body == "standard" else nt.nontwisting([3, 3, 5])

    def run(s, r):
        return nt.integrate(
            nt.DirectorSystem(s * own.euler_inertia, own.axis),
            times=np.linspace(0, 1, 11) / r,
            material_angular_velocity=r * np.array([1, 2, 3 * (own.axis is None)]),
            load=None if load == "none" else s * r * r * nt.sine((1, 2, 0), 0.7 * r),
            integrator="exact",
        )

    plain = run(1.0, 1.0)
    for s, r in [(2.0**200, 2.0**40), (2.0**-330, 2.0**-100), (2.0**-20, 2.0**120)]:
        scaled = run(s, r)
        assert np.array_equal(scaled.directors, plain.directors)
        assert np.array_equal(scaled.director_velocities, r * plain.director_velocities)
        for name in ("multipliers", "moment", "load_work"):
            assert np.array_equal(getattr(scaled, name), s * r * r * getattr(plain, name))


def test_a_small_body_that_turns_slowly_keeps_its_momentum():
    """Whose squares are no numbers: the momentum was once off by 41 %."""
    run = nt.integrate(
        nt.standard(1e-100 * np.array(TILTED)), t_end=1e29, step=1e27, material_angular_velocity=(1e-30, 2e-30, -1e-30)
    ).to_dataset()
    pi = run.spatial_momentum.values
    assert pi == pytest.approx(np.tile(pi[0], (len(pi), 1)), rel=1e-12)

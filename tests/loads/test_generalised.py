"""Director forces, moments that act exactly on directors, and potentials: against SciPy, closed forms, references."""

import json
from functools import cache
from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import NONTWISTING, thinned
from covering.problems import FULL as J
from exact_reference import by_scipy
from nontwist.analysis.invariants import drifts
from nontwist.errors import SimulationError
from nontwist.integrators import Continuous, EnergyMomentum, Gauss
from nontwist.loads.kinds import load_of
from nontwist.validation.compiled_steps import ReferenceEnergyMomentum
from refusals import refused_as, says

FREE, HELD, SLANTED = nt.standard(J), NONTWISTING, nt.suslov(J, (0.3, 0.2, 1))
START = {
    "rotation": Rotation.from_quat([0.5, 0.1, 0.2, 0.8]),
    "material_angular_velocity": (1, 2, 0.5),
    "project": True,
}
TIMES = np.linspace(0, 2, 5)
FORCES = np.random.default_rng(1).standard_normal((5, 3, 3)) * 3
EXACT = EnergyMomentum(moments="exact")
STEPPING = [("gauss", 4), ("lie-midpoint", 2), ("energy-momentum", 2), (EXACT, None), ("split", 4)]


def well(g):
    return 2 * np.cos(g[0]) + g[1] ** 3 + np.exp(0.5 * g[2])


def slope(g):
    return np.array([-2 * np.sin(g[0]), 3 * g[1] ** 2, 0.5 * np.exp(0.5 * g[2])])


def pair(g):
    return 2 * g[0][0] * g[1][1] + g[0][2] ** 4


def slope_of_pair(g):
    return np.array([[2 * g[1][1], 0, 4 * g[0][2] ** 3], [0, 2 * g[0][0], 0]])


def forces(t, d, w):
    return np.array([[np.sin(t), w[0], d[0][1]], [1, d[2][0], 0], [0.3 * w[2], 0, -2.0]])


Q = np.array([[2, 0.3, 0], [0.3, -1, 0.5], [0, 0.5, 4]])
SPRING = {"stiffness": 8, "point": (0.2, 0.1, 0.8), "anchor": (0, 0, 1.5)}
POTENTIALS = {
    "quadratic": (QUADRATIC := nt.potential((0, 0, 1), linear=(1, 2, -1), quadratic=Q)),
    "spring": nt.spring(*SPRING.values(), 0.7),
    "function": nt.potential((0, 0, 1.0), well, slope, compiled=True),
    "linear": nt.spring(*SPRING.values()) + nt.dipole((1, 2, -3), (0, 0, 2)),
    "two": nt.potential([(0, 0, 1), (1, 0, 0)], pair, slope_of_pair, compiled=True),
}


def table_at(t):
    return np.array([np.interp(t, TIMES, column) for column in FORCES.reshape(5, 9).T]).reshape(3, 3)


def along(a, gradient):
    """The forces of a potential of the components of the directors along a."""
    return -np.outer(gradient, a)


def of_spring(q, rest):
    length = np.linalg.norm(np.array(SPRING["point"]) @ q - SPRING["anchor"])
    return along(SPRING["anchor"], -8 * (1 - rest / length) * np.array(SPRING["point"]))


def of_orbit(t, q):
    c, s = np.cos(0.7 * (t - 0.3)) / np.sqrt(2), np.sin(0.7 * (t - 0.3)) / np.sqrt(2)
    r = np.array([c - s, c + s, 0])
    return along(r, 3 * 0.49 * J @ (q @ r))


UP = np.array([0, 0, 1.0])
FORCED = {  # loads of forces, of potentials, and what they are by hand
    "table in space": (lambda: nt.director_forces(TIMES, FORCES), lambda t, q, w: table_at(t)),
    "table along directors": (lambda: nt.director_forces(TIMES, FORCES, frame="body"), lambda t, q, w: table_at(t) @ q),
    "function of the state": (lambda: nt.director_forces(forces), forces),
    "compiled": (lambda: nt.director_forces(forces, frame="body", compiled=True), lambda t, q, w: forces(t, q, w) @ q),
    "quadratic": (lambda: QUADRATIC, lambda t, q, w: along(UP, (1, 2, -1) + Q @ q[:, 2])),
    "spring": (lambda: POTENTIALS["spring"], lambda t, q, w: of_spring(q, 0.7)),
    "linear": (lambda: POTENTIALS["linear"], lambda t, q, w: of_spring(q, 0.0) + along(UP, (-2, -4, 6))),
    "function": (lambda: POTENTIALS["function"], lambda t, q, w: along(UP, slope(q[:, 2]))),
    "in Python": (lambda: nt.potential((0, 0, 1.0), well, slope), lambda t, q, w: along(UP, slope(q[:, 2]))),
    "two": (
        lambda: POTENTIALS["two"],
        lambda t, q, w: sum(map(along, np.eye(3)[[2, 0]], np.array(slope_of_pair(q.T[[2, 0]])))),
    ),
    "orbit": (lambda: nt.gravity_gradient(0.7, (1, 1, 0), (0, 0, 2), 0.3), lambda t, q, w: of_orbit(t, q)),
}


@cache
def truth(name):
    """Directors after 2 s, and the work of the load."""
    q, W = START["rotation"].as_matrix().T, START["material_angular_velocity"]
    return by_scipy(J, W, FORCED[name][1], 2.0, q, max_step=0.05)[::2]


@pytest.mark.parametrize(("name", "way"), thinned(3, FORCED, STEPPING))
def test_motion_and_work(name, way):
    """The order of both; that momentum changes by the moment, and energy by the work: `test_contract`."""
    load, (scheme, order), errors = FORCED[name][0](), way, []
    directors, work = truth(name)
    for n in (64, 128):
        run = nt.simulate(FREE, t_end=2, step=2 / n, load=load, integrator=scheme, order=order, **START)
        errors.append((abs(run.directors.values[-1] - directors).max(), abs(run.load_work.values.sum() - work)))
    orders = np.log2(errors[0]) - np.log2(errors[1])
    assert orders[0] == pytest.approx(order or 2, abs=0.25)
    assert load.potentials or orders[1] == pytest.approx(order or 2, abs=0.25)


@pytest.mark.parametrize("name", FORCED)
def test_motion_to_many_digits(name):
    load, (directors, _) = FORCED[name][0](), truth(name)
    assert load.breakpoints == (tuple(TIMES) if name.startswith("table") else ())
    for integrator in [Continuous(form="split"), Continuous(form="director")] + [Gauss(8)] * bool(load.potentials):
        times = {"t_end": 2, "step": 1 / 32} if integrator.name == "gauss" else {"times": [0, 2.0]}
        run = nt.simulate(FREE, load=load, integrator=integrator, **times, **START)
        assert abs(run.directors.values[-1] - directors).max() < 1e-9


def require_same(run, known, directors=1e-13, multipliers=1e-10):
    assert abs(run.directors - known.directors).max() < directors
    assert abs(run.multipliers - known.multipliers).max(initial=0) < multipliers


@pytest.mark.parametrize("body", [FREE, HELD, SLANTED], ids=["standard", "nontwisting", "suslov"])
def test_director_scheme_of_the_paper(body):
    names = ("table in space", "table along directors", "compiled")
    load = sum((FORCED[name][0]() for name in names), nt.moment(lambda t, d, w: np.cross(d[2], [0, 0, 2.0])))
    how = {"t_end": 0.1, "step": 0.02, "load": load, **START}
    run = nt.integrate(body, integrator="energy-momentum", **how)
    known = nt.integrate(body, integrator=ReferenceEnergyMomentum(), **how)
    require_same(run, known, multipliers=1e-10 * abs(known.multipliers).max())
    assert abs(run.moment - known.moment).max() < 1e-12
    assert abs(run.load_work - known.load_work).max() < 1e-13


@pytest.mark.parametrize("scheme", ["lie-midpoint", "energy-momentum"])
@pytest.mark.parametrize("body", [FREE, HELD])
def test_quadratic_potential_is_director_forces(body, scheme):
    """Its discrete gradient is that at the mean, so the multipliers λ are those of forces."""
    by_forces = nt.director_forces(lambda t, d, w: along(UP, np.array([1.0, 2, -1]) + Q @ (d @ UP)))
    loads = QUADRATIC, by_forces
    run, known = (nt.integrate(body, t_end=1, step=0.05, load=load, integrator=scheme, **START) for load in loads)
    require_same(run, known, 1e-12, 1e-9)


GYROSTATS = {f"{name}, rotor": POTENTIALS[name] + nt.rotor((1, 0, 0.5), 0.8) for name in ("quadratic", "linear")}
CASES = [*thinned(3, [FREE, HELD, SLANTED], POTENTIALS), *product([FREE], GYROSTATS)]


@pytest.mark.parametrize(("body", "name"), CASES)
def test_invariants_at_large_steps(body, name):
    for scheme, order in (("lie-midpoint", 2), ("energy-momentum", 2), (EXACT, None), ("gauss", 2), ("gauss", 6)):
        load = (POTENTIALS | GYROSTATS)[name]
        run = nt.simulate(body, t_end=20, step=0.1, load=load, integrator=scheme, order=order, **START)
        kept = {drift.symbol: drift.relative for drift in drifts(run).values()}
        energy, vertical = ("K+V−A", "(π+Λh)·g") if name in GYROSTATS else ("K+V", "π·g")
        if name not in ("function", "spring", "two") or scheme != "gauss":
            assert kept[energy] < 2e-13, scheme
        assert np.ptp(run.potential_energy.values) > 0.5
        assert (vertical in kept) == (body is FREE and name != "two")
        assert kept.get(vertical, 0) < 2e-13, scheme
        if name in GYROSTATS:
            assert np.ptp(run.spatial_momentum.values[:, 2]) > 0.1  # of the body alone it is not kept
        else:
            assert abs(run.load_work.values).max() == abs(run.moment.values).max() == 0


@pytest.mark.parametrize("wheel", [None, nt.rotor((0.6, 0, 0.8), 2), nt.rotor((0.6, 0, 0.8), [0, 1.5, 30], [0, 3, 1])])
def test_orbit_integral_with_wheels(wheel):
    """K + V - A - n o·(π + Λh), by gauss to round-off where no wheel turns; other loads and constraints leave none."""
    load = nt.gravity_gradient(0.7, (1, 1, 0), (0, 0, 2), 0.3) + (wheel or nt.Load())
    ways = ((4, 0.1), (4, 0.05), (12, 0.05)) if wheel else ((2, 0.25), (12, 0.25))
    runs = [nt.simulate(FREE, t_end=30, step=h, load=load, order=order, **START) for order, h in ways]
    found, run = [drifts(run)["jacobi_integral"] for run in runs], runs[-1]
    assert found[-1].relative < 1e-13
    assert np.ptp((run.kinetic_energy + run.potential_energy).values) > 0.1
    if not wheel:
        assert found[0].relative < 1e-13
        assert run.orthonormality_defect.max() < 1e-14
        return
    assert found[0].symbol == "K+V−A−n o·(π+Λh)"
    assert found[0].relative / found[1].relative == pytest.approx(16, rel=0.25)
    ellipse = nt.gravity_gradient(0.7, eccentricity=0.2)
    for other in (load + nt.pulse((0, 1, 0), end=1), load + POTENTIALS["spring"], ellipse):
        assert "jacobi_integral" not in drifts(nt.simulate(FREE, t_end=1, step=0.1, load=other, **START))


def test_large_steps_on_orbits():
    load, start = nt.gravity_gradient(0.5), {"material_angular_velocity": (0.2, 0.1, 3.0)}
    run = nt.simulate(FREE, t_end=30, step=0.6, load=load, order=8, **start)
    fine = nt.simulate(FREE, t_end=30, step=0.1, load=load, order=12, **start)
    assert drifts(run)["jacobi_integral"].relative < 1e-12
    assert abs(run.directors.values[-1] - fine.directors.values[-1]).max() < 1e-2


@pytest.mark.parametrize("scheme", ["lie-midpoint", "energy-momentum", "gauss", "split", "continuous"])
def test_good_states_are_kept(scheme):
    broken = nt.potential((0, 0, 1.0), lambda g: g[2] + 1e9, lambda g: np.array([0, 0, 1.0]))  # a constant
    vars(broken.terms[0])["potential"] = lambda g: float("nan") if g[2] < -0.3 else float(g[2])
    start = {"rotation": Rotation.from_euler("x", 1.2), "material_angular_velocity": (1, 0, 0.5)}
    with pytest.raises(SimulationError, match="the potential <lambda> is not finite at γ = ") as caught:
        nt.simulate(FREE, t_end=5, step=0.05, load=POTENTIALS["function"] + broken, integrator=scheme, **start)
    if scheme != "continuous":
        assert len(caught.value.partial.time) > 2


def test_gradient_is_checked():
    seen = []
    nt.potential((0, 0, 1), well, lambda g: seen.append(np.linalg.norm(g)) or slope(g))
    assert seen == pytest.approx(np.ones(5))


test_refusals = refused_as(
    [
        lambda: nt.potential((0, 0, 1), well, lambda g: 2 * slope(g)),
        lambda: nt.potential((0, 0, 1), lambda g: np.nan, slope),
        lambda: nt.potential((0, 0, 1), well),
        lambda: nt.potential(np.ones((5, 3)), linear=np.ones((5, 3))),
        lambda: nt.gravity_gradient(1, normal=(1, 0, 1)),
        lambda: nt.gravity_gradient(1.0, start=1.0, eccentricity=0.1, perigee_time=2.0),
        lambda: nt.gravity_gradient(1.0, eccentricity=1.0),
        lambda: nt.director_forces([0, 1]),
        lambda: EnergyMomentum(moments="other"),
        lambda: nt.simulate(FREE, t_end=1, step=0.1, load=nt.director_forces(lambda t, d, w: (1, 2, 3))),
        lambda: nt.simulate(FREE, t_end=1, load=QUADRATIC, integrator="exact"),
        lambda: nt.simulate_ensemble(FREE, t_end=1, step=0.1, load=nt.gravity_gradient(0.4), reduce="drift"),
        lambda: nt.potential((0, 0, 1), well, linear=(1, 2, 3)),
    ],
    kind=(ValueError, SimulationError),
)


def test_records_make_the_load_again():
    load = sum((POTENTIALS["spring"], nt.gravity_gradient(0.3, start=2), nt.director_forces(TIMES, FORCES)), QUADRATIC)
    assert load_of(json.loads(json.dumps(load.description))) == load
    with says():
        load_of(nt.potential((0, 0, 1.0), well, slope).description)


@pytest.mark.parametrize(("integrator", "order", "bound"), [("lie-midpoint", 2, 2e-3), ("gauss", 8, 1e-11)])
def test_prescribed_spin(integrator, order, bound):
    load = POTENTIALS["spring"] + nt.director_forces(TIMES, FORCES, frame="body") + nt.rotor((0, 0, 1), 0.5)
    how = {"load": load, "rotation": START["rotation"], "material_angular_velocity": (1, 2, 0)}
    body = nt.nontwisting([3, 4, 5], spin=0.7)
    known = nt.simulate(body, times=[0, 1, 2.0], integrator=Continuous(form="split"), **how)
    run = nt.simulate(body, t_end=2, step=0.02, store=50, integrator=integrator, order=order, **how)
    assert abs(run.directors.values - known.directors.values).max() < bound


@pytest.mark.parametrize("integrator", ["lie-midpoint", "energy-momentum", "gauss", "split"])
def test_unknown_constraint_moment(integrator):
    start = START | {"material_angular_velocity": (1, 2, 0)}
    load, how = nt.dipole((1, 2, -3), (0, 0, 2)), {"t_end": 1, "step": 1 / 64, "integrator": integrator, **start}
    assert "spatial_reaction_moment" not in nt.simulate(HELD, load=QUADRATIC, **how)
    split = Continuous(form="split")
    assert "spatial_reaction_moment" not in nt.simulate(HELD, times=[0, 1.0], load=load, integrator=split, **start)
    run = nt.simulate(HELD, load=load, **how)
    d3 = (run.directors.values[1:, 2] + run.directors.values[:-1, 2]) / 2
    assert abs(run.spatial_reaction_moment.values - run.reaction_moment.values[:, None] * d3).max() < 0.05


@pytest.mark.parametrize(
    ("name", "order"),
    [("gauss", 8), pytest.param("gauss", 16, marks=pytest.mark.long), ("lie-midpoint", 2), ("energy-momentum", 2)],
)
@pytest.mark.parametrize("kind", [nt.standard, nt.nontwisting])
def test_springs_and_drag_to_rest(name, order, kind):
    """The moments cancel up to their round-off, which no iteration can undercut: the run is completed all the same."""
    for seed in (1, 2, 3):
        rng = np.random.default_rng(seed)
        J, p = rng.uniform(2, 4, 3), rng.normal(size=3)
        anchor = Rotation.random(random_state=seed).apply(3 * p)
        load = nt.spring(300.0, p, anchor, rest_length=np.linalg.norm(p)) + nt.damping(4.0)
        run = nt.simulate(kind(J), t_end=60, step=0.02, load=load, store="end", integrator=name, order=order)
        end = nt.rotation(run)[-1]
        torque = end.inv().apply(np.cross(end.apply(p), anchor)) / np.linalg.norm(p) / np.linalg.norm(anchor)
        assert abs(torque[: 2 if kind is nt.nontwisting else 3]).max() < 1e-13, seed

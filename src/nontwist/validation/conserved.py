"""Validation of what integrators conserve.

**invariants**: Invariants and exact balances of the stepping integrators, as their module docstrings derive them.

Random bodies have Euler inertias A Aᵀ + 0.3 I; A and all other numbers are normally distributed. Errors are relative to
the largest value. Without load `split` takes no steps; in the long runs a load of 1e-200 N m therefore acts on it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .. import loads
from ..analysis import variables as obs
from ..driver.runs import integrate
from ..geometry.arrays import Array
from ..integrators import INTEGRATORS, EnergyMomentum, Gauss
from ..loads import Load, Term
from ..models.bodies import heavy_top, nontwisting, sample_bodies, standard
from ..models.system import DirectorSystem
from .checks import Check
from .problems import (
    FULL_J,
    PAPER_J,
    SAMPLES,
    SCHEMES,
    Arguments,
    drift,
    energy,
    error,
    momentum,
    random_body,
    random_kinds,
    random_start,
    velocity,
)

ALL = [(name, k) for name in ("gauss", "lie-midpoint", "energy-momentum") for k in INTEGRATORS[name].orders]
UNIT, DISCRETE, RED = "eq_internal_constraint", "eq-discrete-nonholonomic", "eq-nonholonomic-red"
BODIES_OF_EACH_KIND, ROUND_OFF = 20, 1e-12
EXACT_MOMENTS = "nontwist.integrators.energy_momentum"
FORCES = np.array([[1.0, -0.5, 0.3], [0.2, 0.7, -1.0], [-0.4, 0.6, 0.1]])


def claims() -> dict[str, str]:
    """Return the integrators that claim the invariants checked here, with their sources."""
    return {name: cls.sources["invariant"] for name, cls in INTEGRATORS.items() if "invariant" in cls.sources}


def random_bodies() -> Iterator[Check]:
    """March twenty bodies of every kind over 200 free steps of 0.005 s, the last kind under gravity."""
    for scheme, k in ALL:
        rng = np.random.default_rng(6)
        drifts: dict[str, list[float]] = {"energy": [], "π": [], "Π_⊥": [], "q": []}
        for kind, heavy in random_kinds().values():
            for _ in range(BODIES_OF_EACH_KIND):
                body, start = random_body(kind, heavy, rng), random_start(rng)
                run = integrate(body, t_end=1, step=0.005, integrator=scheme, order=k, **start)
                kinetic, total = obs.kinetic_energy(run.director_velocities, body.euler_inertia), energy(run)
                drifts["energy"].append(float(abs(total - total[0]).max() / kinetic.max()))
                drifts["q"].append(float(obs.orthonormality_defect(run.directors).max()))
                if kind == "standard":
                    drifts["π"].append(drift(momentum(run)))
                if kind == "nontwisting":
                    drifts["Π_⊥"].append(drift(obs.material(run.directors, momentum(run))[:, :2]))
        source, bodies = claims()[scheme], f"{len(drifts['q'])} bodies"
        yield error(f"{scheme} {k}: energy, {bodies}", drifts["energy"], ROUND_OFF, source, "invariant")
        yield error(f"{scheme} {k}: momentum π, 20 standard bodies", drifts["π"], ROUND_OFF, source, "invariant")
        yield error(f"{scheme} {k}: Π1, Π2, 20 non-twisting bodies", drifts["Π_⊥"], ROUND_OFF, source, "invariant")
        yield error(f"{scheme} {k}: orthonormality, {bodies}", drifts["q"], 1e-13, UNIT, "invariant")


AXIS = np.array([0.6, 0.0, 0.8])


def friction(t: float, h: Array, directors: Array, W: Array) -> Array:
    """Return the moment on a wheel of axial inertia 0.05 kg m²: that of its motor, and of friction."""
    return 0.3 * np.sin(1.7 * t) - 0.2 * (h / 0.05 - AXIS @ W)


def reaction(t: float, h: Array, directors: Array, W: Array) -> Array:
    """Return the moment of the wheel on the body, along the directors."""
    return h[0] * np.cross(AXIS, W) - friction(t, h, directors, W)[0] * AXIS


OF_TERMS: dict[str, Load] = {  # a load of every entry of nontwist.loads.LOADS in the package
    "pulse": loads.pulse([0, 1, -2], 0, 0.2),
    "sine": loads.sine([1, 2, 0], 0.7),
    "table": loads.space_moment([0, 2], [[1, 0, 1], [0, 1, 1]]),
    "function": loads.body_moment(lambda t: (t, 0, 1)),
    "damping": loads.damping([0.1, 0.2, 0.3]),
    "rotor": loads.rotor((1, 2, 0), [0.1, 0.3], [1.0, 2.5]),
    "dry_friction": loads.dry_friction(2.0),
    "wheel": loads.wheel((1, 2, 0), 0.5, speed=3, torque=([0, 1, 2], [0.5, -1, 0.2])),
    "director_forces": loads.director_forces([0, 2], [FORCES, -FORCES]),
    "function of director forces": loads.director_forces(lambda t, d, w: FORCES * t + d, frame="body"),
    "potential": loads.potential(
        [1, 0, 2], linear=[0.3, 1, -1], quadratic=np.array([[1, 0.5, 0], [0.5, -2, 0], [0, 0, 3]])
    ),
    "spring": loads.spring(4, point=[0.2, 0.5, 1], anchor=[1, 1, 0.5], rest_length=0.7),
    "gravity_gradient": loads.gravity_gradient(0.8),
    "function of a potential": loads.potential(
        [0, 0, 1], lambda g: float(np.cos(g[0]) + g[2] ** 4), lambda g: np.array([-np.sin(g[0]), 0, 4 * g[2] ** 3])
    ),
    "memory": loads.memory_load(friction, reaction, 0.4, frame="body"),
}
# K + V changes with time on an orbit; wheels are not stretched with the directors; dry friction splits steps.
APART = ("gravity_gradient", "wheel", "dry_friction")


BALANCE: Arguments = {"t_end": 0.4, "step": 0.01, "angular_velocity": (1, -2, 0.5), "project": True}


def balances() -> Iterator[Check]:
    """Compare changes of energy and momentum with work and impulse of the loads, step by step."""
    load = sum((OF_TERMS[name] for name in OF_TERMS if name not in APART), Load())
    yield from work_of(load, "the load")
    for name, cls in own_terms().items():
        if (term := cls.sample()) is not None:
            yield from work_of(Load((term,)), f"the load {name!r}")
    how: Arguments = BALANCE | {"load": load.without_potentials}
    run = integrate(SAMPLES["standard"], integrator="lie-midpoint", order=2, **how)
    impulse = (np.diff(momentum(run), axis=0) - 0.01 * run.moment) / abs(momentum(run)).max()
    yield error("lie-midpoint: π changes by h m", impulse, ROUND_OFF, claims()["lie-midpoint"], "invariant")
    m, M = np.array([1.0, 2, -1]), np.array([1.0, -2, 0.7])
    run = integrate(
        SAMPLES["standard"], integrator="energy-momentum", **how | {"load": loads.space_moment(lambda t: m)}
    )
    mean = (run.directors[1:] + run.directors[:-1]) / 2
    C = np.swapaxes(mean, 1, 2) @ mean
    impulse = np.diff(momentum(run), axis=0) - 0.005 * (np.trace(C, axis1=1, axis2=2)[:, None] * m - C @ m)
    impulse /= abs(momentum(run)).max()
    yield error("energy-momentum: π changes by h/2 (tr C - C) m", impulse, ROUND_OFF, DISCRETE, "invariant")
    exact = EnergyMomentum(moments="exact")
    run = integrate(SAMPLES["standard"], **how | {"integrator": exact, "load": loads.space_moment(lambda t: m)})
    impulse = (np.diff(momentum(run), axis=0) - 0.01 * m) / abs(momentum(run)).max()
    yield error("energy-momentum, exact moments: π changes by h m", impulse, ROUND_OFF, EXACT_MOMENTS, "invariant")
    turning = how | {"angular_velocity": (1, -2, 0), "load": loads.body_moment(lambda t: M * t)}
    run = integrate(SAMPLES["nontwisting"], integrator="lie-midpoint", order=2, **turning)
    middle = (run.time[1:] + run.time[:-1]) / 2
    change = np.diff(obs.material(run.directors, momentum(run)), axis=0) - 0.01 * np.outer(middle, M * [1, 1, 0])
    yield error("lie-midpoint: Π_⊥ changes by h M_⊥", change / abs(momentum(run)).max(), ROUND_OFF, RED, "invariant")


def work_of(load: Load, words: str) -> Iterator[Check]:
    """Compare the changes of energy of a body of every kind with the work of a load."""
    for scheme in ("lie-midpoint", "energy-momentum"):
        work = []
        for body in sample_bodies().values():
            run = integrate(body, integrator=scheme, order=2, load=load, **BALANCE)
            work.append((np.diff(energy(run)) - run.load_work) / abs(energy(run)).max())
        name = f"{scheme}: K + V changes by the work of {words}"
        yield error(name, work, ROUND_OFF, claims()[scheme], "invariant")


def own_terms() -> dict[str, type[Term]]:
    """Return the classes of terms that modules outside the package have added."""
    return {name: cls for name, cls in loads.LOADS.items() if name not in OF_TERMS}


def unchecked() -> list[str]:
    """Return a sentence for every term that `balances` leaves out."""
    return [
        f"the load {name!r} is not checked: add a classmethod sample to its class {cls.__name__}, "
        "which returns a term to check"
        for name, cls in own_terms().items()
        if cls.sample() is None
    ]


def exchange() -> Iterator[Check]:
    """March a body with a wheel, whose momentum is an internal state of the load, over 10⁴ steps of 0.1 s."""
    wheel, drifts = loads.memory_load(friction, reaction, 0.4, frame="body", compiled=True), list[float]()
    how: Arguments = {"t_end": 1e3, "step": 0.1, "material_angular_velocity": (1, -2, 3), "load": wheel}
    for order in Gauss.orders:
        run = integrate(SAMPLES["standard"], integrator=Gauss(order), **how)
        assert run.states.internal is not None
        total = momentum(run) + np.einsum("nk,nkx->nx", run.states.internal * AXIS, run.directors)
        drifts += [drift(total), unbalanced(energy(run), run.load_work)]
    name = "gauss, wheel with friction, 10⁴ steps: momentum of both, energy less work"
    yield error(name, drifts, ROUND_OFF, claims()["gauss"], "invariant")


def constraints() -> Iterator[Check]:
    """Measure the twist rate, and the part of velocities that is not tangent, at the nodes under load."""
    load = loads.sine([5, 3, 1], 2, frame="space")
    how: Arguments = {"t_end": 2, "step": 0.01, "angular_velocity": (1, -2, 0), "load": load, "project": True}
    for scheme in ("lie-midpoint", "split"):
        rate = velocity(integrate(SAMPLES["nontwisting"], integrator=scheme, **how))[:, 2]
        yield error(f"{scheme}: twist rate at the nodes, rad/s", rate, 1e-13, "eq-non-twisting", "invariant")
    run = integrate(SAMPLES["suslov"], integrator="lie-midpoint", **how)
    g = run.director_velocities @ np.swapaxes(run.directors, 1, 2)
    normal = g + np.swapaxes(g, 1, 2)
    yield error("lie-midpoint: d_i·d_j' + d_j·d_i' at the nodes, 1/s", normal, 1e-13, UNIT, "invariant")


LONG: dict[str, tuple[DirectorSystem, tuple[float, float, float], str]] = {
    "free non-twisting body": (nontwisting(PAPER_J), (6, -18, 0), "Π1, Π2"),
    "free standard body": (standard(PAPER_J), (6, -18, 1), "π"),
    "heavy top": (heavy_top(PAPER_J, 2, (0.1, 0.2, 0.5)), (1, -2, 6), "π·e3"),
}


def million_steps() -> Iterator[Check]:
    """March a million steps of 0.005 s."""
    for motion, (body, W, kept) in LONG.items():
        how: Arguments = {"t_end": 5000, "step": 0.005, "store": 1000, "material_angular_velocity": W}
        split = [] if body.dead_force.any() else [("split", 2), ("split", 4)]
        for scheme, k in (*SCHEMES, *split):
            load = loads.sine([1e-200, 0, 0], 0.7) if scheme == "split" else None
            run = integrate(body, integrator=scheme, order=k, load=load, **how)
            pi = momentum(run)
            conserved = {"π": pi, "Π1, Π2": obs.material(run.directors, pi)[:, :2], "π·e3": pi[:, 2:]}[kept]
            defect = float(obs.orthonormality_defect(run.directors).max())
            drifts = [drift(energy(run)), drift(conserved), defect]
            title = f"{motion}, {scheme} {k}, 10⁶ steps: energy, {kept}, orthonormality"
            yield error(title, drifts, ROUND_OFF, claims()[scheme], "invariant")


FORCED: dict[str, tuple[DirectorSystem, tuple[float, float, float]]] = {
    "standard body": (standard(FULL_J), (1, -2, 3)),
    "non-twisting body": (nontwisting(PAPER_J), (1, -2, 0)),
}
LOADS: dict[str, Load] = {
    "a load that never ends": loads.sine([1, 2, 0.5], 0.7),
    "a load that ends": loads.pulse([1, 2, 0.5], 10, 210),
}


def forced() -> Iterator[Check]:
    """March 10⁵ steps of 0.005 s with every order, and compare energy and momentum with work and impulse."""
    for name, load in LOADS.items():
        for motion, (body, W) in FORCED.items():
            how: Arguments = {"t_end": 500, "step": 0.005, "store": 100, "material_angular_velocity": W, "load": load}
            for scheme, source in claims().items():
                balanced = motion == "standard body" and scheme != "energy-momentum"
                drifts = []
                for k in INTEGRATORS[scheme].orders:
                    run = integrate(body, integrator=scheme, order=k, **how)
                    drifts.append(unbalanced(energy(run), run.load_work))
                    drifts.append(float(obs.orthonormality_defect(run.directors).max()))
                    if balanced:
                        drifts.append(unbalanced(momentum(run), np.diff(run.time)[:, None] * run.moment))
                kept = "energy less work, orthonormality" + (", π less impulse" if balanced else "")
                title = f"{motion}, {name}, {scheme}, 10⁵ steps: {kept}"
                yield error(title, drifts, ROUND_OFF, source, "invariant")


def unbalanced(values: Array, supplied: Array) -> float:
    """Return the difference of the changes of `values` since the start from the sums of `supplied`, relative."""
    gained = values[1:] - values[0]
    return float(abs(gained - np.cumsum(supplied, axis=0)).max() / abs(values).max())


CHECKS = {"invariants": (random_bodies, balances, exchange, constraints, million_steps, forced)}

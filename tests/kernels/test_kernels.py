"""The compiled schemes against their references in NumPy, their failures, and how they are compiled."""

import subprocess
import sys
from functools import cache
from itertools import product

import numpy as np
import pytest

import nontwist as nt
from conftest import compiled_load
from nontwist.driver import starts
from nontwist.errors import SimulationError, Status
from nontwist.geometry import rotations
from nontwist.integrators import INTEGRATORS, Gauss, stack_march
from nontwist.validation.compiled_steps import ReferenceEnergyMomentum, ReferenceLieMidpoint, random_load
from nontwist.validation.orders import swing
from nontwist.validation.problems import random_body, random_kinds, random_start
from refusals import says

EPS = np.finfo(float).eps
KINDS = random_kinds()


def also(t, d, w):
    return (0.3 * w[1], d[0, 2], 0.0)


def random_problem(kind, seed, compiled=None):
    """A random body, start and load: moments in the body and in space, damping; functions of the state if asked for."""
    rng = np.random.default_rng(seed)
    body, start, load = random_body(*KINDS[kind], rng), random_start(rng), random_load(rng)
    load = load + nt.damping(rng.uniform(0, 0.3, size=3))
    if compiled is not None:
        one, other = (compiled_load(g) if compiled else nt.moment(g) for g in (swing, also))
        load = load + 2 * one - 0.5 * other
    return body, start | {"load": load}


def assert_same_run(one, other, h):
    speed = abs(other.director_velocities).max()
    assert one.directors == pytest.approx(other.directors, abs=1e-11)
    assert one.director_velocities == pytest.approx(other.director_velocities, abs=1e-11 * max(1, speed))
    force = abs(other.multipliers)
    fastest = np.linalg.norm(other.director_velocities, axis=(1, 2)).max()
    noise = 1e-11 * np.maximum(1, force) + 10 * EPS * np.linalg.norm(one.system.euler_inertia) * fastest / h
    assert (abs(one.multipliers - other.multipliers) <= noise).all()
    assert one.moment == pytest.approx(other.moment, abs=1e-11)
    assert one.load_work == pytest.approx(other.load_work, abs=1e-12)


REFERENCES = {"energy-momentum": ReferenceEnergyMomentum(), "lie-midpoint": ReferenceLieMidpoint()}
SEEDS = [(77, True), *(pytest.param(seed, None, marks=pytest.mark.long) for seed in range(15))]


@pytest.mark.parametrize(("seed", "compiled"), SEEDS)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("scheme", REFERENCES)
def test_parity(scheme, kind, seed, compiled):
    """At small steps, and at 0.5 to 1.5 rad a step, where every term of the Newton matrices counts."""
    for t_end, step, most in ((0.1, 0.005, 4), (4.5, 0.3, 8)):
        how = {"t_end": t_end, "step": step}
        (body, one), (_, other) = (random_problem(kind, seed, how) for how in (compiled, compiled and False))
        kick = {"angular_velocity": [1, -2, 1.5]} if step > 0.1 else {}
        run = nt.integrate(body, integrator=scheme, order=2, **how, **one | kick)
        assert_same_run(run, nt.integrate(body, integrator=REFERENCES[scheme], **how, **other | kick), step)
        assert run.newton_iterations.max() <= most


def root(t, d, w):
    return 0.0, np.sqrt(0.5 - t), 1.0


def infinite(t, d, w):
    return 0.0, np.where(t > 0.5, -np.inf, 0.0), 1.0


@pytest.mark.parametrize("function", [root, infinite])
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_failing_compiled_load(function):
    with says(SimulationError) as info:
        nt.integrate(nt.standard([1, 1, 1]), t_end=1, step=0.1, order=2, load=nt.moment(function, compiled=True))
    assert info.value.status == Status.LOAD
    assert info.value.time == pytest.approx(0.5)
    assert info.value.partial.time == pytest.approx([0, 0.1, 0.2, 0.3, 0.4, 0.5])


def test_step_turns_too_far():
    how = {"integrator": "lie-midpoint", "t_end": 4}
    nt.integrate(nt.standard([1, 1, 1]), step=1, angular_velocity=[0, 0, 3.1], **how)
    with pytest.raises(SimulationError, match=r"step 0 .* turns 3.2 rad in one step; try step <= 0.2") as info:
        nt.integrate(nt.standard([1, 1, 1]), step=1, angular_velocity=[0, 0, 3.2], **how)
    assert info.value.status == Status.TURN


def needles():
    """Integrators, needles and their starts, ends, steps, and how far energy and momentum may be off."""
    rng = np.random.default_rng(3)
    R, thin = rotations.exp(rng.normal(size=3)), np.diag([rng.uniform(0.1, 1) * 1e-12, 1e-12, 1.0])
    W, many = rng.normal(size=(2, 3)), rng.uniform(-0.7, 0.7, (40, 3)) * (1e-3, 1, 1)
    # Off its principal axes a last increment of 1e-7 is solved for with a relative error of condition times round-off.
    for E, bound in ((thin, 1e-12), (R @ thin @ R.T, 1e-10)):
        yield "lie-midpoint", nt.standard(np.trace(E) * np.eye(3) - E), W, 1, 0.01, 1e-12
        yield "energy-momentum", nt.standard(np.trace(E) * np.eye(3) - E), W, 1, 0.01, bound
    yield "lie-midpoint", nt.standard([1e-8, 1, 1 + 5e-9]), many, 40, 1, 1e-14
    yield "lie-midpoint", nt.standard(nt.inertia.of_cuboid(1, (4, 1e-3, 1e-3))), [(2, 0, 2)], 50, 0.25, 1e-13
    for order in Gauss.orders:
        needle, W = [1, 1e-7, 1 + 5e-8], [(0.3, 0.2, 2.0)]
        yield Gauss(order), nt.standard(needle), W, 60, 0.3, 5e-15
        linear = order <= 4  # Newton's iteration converges linearly, from the round-off of the spin
        yield Gauss(order), nt.heavy_top(needle, 0.3, (0, 1, 0)), W, 30, 0.3, 1e-10 if linear else 1e-12
    J = [[0.03435839, -0.03935332, 0], [-0.03935332, 0.045074451, 0], [0, 0, 0.07943284]]
    yield "split", nt.nontwisting(J), [(0, -0.017, 0)], 1, 0.1, 4e-15


@pytest.mark.filterwarnings("error", "ignore:the step")
@pytest.mark.parametrize(
    ("name", "body", "W", "t_end", "step", "bound"),
    [pytest.param(*one, marks=[pytest.mark.long] * (one[0] in (Gauss(8), Gauss(12)))) for one in needles()],
)
def test_needles_keep_invariants(name, body, W, t_end, step, bound):
    """Where the spin is the round-off of all P, or fills the first increment of Newton's iteration; none stalls."""
    how = {"t_end": t_end, "step": step, "store": 1, "variables": "all", "integrator": name}
    run = nt.simulate_ensemble(body, material_angular_velocity=W, **how)
    assert not run.status.any()
    E = (run.kinetic_energy + run.potential_energy).values[..., None]
    for kept in (E, run.spatial_momentum.values) if body.axis is None and not body.dead_force.any() else (E,):
        size = np.linalg.norm(kept, axis=2).max(axis=1)
        assert (abs(kept - kept[:, :1]).max(axis=(1, 2)) <= bound * size).all()


@cache
def drags(m, c):
    return lambda t, d, w: (m - c * abs(w[0]) * w[0], -c * abs(w[1]) * w[1], -c * abs(w[2]) * w[2])


SLOW = [(speed, 0.0, 0.2 / speed) for speed in (1e-30, 1e-6)]
STRONG = [(start, m, c) for start, m in ((1.0, 0.0), (0.0, 2.0)) for c in (1.0, 1e3, 1e6)]


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize(
    ("name", "body"), [*product(REFERENCES, [nt.nontwisting]), *product(["split"], [nt.nontwisting, nt.standard])]
)
@pytest.mark.filterwarnings("error", "ignore::UserWarning")
def test_drag_in_split_converges(name, body, compiled):
    """J (W1 - W0) = h (m - c |Wm| Wm) about a principal axis has one solution."""
    J, h = 3.0, 0.5
    for start, m, c in SLOW + STRONG * (name == "split"):
        load = (compiled_load if compiled else nt.moment)(drags(m, c))
        how = {"t_end": 5 * h, "step": h, "order": 2, "integrator": name, "material_angular_velocity": (start, 0, 0)}
        run, W = nt.simulate(body([J, 4, 5]), load=load, **how), [start]
        for _ in range(5):
            R = h * m + 2 * J * W[-1]
            W += [2 * R / (J + np.sqrt(J * J + h * c * abs(R))) - W[-1]]
        found, size = run.material_angular_velocity.values[:, 0], start or 1
        assert found / size == pytest.approx(np.array(W) / size, rel=1e-12)
        work, K = run.load_work.values / size**2, run.kinetic_energy.values / size**2
        assert np.diff(K) == pytest.approx(work, rel=1e-11, abs=1e-14)


def wild(t, d, w):
    return np.sin(1e9 * w[0]), np.sin(1e9 * w[1]), np.sin(1e9 * w[2] + 1)


@pytest.mark.parametrize("scheme", ["energy-momentum", "lie-midpoint", "gauss"])
def test_stalls_and_broken_attitudes(scheme, monkeypatch):
    how = {"t_end": 1, "step": 0.1, "angular_velocity": [1, 2, 3], "integrator": scheme}
    with pytest.raises(SimulationError, match="Newton's iteration stalled at a residual of") as info:
        nt.integrate(nt.standard([1, 1, 1]), load=50 * compiled_load(wild), **how)
    assert info.value.status == Status.STALLED
    assert info.value.residual > 0
    monkeypatch.setattr(starts, "last_attitude", lambda *rotation: np.array([[0, 0, 0, 1 + 1e-8]]))
    if scheme != "gauss":
        with pytest.raises(SimulationError, match=r"step 0 .* the directors are no longer orthonormal") as info:
            nt.integrate(nt.standard([1, 1, 1]), **how)
        assert info.value.status == Status.BROKEN


def test_load_fails_in_later_block(monkeypatch):
    monkeypatch.setattr(stack_march, "NODES", 4)
    load = nt.space_moment(lambda t: (0, 0, 1 / (t < 0.5)))
    with pytest.raises(SimulationError, match=r"raised ZeroDivisionError at t = 0.55 s") as info:
        nt.integrate(nt.standard([1, 1, 1]), t_end=1, step=0.1, order=2, load=load)
    assert info.value.partial.time == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])


WITHOUT_WHAT_IS_SLOW = """
import sys, nontwist as nt
SLOW = "xarray pandas h5py scipy matplotlib rich typer pydantic"
def tell(run): print(run, *(m for m in SLOW.split() if m in sys.modules))
body, W, how = nt.nontwisting([3, 4, 5]), (1, 2, 0), dict(t_end=1, step=0.1)
nt.integrators.INTEGRATORS, nt.damping(1.0); tell("names")
nt.curves.closed_frame([(1, 0, 0), (0, 1, 0), (0, 0, 1)]); tell("frames")
nt.stepper(body, 0.1).reset(material_angular_velocity=W); tell("stepper")
nt.propagator(body, **how)(material_angular_velocity=W); tell("propagator")
for name in nt.integrators.INTEGRATORS:
    if name != "continuous": nt.integrate(body, material_angular_velocity=W, integrator=name, **how); tell("integrate")
"""


def test_late_imports():
    done = subprocess.run([sys.executable, "-c", WITHOUT_WHAT_IS_SLOW], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    assert done.stdout.split() == ["names", "frames", "stepper", "propagator", *["integrate"] * (len(INTEGRATORS) - 1)]

"""Valid values for every parameter of a public function: by its name, else by its docstring and its annotation."""

import ast
import re
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import nontwist as nt

N = 6  # entries along every axis that a docstring names by a letter
TIMES = np.linspace(0, 1, N)
WAY = np.stack([0.6 * np.cos(3 * TIMES), 0.6 * np.sin(3 * TIMES), np.full(N, 0.8)], axis=1)
TETRAHEDRON = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
SWEEP = """
body = { kind = "nontwisting", inertia = [3, 4, 5] }
start.angular_velocity.body = [0, 1, 0]
time = { t_end = 1, step = 0.1 }
sweep.over = [{ key = "start.angular_velocity.body.1", kind = "grid", start = 1, end = 4, count = 4 }]
sweep.variables = ["kinetic_energy"]
"""


def same(names, draw):
    """One way to draw for several parameters."""
    return dict.fromkeys(names.split(), draw)


def one_of(*choices):
    """A value for a parameter: one of `choices`; what is callable and takes (r, given) is called."""
    return lambda r, given: choices[r.integers(len(choices))]


def made(*makers):
    return lambda r, given: makers[r.integers(len(makers))](r)


def number(low, high):
    return lambda r, given: float(r.uniform(low, high))


def unit(r, shape=()):
    d = r.normal(size=(*shape, 3))
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


def units(r, given):
    return unit(r, next((np.shape(given[name])[:-1] for name in ("d0", "d", "d3") if name in given), (N,)))


def tangents(r, given):
    d = next(given[name] for name in ("d0", "d", "d3") if name in given)
    v = r.normal(size=np.shape(d))
    return v - np.sum(v * d, axis=-1, keepdims=True) * d


def unless_started(draw):
    """What `start` brings must not be given."""
    return lambda r, given: None if given.get("start") is not None else draw(r, given)


def path(r, given):
    return Rotation.random(rng=r).apply(WAY)


def frames(r, given):
    return Rotation.random(N, rng=r).as_matrix()


def skew(r, given):
    a = r.normal(size=(N, 3, 3))
    return a - a.mT


def symmetric(r, given):
    """An inertia with D3 principal, so that every body takes it."""
    J = np.diag(r.uniform([1.0, 1.2, 1.4], [1.1, 1.3, 1.6]))
    J[0, 1] = J[1, 0] = r.uniform(-0.05, 0.05)
    return J if r.random() < 0.7 else np.sort(J.diagonal())


def matrix(r, given):
    J = symmetric(r, given)
    return J if J.ndim == 2 else np.diag(J)


def euler(r, given):
    return nt.inertia.euler_inertia(symmetric(r, given))


def top(r, given):
    A = r.uniform(1, 1.1)
    return np.array([A, A, r.uniform(0.5, 1.5)])


def planar(r, given):
    return np.append(r.uniform(0.2, 1.0, 2), 0.0)


def times(r, given):
    return np.sort(r.uniform(0.1, 0.9, N)) if r.random() < 0.5 else TIMES


def axis(r, given):
    return "z" if r.random() < 0.2 else (0, 0, float(r.uniform(0.5, 2)))


def bodies(r):
    J = symmetric(r, {})
    kinds = (nt.standard, nt.nontwisting, lambda J: nt.suslov(J, (0, 0, 1)))
    body = kinds[r.integers(3)](J)
    return body if r.random() < 0.7 else nt.with_gravity(body, 0.1, (0, 0, 0.1))


def steady_load(r, given):
    """A load that leaves the axis of rotation where it is."""
    J = nt.inertia.convected_inertia(nt.inertia.euler_inertia(given["inertia"]))
    return nt.pulse(J @ given["material_angular_velocity"] * r.uniform(0.1, 1))


def loads(r):
    amplitude = r.uniform(-1, 1, 2)
    push = nt.pulse((*amplitude, 0), end=0.5, shape=("triangle", "rectangle", "half-sine")[r.integers(3)])
    return push if r.random() < 0.6 else push + nt.sine((0.1, 0, 0), 1.0)


def attitudes(r):
    R = Rotation.random(rng=r)
    return R if r.random() < 0.5 else R.as_matrix()


@cache
def run(kind="nontwisting", step=0.1, load=False):
    body = getattr(nt, kind)([3, 4, 5])
    how = {"material_angular_velocity": (0.3, 0.5, 0), "load": nt.pulse((1, 0, 0)) if load else None}
    return nt.simulate(body, t_end=1, step=step, integrator="energy-momentum", **how)


@cache
def trajectory():
    return nt.integrate(nt.standard([3, 4, 5]), t_end=1, step=0.1, material_angular_velocity=(0.3, 0.5, 0.1))


@cache
def quotients():
    return nt.comparison.second_quotient(run(step=0.1), run(step=0.05), run(step=0.025))


@cache
def compared():
    how = {"material_angular_velocity": (0.5, 2, 0.1), "steps": [0.1, 0.05], "repeats": 1}
    return nt.compare(nt.standard([3, 4, 5]), t_end=1, integrators=["lie-midpoint", "split"], **how)


@cache
def ensemble():
    return nt.simulate_ensemble(nt.standard([3, 4, 5]), t_end=1, step=0.1, material_angular_velocity=np.eye(3))


def runs(r, given):
    choices = run(), run("standard"), run("standard", load=True)
    one = choices[r.integers(3)]
    return one if r.random() < 0.6 else {"a": one, "b": one}


def constrained(r, given):
    return run() if r.random() < 0.5 else {"a": run(load=True), "b": run()}


def motion(r, given):
    return (run(), trajectory(), Rotation.from_rotvec(np.outer(TIMES, unit(r))), run().directors)[r.integers(4)]


def sampled(r, given):
    turn = Rotation.random(rng=r) * Rotation.from_rotvec(np.outer(TIMES, unit(r)))
    return turn if r.random() < 0.5 else turn.as_matrix()


def spinning(d):
    return -d[1], d[0], 0.0


def across(r, given):
    """A vector that is tangent at the director of the axis."""
    body, v = given["system"], r.normal(size=3)
    d = (np.eye(3)[2] if body.axis is None else body.axis) @ np.asarray(given["directors"])
    return v - (d @ v)[..., None] * d


def circling(t):
    return 0.6 * np.cos(t), 0.6 * np.sin(t), 0.8


def spring(t, directors, angular_velocity):
    x, y, _ = directors[2]
    return 2 * y, -2 * x, 0.0


def fading(t, z, directors, angular_velocity):
    return -z


def remembered(t, z, directors, angular_velocity):
    return z[0], -z[1], 0.0


def steady(t):
    return 0.1, 0.2, 0.0


def pulling(t, directors, angular_velocity):
    return np.outer((0.1, 0.2, 0.3), directors[2])


def bowl(gamma):
    return 0.5 * float(np.sum(gamma**2)) + float(np.sum(gamma[..., 2]))


def slope_of_bowl(gamma):
    slope = gamma.copy()
    slope[..., 2] += 1
    return slope


def by_function(r, given):
    return bool(np.asarray(given["vectors"]).flat[0] > 0)


def coefficients(*shape):
    """Coefficients of a potential, one for each of its vectors, where it has no functions."""

    def draw(r, given):
        if by_function(r, given):
            return None
        found = r.normal(size=(*np.shape(given["vectors"])[:-1], *shape))
        return found + np.swapaxes(found, -1, -2) if len(shape) > 1 else found

    return draw


def file(name, text):
    return lambda r, given: Path(name).write_text(text, encoding="utf-8") and name


def saved(r, given):
    if not Path("run.nc").exists():
        nt.save_run(run(), "run.nc")
    return "run.nc"


RECORDING = "n,qw,qx,qy,qz,a,b,c\n" + "".join(
    f"{k},{np.cos(k / 40)},0,0,{np.sin(k / 40)},{k / 10},0,{-k / 20}\n" for k in range(9)
)


@cache
def throw():
    how = {"t_end": 0.6, "step": 0.005, "material_angular_velocity": (3, 8, 1)}
    return nt.sensors.gyroscope(nt.simulate(nt.standard([1, 2, 2.5]), **how), noise=1e-4)


def throws(r):
    one = throw()
    if r.random() < 0.3:
        table = np.column_stack([one.time.values, one.gyroscope.values])
        np.savetxt("throw.csv", table, delimiter=",", header="t (s),gx (rad/s),gy (rad/s),gz (rad/s)", comments="")
        return "throw.csv"
    return one if r.random() < 0.5 else (one.time.values, one.gyroscope.values)


@cache
def fitted():
    return nt.fit_inertia(throw(), interval="all")


def store(r, given):
    if not Path("store").exists():
        nt.sweep(file("sweep.toml", SWEEP)(r, given), "store", workers=1)
    return "store"


def new_path(suffix):
    return lambda r, given: f"new{r.integers(2**40)}{suffix}"


# Drawn, and not None, also where they may be left out: others need them, or leaving them out is long work.
NEEDED = {
    *("faces", "values", "t_end", "groups", "cases", "quick", "project", "inertia.of_mesh.mass", "pulse.end"),
    *("potential.function", "potential.gradient", "potential.linear", "potential.quadratic"),
    *("jax.function.step", "stepper.step", "least_effort.nodes"),
}


def smooth(r):
    """A load whose runs have derivatives."""
    several = nt.rotor((0, 0, 1), 0.3) + nt.body_moment(TIMES, np.ones((N, 3)))
    return (nt.sine(r.normal(size=3), 0.5), nt.damping(0.1), several)[r.integers(3)]


# By the name of the parameter; "function.parameter" goes before "parameter".
VALUES = {
    **same("d d0 d3_dot d_tilde", units),
    **same("v transport.w covariant_derivative_of_field.w", tangents),
    **same(
        "R frame initial_frame split_form.momentum.directors split_form.energy.directors "
        "split_form.rates.directors split_form.velocity.directors",
        frames,
    ),
    **same("psi psi_dot s phase t", number(-0.5, 0.5)),
    "rtol": number(1e-9, 1e-7),
    "tolerance": lambda r, given: None if given.get("step") else 10.0 ** r.uniform(-9, -7),
    **same("t_end mass length radius inertia.of_mesh.mass", number(0.8, 1.2)),
    **same("DirectorSystem.euler_inertia E", euler),
    "J": matrix,
    "SystemStack.euler_inertia": lambda r, given: np.stack([euler(r, given) for _ in range(3)]),
    "SystemStack.axis": lambda r, given: unit(r, (3,)),
    "SystemStack.dead_force": lambda r, given: r.normal(size=(3, 3, 3)),
    "T": lambda r, given: np.diag(r.uniform(1, 2) * np.array([1, 1, 2])),
    **same("split_tensor.d split_tensor.d_tilde", one_of((0.0, 0.0, 1.0))),
    "covariant_derivative_of_field.step": number(0.001, 0.05),
    "field": one_of(spinning),
    "X": lambda r, given: r.normal(size=(N, 3) if r.random() < 0.5 else 3),
    "momentum_perp": across,
    **same("momentum_par gravity_gradient.start", number(-1, 1)),
    **same(
        "split_form.energy.angular_velocity spring.point spring.anchor dipole.moment dipole.field amplitude",
        lambda r, given: r.normal(size=3),
    ),
    "vee.W": skew,
    **same("d3 points polygon_turn.vertices", path),
    "tangents": lambda r, given: np.gradient(given["points"], axis=0),
    "inertia": symmetric,
    "symmetric_top.inertia": top,
    "inertia.shift.inertia": lambda r, given: 100 * symmetric(r, given),
    **same("heavy_top.mass with_gravity.mass", number(0.01, 0.1)),
    **same("heavy_top.centre_of_mass with_gravity.centre_of_mass", lambda r, given: r.uniform(-0.2, 0.2, 3)),
    "inner_radius": number(0.0, 0.7),
    **same("lengths semi_axes", lambda r, given: r.uniform(0.5, 2, 3)),
    "masses": lambda r, given: r.uniform(0.5, 2, N),
    "inertia.of_mesh.vertices": lambda r, given: np.array(TETRAHEDRON[0]) * r.uniform(0.5, 2),
    "faces": one_of(TETRAHEDRON[1]),
    **same(
        "inertia.of_mesh.density angular_velocity simulate.times integrate.times propagator.times "
        "simulate_ensemble.times DirectorSystem.spin SystemStack.spin SystemStack.spin_factor "
        "read_motion.body read_motion.euler read_motion.angle_unit fit_inertia.gravity fit_inertia.rotor "
        "fit_inertia.constraint fit_inertia.orientation fit_inertia.damping fit_inertia.columns "
        "fit_inertia.time_column fit_inertia.body fit_inertia.rate relative_time shake simulate.order "
        "integrate.order propagator.order simulate_ensemble.order sensitivities.order gradient.order "
        "lyapunov.order lyapunov_ensemble.order function.order reproduce.progress validate.progress dask",
        one_of(None),
    ),
    **same("scale spring.stiffness load_scale memory_load.scale frequency", number(0.5, 2)),
    "coefficient": lambda r, given: float(r.uniform(0, 1)) if r.random() < 0.5 else r.uniform(0, 1, 3),
    "axis": axis,
    "material_angular_velocity": unless_started(planar),
    "project": lambda r, given: True if given.get("start") is not None else bool(r.integers(2)),
    **same(
        "discrete_angle.angular_velocity discrete_second_quotient.angular_velocity moment.angular_velocity "
        "state_moment.angular_velocity",
        planar,
    ),
    "discrete_second_quotient.times": lambda r, given: given["step"] * r.integers(0, 9, N),
    "colatitude": lambda r, given: r.uniform(0, np.pi, N),
    "times": times,
    "covariant_derivative.time": one_of(TIMES),
    **same("body_moment.times space_moment.times", one_of(TIMES, TIMES, steady)),
    "director_forces.times": one_of(TIMES, TIMES, pulling),
    "director_forces.values": lambda r, given: (
        None if callable(given["times"]) else r.normal(size=(len(given["times"]), 3, 3))
    ),
    "director_forces.frame": one_of("space", "body"),
    "potential.vectors": lambda r, given: r.normal(size=3 if r.random() < 0.5 else (2, 3)),
    "potential.function": lambda r, given: bowl if by_function(r, given) else None,
    "potential.gradient": lambda r, given: slope_of_bowl if by_function(r, given) else None,
    "potential.linear": coefficients(3),
    "potential.quadratic": coefficients(3, 3),
    **same("spring.rest_length dry_friction.limit dissipation", number(0, 1)),
    "dry_friction.axis": one_of(None, "x", (0, 0, 3.0)),
    **same("mean_motion stepper.step", number(0.001, 0.1)),
    "eccentricity": number(0, 0.9),
    "perigee_time": lambda r, given: None if given.get("start") else float(r.normal()),
    "radial": one_of((1, 0, 0), (0, 2, 0)),
    "normal": one_of((0, 0, 1), (0, 0, -3.0)),
    "potential_energy.directors": lambda r, given: Rotation.random(N, rng=r).as_matrix(),
    **same("potential_energy.times fraction", lambda r, given: r.uniform(size=N)),
    "values": lambda r, given: None if callable(given["times"]) else r.normal(size=(len(given["times"]), 3)),
    "rotor.momentum": lambda r, given: float(r.normal()) if r.random() < 0.5 else TIMES,
    "rotor.values": lambda r, given: None if np.ndim(given["momentum"]) == 0 else r.normal(size=N),
    "nontwisting.spin": lambda r, given: (None, 0.5, (TIMES, r.normal(size=N)))[r.integers(3)],
    "breakpoints": one_of((), (0.25, 0.5)),
    "read_motion.source": file("recording.csv", RECORDING),
    "read_motion.columns": one_of(None, ("qx", "qy", "qz", "qw")),
    "read_motion.time_column": one_of(None, "a"),
    **same("read_motion.rotation_vector progress printed_loads", one_of(False)),
    "read_motion.time_unit": one_of(None, "s", "ms"),
    **same("read_motion.rate gyroscope.rate", one_of(None, 50.0)),
    **same("read_motion.scalar_first normalize inverse", one_of(True, False)),
    "fit_inertia.recording": made(throws, lambda r: [throws(r), throw()]),
    "fit_inertia.interval": one_of("free", "all", (0.1, 0.5)),
    **same("fit_inertia.bias fit_inertia.scale", number(0.001, 0.02)),
    "fit_inertia.delay": one_of(None, 0.002, {"value": 0.001, "error": 0.001}),
    "fit_inertia.misalignment": one_of(None, [0.01, 0.0, 0.02], {"error": 0.01}),
    "fit_inertia.axis_scales": one_of(None, [1.0, 1.01, 0.99], {"value": [1, 1, 1], "error": 0.01}),
    "fit_inertia.noise": one_of(None, 1e-3),
    "fit_inertia.loss": one_of("linear", "soft_l1"),
    "fit_inertia.unit": one_of(None, "rad/s"),
    "fit_inertia.time_unit": one_of(None, "s"),
    "gyroscope.noise": number(0, 1e-3),
    "gyroscope.seed": one_of(0, 5),
    "gyroscope.delay": one_of(0.0),
    "gyroscope.axis_scales": one_of((1.0, 1.0, 1.0), [1.01, 0.98, 1.0]),
    "recording": one_of(0),
    "turns": one_of(0, 1, -2),
    "twist.motion": sampled,
    "static": one_of(None, (0.0, 1.0)),
    "twist.time": one_of(None, TIMES, (TIMES * 1e9).astype("m8[ns]")),
    "TwistCounter.update.rotation": lambda r, given: (
        Rotation.random(rng=r) if r.random() < 0.5 else unit(r, (2,)) @ np.eye(3, 4)
    ),
    "TwistCounter.update.time": one_of(None, 1.0),
    "relative_to": lambda r, given: Rotation.random(N, rng=r) if r.random() < 0.1 else None,
    "motion": motion,
    **same(
        "simulate_ensemble.start lyapunov_ensemble.start", lambda r, given: ensemble() if r.random() < 0.3 else None
    ),
    "rotation": unless_started(lambda r, given: attitudes(r)),
    "scalar_first": one_of(None, True, False),
    "start": lambda r, given: (run(), trajectory())[r.integers(2)] if r.random() < 0.3 else None,
    "frame_along.function": one_of(circling),
    "moment.function": one_of(spring),
    "wheel.inertia": number(0.01, 0.05),
    "wheel.torque": lambda r, given: (None, 0.2, (TIMES, r.normal(size=N)))[r.integers(3)],
    "wheel.coulomb": one_of(0.0, 0.0, 0.05),
    "wheel.friction": one_of(None, np.arctan),
    "wheel_torque": one_of((), []),
    "memory_load.derivative": one_of(fading),
    "memory_load.moment": one_of(remembered),
    "memory_load.state0": lambda r, given: r.normal(size=2),
    "EnergyMomentum.moments": one_of("paper", "exact"),
    "compiled": lambda r, given: bool(r.random() < 0.02),
    "order": one_of(2, 4),
    "simulate_ensemble.device": one_of("cpu"),  # there may be no GPU
    **same("steer.start steer.target least_effort.start least_effort.target", lambda r, given: Rotation.random(rng=r)),
    "least_effort.system": lambda r, given: nt.nontwisting(symmetric(r, given)),
    "least_effort.nodes": one_of(5, 8),
    "wrt": one_of("inertia", ("material_angular_velocity", "rotation"), ["load_scale", "duration", "axis"]),
    **same(
        "sensitivities.t_end gradient.t_end lyapunov.t_end lyapunov_ensemble.t_end function.t_end "
        "simulate.t_end integrate.t_end propagator.t_end simulate_ensemble.t_end compare.t_end",
        one_of(2, 1.5),
    ),
    **same(
        "sensitivities.integrator gradient.integrator lyapunov.integrator lyapunov_ensemble.integrator "
        "function.integrator",
        one_of("gauss", "lie-midpoint"),
    ),
    **same("sensitivities.load gradient.load lyapunov.load lyapunov_ensemble.load function.load", made(smooth)),
    "gradient.store": one_of("end"),
    **same("d_rotation d_material_angular_velocity", lambda r, given: r.normal(size=(2, 3))),
    "stepper.integrator": one_of("lie-midpoint", "gauss", "energy-momentum"),
    "step": one_of(None, 0.1),
    "jax.function.step": one_of(0.1),
    "t_start": one_of(0, 0.0),
    **same("discrete_angle.step discrete_free.step discrete_second_quotient.step", number(0.01, 1)),
    "steps": one_of(0, 3, 10),
    "compare.steps": one_of([0.1, 0.05]),
    "integrators": one_of(["lie-midpoint"], ["exact", ("split", 2)], [("energy-momentum", 2), "continuous"]),
    **same("repeats validate.workers", one_of(1)),
    "integrator": lambda r, given: (*nt.integrators.INTEGRATORS, nt.integrators.Split(order=2))[
        r.integers(len(nt.integrators.INTEGRATORS) + 1)
    ],
    "loaded_nontwisting.load": steady_load,
    "third": lambda r, given: ("smallest", "middle", "largest", unit(r))[r.integers(4)],
    "variables": one_of("all", "quaternion", ("kinetic_energy",), ()),
    "reduce": one_of(()),
    "threads": one_of(None, 1, 2),
    "method": one_of("RK45", "DOP853", "Radau"),
    "atol": number(1e-12, 1e-6),
    **same("EnergyMomentum.order LieMidpoint.order", one_of(2)),
    "Split.order": one_of(2, 4, 6),
    "name": one_of("body", ""),
    "title": one_of(None, "a title"),
    "terms": lambda r, given: loads(r).terms,
    "variable": one_of("directors", "kinetic_energy"),
    "run_h": lambda r, given: run(step=0.1),
    "run_h2": lambda r, given: run(step=0.05),
    "run_h4": lambda r, given: run(step=0.025),
    "pulse.start": number(0, 0.5),
    "end": number(0.6, 1),
    "offset": lambda r, given: r.uniform(-1, 1, 3),
    **same("reaction_moment.runs multipliers.runs", constrained),
    "director": one_of(1, 2, 3),
    **same("triads member", one_of(0, 3)),
    **same("columns panels", one_of(1, 2)),
    "height": number(1.5, 3),
    "elevation": number(-80, 80),
    "azimuth": number(-180, 180),
    "plot.save.drawn": lambda r, given: nt.plot.new_axes()[0].figure,
    "paths": new_path(".png"),
    "comparison": lambda r, given: compared(),
    "targets": one_of((1e-3,), (1e-3, 1e-6)),
    "groups": one_of("geometry"),
    "workers": one_of(None, 1),
    "block": one_of(None, 2),
    **same("run_file read.path", file("sweep.toml", SWEEP)),
    "Problem.write.path": new_path(".toml"),
    "overrides": one_of((), ["time.t_end=2"]),
    "open_run.path": saved,
    "save_run.path": new_path(".nc"),
    "save_run.run": lambda r, given: run(),
    **same("sweep.store out", new_path("")),
    **same("open_sweep.store sweep_member.store", store),
    "cases": one_of([1]),
    "quick": one_of(True),
    "systems": lambda r, given: [nt.standard(symmetric(r, given)) for _ in range(3)],
    "text": lambda r, given: bodies(r).to_json(),
    **same("state_moment.directors moment.directors", lambda r, given: Rotation.random(rng=r).as_matrix()),
}
# By the annotation, one alternative of it.
FORMS = {
    "float": number(0.5, 1.5),
    "bool": one_of(False, True),
    "None": one_of(None),
    "DirectorSystem": made(bodies),
    "SystemStack": lambda r, given: nt.DirectorSystem.stack([nt.standard(symmetric(r, given)) for _ in range(3)]),
    "Load": made(loads),
    "xarray.Dataset": lambda r, given: (run(), run("standard"), run("standard", load=True))[r.integers(3)],
    "Trajectory": lambda r, given: trajectory(),
    "Fit": lambda r, given: fitted(),
    "TwistCounter": lambda r, given: nt.TwistCounter("z", scalar_first=bool(r.integers(2))),
    "Propagator": lambda r, given: nt.propagator(bodies(r), t_end=1, step=0.1, project=True),
    "Steering": lambda r, given: nt.steer(*Rotation.random(2, rng=r)),
    "Stepper": lambda r, given: nt.stepper(bodies(r), float(r.uniform(0.001, 0.1))),
    "Runs": runs,
    "Quotients": lambda r, given: quotients() if r.random() < 0.5 else {"a": quotients(), "b": quotients()},
    "Axes": lambda r, given: nt.plot.new_axes()[0],
    "Problem": lambda r, given: nt.Problem(bodies(r), t_end=1.0),
    "RunFile": lambda r, given: nt.runfile.read_run_file(file("sweep.toml", SWEEP)(r, given)),
}


def by_shape(text):
    """A value for an array whose docstring says ``(3,) array``, ``(..., n, 3) array`` and the like; None for others."""
    match = re.match(r"\(([^)]*)\)", text)
    if match is None:
        return number(0.5, 1.5) if text.startswith("float") else None
    sizes = [size.strip() for size in match[1].split(",") if size.strip()]
    shape = [int(size) if size.isdigit() else N for size in sizes]
    return lambda r, given: r.normal(size=shape)


def strategy(function, parameter, annotation, described):
    """What draws a valid value of a parameter, from a generator and the values of the parameters before it."""
    for name in (f"{function}.{parameter}", f"{function.split('.')[-1]}.{parameter}"):
        if name in VALUES:
            return VALUES[name]
    if parameter in VALUES and "Literal" not in annotation:
        return VALUES[parameter]
    found = []
    for form in re.split(r" \| (?![^\[]*\])", annotation):
        if form.startswith("Literal["):
            found += [one_of(*ast.literal_eval(form.removeprefix("Literal").replace("[", "(").replace("]", ",)")))]
        elif form in ("ArrayLike", "Array") and (shaped := by_shape(described)):
            found.append(shaped)
        elif form in FORMS:
            found.append(FORMS[form])
    assert found, (
        f"the fuzz has no valid values for {parameter!r} of {function} ({annotation}; {described!r}): say its shape in "
        f"the docstring, as in '(n, 3) array', or add {parameter!r} to VALUES in tests/fuzz_values.py"
    )
    return lambda r, given: found[r.integers(len(found))](r, given)

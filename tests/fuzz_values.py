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


def of(names, **draws):
    """The parameters of several functions."""
    return {f"{name}.{parameter}": draw for name in names.split() for parameter, draw in draws.items()}


class Draws(np.random.Generator):
    """A generator that knows, as `given`, the values of the parameters before."""


def one_of(*choices):
    return lambda r: choices[r.integers(len(choices))]


def made(*ways):
    """What is drawn in one of these ways."""
    return lambda r: ways[r.integers(len(ways))](r)


def number(low, high):
    return lambda r: float(r.uniform(low, high))


def unit(r, shape=()):
    d = r.normal(size=(*shape, 3))
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


def units(r):
    return unit(r, next((np.shape(r.given[name])[:-1] for name in ("d0", "d", "d3") if name in r.given), (N,)))


def tangents(r):
    d = next(r.given[name] for name in ("d0", "d", "d3") if name in r.given)
    v = r.normal(size=np.shape(d))
    return v - np.sum(v * d, axis=-1, keepdims=True) * d


def unless_started(draw):
    """What `start` brings must not be given."""
    return lambda r: None if r.given.get("start") is not None else draw(r)


def path(r):
    return Rotation.random(rng=r).apply(WAY)


def frames(r):
    return Rotation.random(N, rng=r).as_matrix()


def skew(r):
    a = r.normal(size=(N, 3, 3))
    return a - a.mT


def symmetric(r):
    """An inertia with D3 principal, so that every body takes it."""
    J = np.diag(r.uniform([1.0, 1.2, 1.4], [1.1, 1.3, 1.6]))
    J[0, 1] = J[1, 0] = r.uniform(-0.05, 0.05)
    return J if r.random() < 0.7 else np.sort(J.diagonal())


def matrix(r):
    J = symmetric(r)
    return J if J.ndim == 2 else np.diag(J)


def euler(r):
    return nt.inertia.euler_inertia(symmetric(r))


def top(r):
    A = r.uniform(1, 1.1)
    return np.array([A, A, r.uniform(0.5, 1.5)])


def planar(r):
    return np.append(r.uniform(0.2, 1.0, 2), 0.0)


def times(r):
    return np.sort(r.uniform(0.1, 0.9, N)) if r.random() < 0.5 else TIMES


def axis(r):
    return "z" if r.random() < 0.2 else (0, 0, float(r.uniform(0.5, 2)))


def bodies(r):
    J = symmetric(r)
    kinds = (nt.standard, nt.nontwisting, lambda J: nt.suslov(J, (0, 0, 1)))
    body = kinds[r.integers(3)](J)
    return body if r.random() < 0.7 else nt.with_gravity(body, 0.1, (0, 0, 0.1))


def steady_load(r):
    """A load that leaves the axis of rotation where it is."""
    J = nt.inertia.convected_inertia(nt.inertia.euler_inertia(r.given["inertia"]))
    return nt.pulse(J @ r.given["material_angular_velocity"] * r.uniform(0.1, 1))


def loads(r):
    amplitude = r.uniform(-1, 1, 2)
    push = nt.pulse((*amplitude, 0), end=0.5, shape=("triangle", "rectangle", "half-sine")[r.integers(3)])
    return push if r.random() < 0.6 else push + nt.sine((0.1, 0, 0), 1.0)


def turned(r):
    return Rotation.random(rng=r)


def directed(r):
    return turned(r).as_matrix()


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


def runs(r):
    choices = run(), run("standard"), run("standard", load=True)
    one = choices[r.integers(3)]
    return one if r.random() < 0.6 else {"a": one, "b": one}


def constrained(r):
    return run() if r.random() < 0.5 else {"a": run(load=True), "b": run()}


def motion(r):
    return (run(), trajectory(), Rotation.from_rotvec(np.outer(TIMES, unit(r))), run().directors)[r.integers(4)]


def sampled(r):
    turn = Rotation.random(rng=r) * Rotation.from_rotvec(np.outer(TIMES, unit(r)))
    return turn if r.random() < 0.5 else turn.as_matrix()


def across(r):
    """A vector that is tangent at the director of the axis."""
    body, v = r.given["system"], r.normal(size=3)
    d = (np.eye(3)[2] if body.axis is None else body.axis) @ np.asarray(r.given["directors"])
    return v - (d @ v)[..., None] * d


def spring(t, directors, angular_velocity):
    x, y, _ = directors[2]
    return 2 * y, -2 * x, 0.0


def bowl(gamma):
    return 0.5 * float(np.sum(gamma**2)) + float(np.sum(gamma[..., 2]))


def slope_of_bowl(gamma):
    slope = gamma.copy()
    slope[..., 2] += 1
    return slope


def at_times(*shape):
    return lambda r: None if callable(r.given["times"]) else r.normal(size=(len(r.given["times"]), *shape))


def by_function(r):
    return bool(np.asarray(r.given["vectors"]).flat[0] > 0)


def coefficients(*shape):
    """Coefficients of a potential, one for each of its vectors, where it has no functions."""

    def draw(r):
        if by_function(r):
            return None
        found = r.normal(size=(*np.shape(r.given["vectors"])[:-1], *shape))
        return found + np.swapaxes(found, -1, -2) if len(shape) > 1 else found

    return draw


def file(name, text):
    return lambda r: Path(name).write_text(text, encoding="utf-8") and name


def saved(r):
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


def store(r):
    if not Path("store").exists():
        nt.sweep(file("sweep.toml", SWEEP)(r), "store", workers=1)
    return "store"


def new_path(suffix):
    return lambda r: f"new{r.integers(2**40)}{suffix}"


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


NONE, LONG = one_of(None), one_of(2, 1.5)
# By the name of the parameter; "function.parameter" goes before "parameter".
VALUES = {
    **same("d d0 d3_dot d_tilde", units),
    **same("v transport.w covariant_derivative_of_field.w", tangents),
    **same("R frame initial_frame", frames),
    **of("split_form.momentum split_form.energy split_form.rates split_form.velocity", directors=frames),
    "potential_energy.directors": frames,
    "rtol": number(1e-9, 1e-7),
    "tolerance": lambda r: None if r.given.get("step") else 10.0 ** r.uniform(-9, -7),
    "t_end": LONG,
    "inertia.of_mesh.mass": number(0.8, 1.2),
    **same("DirectorSystem.euler_inertia E", euler),
    "J": matrix,
    "SystemStack.euler_inertia": lambda r: np.stack([euler(r) for _ in range(N)]),
    "SystemStack.axis": lambda r: unit(r, (N,)),
    "T": lambda r: np.diag(r.uniform(1, 2) * np.array([1, 1, 2])),
    **same("split_tensor.d split_tensor.d_tilde", one_of((0.0, 0.0, 1.0))),
    "covariant_derivative_of_field.step": number(0.001, 0.05),
    "covariant_derivative_of_field.field": one_of(lambda d: (-d[1], d[0], 0.0)),
    "momentum_perp": across,
    **same("momentum_par gravity_gradient.start", number(-1, 1)),
    "split_form.energy.angular_velocity": lambda r: r.normal(size=3),
    "vee.W": skew,
    **same("d3 points polygon_turn.vertices", path),
    "tangents": lambda r: np.gradient(r.given["points"], axis=0),
    "inertia": symmetric,
    "symmetric_top.inertia": top,
    "inertia.shift.inertia": lambda r: 100 * symmetric(r),
    **same("heavy_top.mass with_gravity.mass", number(0.01, 0.1)),
    **same("heavy_top.centre_of_mass with_gravity.centre_of_mass", lambda r: r.uniform(-0.2, 0.2, 3)),
    "inner_radius": number(0.0, 0.7),
    **same("lengths semi_axes", lambda r: r.uniform(0.5, 2, 3)),
    "masses": lambda r: r.uniform(0.5, 2, N),
    "inertia.of_mesh.vertices": lambda r: np.array(TETRAHEDRON[0]) * r.uniform(0.5, 2),
    "faces": one_of(TETRAHEDRON[1]),
    **same("inertia.of_mesh.density angular_velocity relative_time shake dask", NONE),
    **same("DirectorSystem.spin SystemStack.spin SystemStack.spin_factor", NONE),
    **of("read_motion", angle_unit=NONE),
    **of("fit_inertia", **same("gravity rotor constraint orientation damping rate", NONE)),
    **of("sensitivities gradient lyapunov lyapunov_ensemble function", order=NONE, load=smooth),
    **of("sensitivities gradient lyapunov lyapunov_ensemble function", integrator=one_of("gauss", "lie-midpoint")),
    **of("simulate integrate propagator simulate_ensemble", order=NONE, times=NONE),
    "load_scale": number(0.5, 2),
    "coefficient": lambda r: r.uniform(0, 1, (None, 3)[r.integers(2)]),
    "axis": axis,
    "material_angular_velocity": unless_started(planar),
    "project": lambda r: True if r.given.get("start") is not None else bool(r.integers(2)),
    **of("discrete_angle discrete_second_quotient moment state_moment", angular_velocity=planar),
    "discrete_second_quotient.times": lambda r: r.given["step"] * r.integers(0, 9, N),
    "times": times,
    "covariant_derivative.time": one_of(TIMES),
    **same("body_moment.times space_moment.times", one_of(TIMES, TIMES, lambda t: (0.1, 0.2, 0.0))),
    "director_forces.times": one_of(TIMES, TIMES, lambda t, d, w: np.outer((0.1, 0.2, 0.3), d[2])),
    "director_forces.values": at_times(3, 3),
    "potential.vectors": lambda r: r.normal(size=3 if r.random() < 0.5 else (2, 3)),
    "potential.function": lambda r: bowl if by_function(r) else None,
    "potential.gradient": lambda r: slope_of_bowl if by_function(r) else None,
    "potential.linear": coefficients(3),
    "potential.quadratic": coefficients(3, 3),
    "dissipation": number(0, 1),
    "dry_friction.axis": one_of(None, "x", (0, 0, 3.0)),
    "stepper.step": number(0.001, 0.1),
    "eccentricity": number(0, 0.9),
    "perigee_time": lambda r: None if r.given.get("start") else float(r.normal()),
    "radial": one_of((1, 0, 0), (0, 2, 0)),
    "normal": one_of((0, 0, 1), (0, 0, -3.0)),
    "fraction": lambda r: r.uniform(size=N),
    "values": at_times(3),
    "rotor.momentum": made(number(-2, 2), one_of(TIMES)),
    "rotor.values": lambda r: None if np.ndim(r.given["momentum"]) == 0 else r.normal(size=N),
    "nontwisting.spin": lambda r: (None, 0.5, (TIMES, r.normal(size=N)))[r.integers(3)],
    "breakpoints": one_of((), (0.25, 0.5)),
    "read_motion.source": file("recording.csv", RECORDING),
    "read_motion.columns": one_of(None, ("qx", "qy", "qz", "qw")),
    "read_motion.time_column": one_of(None, "a"),
    "read_motion.rotation_vector": one_of(False),
    **same("read_motion.rate gyroscope.rate", one_of(None, 50.0)),
    "normalize": one_of(True, False),
    "fit_inertia.recording": made(throws, lambda r: [throws(r), throw()]),
    "fit_inertia.interval": one_of("free", "all", (0.1, 0.5)),
    **same("fit_inertia.bias fit_inertia.scale", number(0.001, 0.02)),
    "fit_inertia.delay": one_of(None, 0.002, {"value": 0.001, "error": 0.001}),
    "fit_inertia.misalignment": one_of(None, [0.01, 0.0, 0.02], {"error": 0.01}),
    "fit_inertia.axis_scales": one_of(None, [1.0, 1.01, 0.99], {"value": [1, 1, 1], "error": 0.01}),
    "fit_inertia.noise": one_of(None, 1e-3),
    "fit_inertia.loss": one_of("linear", "soft_l1"),
    "gyroscope.noise": number(0, 1e-3),
    "gyroscope.seed": one_of(0, 5),
    "gyroscope.delay": one_of(0.0),
    "gyroscope.axis_scales": one_of((1.0, 1.0, 1.0), [1.01, 0.98, 1.0]),
    "recording": one_of(0),
    "turns": one_of(0, 1, -2),
    "twist.motion": sampled,
    "static": one_of(None, (0.0, 1.0)),
    "twist.time": one_of(None, TIMES, (TIMES * 1e9).astype("m8[ns]")),
    "TwistCounter.update.rotation": made(turned, lambda r: unit(r, (2,)) @ np.eye(3, 4)),
    "TwistCounter.update.time": one_of(None, 1.0),
    "relative_to": lambda r: Rotation.random(N, rng=r) if r.random() < 0.1 else None,
    "motion": motion,
    **same("simulate_ensemble.start lyapunov_ensemble.start", lambda r: ensemble() if r.random() < 0.3 else None),
    "rotation": unless_started(made(turned, directed)),
    "start": lambda r: (run(), trajectory())[r.integers(2)] if r.random() < 0.3 else None,
    "frame_along.function": one_of(lambda t: (0.6 * np.cos(t), 0.6 * np.sin(t), 0.8)),
    "moment.function": one_of(spring),
    "wheel.inertia": number(0.01, 0.05),
    "wheel.torque": lambda r: (None, 0.2, (TIMES, r.normal(size=N)))[r.integers(3)],
    "wheel.coulomb": one_of(0.0, 0.0, 0.05),
    "wheel.friction": one_of(None, np.arctan),
    "wheel_torque": one_of((), []),
    **of("simulate_ensemble lyapunov_ensemble Problem Problem.replace", wheel_torque=NONE),
    "memory_load.derivative": one_of(lambda t, z, directors, angular_velocity: -z),
    "memory_load.moment": one_of(lambda t, z, directors, angular_velocity: (z[0], -z[1], 0.0)),
    "memory_load.state0": lambda r: r.normal(size=2),
    "compiled": lambda r: bool(r.random() < 0.02),
    "order": one_of(2, 4),
    "simulate_ensemble.device": one_of("cpu"),  # there may be no GPU
    **of("steer least_effort", start=turned, target=turned),
    "least_effort.system": lambda r: nt.nontwisting(symmetric(r)),
    "least_effort.nodes": one_of(5, 8),
    "wrt": one_of("inertia", ("material_angular_velocity", "rotation"), ["load_scale", "duration", "axis"]),
    "gradient.store": one_of("end"),
    **same("d_rotation d_material_angular_velocity", lambda r: r.normal(size=(2, 3))),
    "stepper.order": NONE,
    "stepper.integrator": one_of("lie-midpoint", "gauss", "energy-momentum"),
    "step": one_of(None, 0.1),
    "jax.function.step": one_of(0.1),
    "t_start": one_of(0, 0.0),
    **of("discrete_angle discrete_free discrete_second_quotient", step=number(0.01, 1)),
    "steps": one_of(0, 3, 10),
    "compare.steps": one_of([0.1, 0.05]),
    "integrators": one_of(["lie-midpoint"], ["exact", ("split", 2)], [("energy-momentum", 2), "continuous"]),
    **same("repeats validate.workers", one_of(1)),
    "integrator": one_of(*nt.integrators.INTEGRATORS, nt.integrators.Split(order=2)),
    "loaded_nontwisting.load": steady_load,
    "third": lambda r: ("smallest", "middle", "largest", unit(r))[r.integers(4)],
    "variables": one_of("all", "quaternion", ("kinetic_energy",), ()),
    "reduce": one_of(()),
    "method": one_of("RK45", "DOP853", "Radau"),
    "atol": number(1e-12, 1e-6),
    **same("EnergyMomentum.order LieMidpoint.order", one_of(2)),
    "Split.order": one_of(2, 4, 6),
    "name": one_of("body", ""),
    "terms": lambda r: loads(r).terms,
    "variable": one_of("directors", "kinetic_energy"),
    "run_h": lambda r: run(step=0.1),
    "run_h2": lambda r: run(step=0.05),
    "run_h4": lambda r: run(step=0.025),
    "pulse.start": number(0, 0.5),
    **same("reaction_moment.runs multipliers.runs", constrained),
    "director": one_of(1, 2, 3),
    **same("triads member", one_of(0, 3)),
    **same("columns panels", one_of(1, 2)),
    "height": number(1.5, 3),
    "plot.save.drawn": lambda r: nt.plot.new_axes()[0].figure,
    "paths": new_path(".png"),
    "comparison": lambda r: compared(),
    "targets": one_of((1e-3,), (1e-3, 1e-6)),
    "groups": one_of("geometry"),
    **same("sweep.problem read.path", file("sweep.toml", SWEEP)),
    "Problem.write.path": new_path(".toml"),
    "set": one_of((), ["time.t_end=2"]),
    "open_run.path": saved,
    "save_run.path": new_path(".nc"),
    **same("sweep.path out", new_path("")),
    **same("open_sweep.path sweep_member.path", store),
    "cases": one_of([1]),
    "quick": one_of(True),
    "systems": lambda r: [nt.standard(symmetric(r)) for _ in range(3)],
    "text": lambda r: bodies(r).to_json(),
    **of("state_moment moment", directors=directed),
}
# By the annotation, one alternative of it.
FORMS = {
    "float": number(0.5, 1.5),
    "bool": one_of(False, True),
    "None": NONE,
    "DirectorSystem": bodies,
    "SystemStack": lambda r: nt.DirectorSystem.stack([nt.standard(symmetric(r)) for _ in range(3)]),
    "Load": loads,
    "Dataset": lambda r: (run(), run("standard"), run("standard", load=True))[r.integers(3)],
    "Trajectory": lambda r: trajectory(),
    "Fit": lambda r: fitted(),
    "TwistCounter": lambda r: nt.TwistCounter("z", scalar_first=bool(r.integers(2))),
    "Propagator": lambda r: nt.propagator(bodies(r), t_end=1, step=0.1, project=True),
    "Steering": lambda r: nt.steer(*Rotation.random(2, rng=r)),
    "Stepper": lambda r: nt.stepper(bodies(r), float(r.uniform(0.001, 0.1))),
    "Runs": runs,
    "Quotients": lambda r: quotients() if r.random() < 0.5 else {"a": quotients(), "b": quotients()},
    "Axes": lambda r: nt.plot.new_axes()[0],
    "Problem": lambda r: nt.Problem(bodies(r), t_end=1.0),
}


def by_shape(text):
    """A value for an array whose docstring says ``(3,) array``, ``(..., n, 3) array`` and the like; None for others."""
    match = re.match(r"\(([^)]*)\)", text)
    if match is None:
        return number(0.5, 1.5) if text.startswith("float") else None
    sizes = [size.strip() for size in match[1].split(",") if size.strip()]
    shape = [int(size) if size.isdigit() else N for size in sizes]
    return lambda r: r.normal(size=shape)


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
    return lambda r: found[r.integers(len(found))](r)

"""Generated problems: every accepted pair of body, load, integrator, output, start and way to run, and its numbers.

All motions last 3 s and have numbers of order 1 in SI units. `Problem` names a choice of every factor, `outcome` runs
it with public names of the package alone.
"""

from __future__ import annotations

import ctypes
import warnings
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

import nontwist as nt

SPAN = 3.0  # s
INSTANTS = 8  # that are compared, of each array of a run
KEPT = (
    *("quaternion", "material_angular_velocity", "spatial_momentum", "total_momentum", "kinetic_energy"),
    *("potential_energy", "moment", "load_work", "multipliers", "spatial_reaction_moment", "mean_twist_rate"),
    *("newton_iterations", "t_events", "event_quaternion", "event_material_angular_velocity"),
)
FULL = np.array([[3, 0.2, 0.4], [0.2, 4, -0.3], [0.4, -0.3, 5]])
BLOCK = np.array([[3, -1 / 7, 0], [-1 / 7, 4, 0], [0, 0, 5]])
TILTED, WEIGHT, CENTRE = (0.3, 0.2, 1.0), 0.4, (0.1, -0.2, 0.6)
PULL = (2.1, -1.3, -9.2)  # not across the first W, where a sign of round-off chooses the axis of a step of `gauss`


class Problem(NamedTuple):
    """A choice of every factor."""

    body: str
    load: str
    scheme: str
    output: str
    start: str
    way: str


BODIES = {
    "standard": lambda c: nt.standard(c * FULL),
    "principal axes": lambda c: nt.standard(c * np.array([3, 4, 5])),
    "symmetric": lambda c: nt.standard(c * np.array([3, 3, 5])),
    "sphere": lambda c: nt.standard(c * np.array([2, 2, 2])),
    "nontwisting": lambda c: nt.nontwisting(c * BLOCK),
    "nontwisting symmetric": lambda c: nt.nontwisting(c * np.array([3, 3, 2])),
    "spin": lambda c: nt.nontwisting(c * BLOCK, spin=0.5),
    "spin table": lambda c: nt.nontwisting(c * np.array([3, 4, 5]), spin=([0.4, 1.45, 2.2], [0, 0.8, 0.3])),
    "suslov": lambda c: nt.suslov(c * FULL, TILTED),
    "suslov principal": lambda c: nt.suslov(c * np.array([3, 4, 5]), "y"),
    "heavy top": lambda c: nt.heavy_top(c * FULL, WEIGHT, CENTRE),
    "lagrange top": lambda c: nt.heavy_top(c * np.array([2, 2, 1]), WEIGHT, (0, 0, 0.6)),
    "heavy nontwisting": lambda c: nt.with_gravity(nt.nontwisting(c * BLOCK), WEIGHT, (0.1, 0.2, 0.5), PULL),
    "heavy suslov": lambda c: nt.with_gravity(nt.suslov(c * FULL, TILTED), WEIGHT, CENTRE),
    "heavy spin": lambda c: nt.with_gravity(nt.nontwisting(c * BLOCK, spin=0.5), WEIGHT, (0, 0, 0.5)),
}
MORE_OF_BODIES = {"suslov": ["axis"], "suslov principal": ["axis"], "spin": ["spin"], "spin table": ["spin"]}


def of_time(t):
    return np.sin(3 * t), 0.5, 0.3 * np.cos(t)


def of_state(t, d, w):
    return 0.4 * d[2, 1] - 0.1 * w[0] * w[0], 0.3 * t - 0.2 * w[1], 0.3 * d[0, 1] * w[2]


def of_state_derivative(t, d, w):
    by_directors = np.zeros((3, 3, 3))
    by_directors[0, 2, 1], by_directors[2, 0, 1] = 0.4, 0.3 * w[2]
    return by_directors, np.array([[-0.2 * w[0], 0, 0], [0, -0.2, 0], [0, 0, 0.3 * d[0, 1]]])


def forces(t, d, w):
    return (0.3 * d[0, 1], 0, 0.2 * t), (0, -0.2 * w[0], 0.1), (0.2 * d[1, 2], 0.3 * d[2, 0], -0.4)


def height(a):
    return 0.3 * a[2] * a[2] * a[2] + 0.2 * a[0] * a[1]


def height_gradient(a):
    return 0.2 * a[1], 0.2 * a[0], 0.9 * a[2] * a[2]


DOUBLES = ctypes.POINTER(ctypes.c_double)


@ctypes.CFUNCTYPE(None, ctypes.c_double, DOUBLES, DOUBLES, DOUBLES)
def in_c(t, d, w, m):
    m[0], m[1], m[2] = 0.4 * d[7] - 0.1 * w[0], 0.1 * t - 0.2 * w[1], 0.3 * d[1]


PEAK, TIMES = (0.8, -0.6, 1.1), [0, 0.7, 1.5, 2.33, 3.8]
ROWS = np.array([[0, 0.2, 0.1], [0.9, 0, -0.6], [0.3, -0.7, 0.2], [0, 0.5, 0], [0.4, 0.1, 0.2]])
FORCES = 0.3 * np.array([np.outer(row, (1, -0.5, 2)) + np.diag(row) for row in ROWS])
DAMPING = np.array([[0.3, 0.1, 0], [-0.05, 0.2, 0.04], [0, 0.02, 0.25]])
Q = np.array([[0.4, 0.1, 0], [0.1, -0.3, 0.2], [0, 0.2, 0.6]])
LOADS = {  # how to make it, and the parameters by which it is differentiated
    "none": (nt.Load, ""),
    "body table": (lambda: nt.body_moment(TIMES, ROWS), "values load_scale"),
    "space table": (lambda: nt.space_moment(TIMES, ROWS), "values load_scale"),
    "body function of time": (lambda: nt.body_moment(of_time, breakpoints=[1.2]), "load_scale"),
    "space function of time": (lambda: nt.space_moment(of_time), "load_scale"),
    "moment": (lambda: nt.moment(of_state, derivative=of_state_derivative), "load_scale"),
    "compiled moment": (lambda: nt.moment(of_state, compiled=True), "load_scale"),
    "moment in C": (lambda: nt.moment(in_c), "load_scale"),
    "damping": (lambda: nt.damping(0.3), "damping load_scale"),
    "damping matrix": (lambda: nt.damping(DAMPING), "damping load_scale"),
    "triangle": (lambda: nt.pulse(PEAK, 0.2, 1.7), "pulse load_scale"),
    "rectangle": (lambda: nt.pulse(PEAK, 0.5, 1.53, shape="rectangle", frame="space"), "pulse load_scale"),
    "half-sine": (lambda: nt.pulse(PEAK, 1, 4, shape="half-sine"), "pulse load_scale"),
    "body sine": (lambda: nt.sine(PEAK, 0.7, phase=0.3), "sine frequency phase load_scale"),
    "space sine": (lambda: nt.sine(PEAK, 0.4, frame="space"), "sine frequency phase load_scale"),
    "rotor": (lambda: nt.rotor((1, 2, 2), 0.9), "rotor values load_scale"),
    "rotor table": (lambda: nt.rotor("z", [0.5, 1.4, 2.6], [0, 1.2, 0.4]), "rotor values load_scale"),
    "force table": (lambda: nt.director_forces(TIMES, FORCES), "load_scale"),
    "body force table": (lambda: nt.director_forces(TIMES, FORCES, frame="body"), "load_scale"),
    "forces": (lambda: nt.director_forces(forces, frame="body"), "load_scale"),
    "compiled forces": (lambda: nt.director_forces(forces, compiled=True), "load_scale"),
    "linear": (lambda: nt.potential((0, 0.3, 1), linear=(0.4, 0.2, 0.7)), "linear load_scale"),
    "quadratic": (lambda: nt.potential(np.eye(3)[1:], quadratic=[Q, -0.5 * Q]), "quadratic load_scale"),
    "potential": (lambda: nt.potential((0, 0.3, 1), height, height_gradient), "load_scale"),
    "compiled potential": (lambda: nt.potential((0, 0, 1), height, height_gradient, compiled=True), "load_scale"),
    "spring": (lambda: nt.spring(1.5, (0, 0.2, 0.8), (0.7, 0, 0.9)), "stiffness load_scale"),
    "long spring": (lambda: nt.spring(1.5, (0, 0.2, 0.8), (1.7, 0, 0.9), 0.6), "stiffness rest_length load_scale"),
    "dipole": (lambda: nt.dipole((0.3, 0, 1), (0, 0.5, 0.6)), "linear load_scale"),
    "gravity gradient": (lambda: nt.gravity_gradient(0.6, (1, 1, 0), (0, 0, 1), 0.2), "mean_motion load_scale"),
    "sum": (lambda: nt.sine(PEAK, 0.7) + nt.rotor("x", 0.7) + 0.5 * nt.damping(DAMPING), "sine rotor damping"),
    "sum of all": (
        lambda: (
            nt.space_moment(TIMES, ROWS)
            - 0.4 * nt.pulse(PEAK, 0.3, 2)
            + nt.damping(0.1)
            + nt.spring(1, (0, 0, 1), (1, 0, 1), 0.5)
            + 0.7 * nt.dipole((0, 0, 1), (0.5, 0, 1))
            + nt.director_forces(TIMES, FORCES)
        ),
        "load[0].values pulse damping stiffness",
    ),
}
DIFFERENCED = {"compiled moment", "moment in C", "forces", "compiled forces", "potential", "compiled potential"}


@cache
def made_load(name):
    """Return a load, one for all problems: functions are compiled once."""
    return LOADS[name][0]()


def schemes():
    """Return the integrators of the package at every order, and with dissipation, by name."""
    found = {}
    for name, kind in nt.integrators.INTEGRATORS.items():
        if kind.__module__.startswith("nontwist."):
            found |= {" ".join([name, str(getattr(one, "order", ""))]).strip(): one for one in kind.variants()}
        if "dissipation" in getattr(kind, "__dataclass_fields__", {}):
            found |= {f"{name} {k} dissipative": kind(order=k, dissipation=0.7) for k in (1, 2)}
    return found


OUTPUTS = {
    "all": {"store": 1},
    "every fourth": {"store": 4},
    "ends": {"store": "end"},
    "times": {"times": np.array([0, 0.02, 0.31, 1.3, 1.5, 1.9, 2.47, SPAN])},
    "times within": {"times": np.array([0.45, 0.46, 1.02, 1.65, 2.4])},
}
W, P = np.array([0.9, -1.3, 0.6]), np.array([0.7, 0.1, -0.4, 0.5]) / np.sqrt(0.91)
ASKEW = Rotation.from_rotvec((0.5, 1.2, -0.4)).as_matrix()
STARTS = {  # arguments, the number of steps
    "rest": ({"rotation": ASKEW}, 30),
    "velocity": ({"material_angular_velocity": W}, 30),
    "quaternion": ({"material_angular_velocity": W[::-1], "rotation": P, "scalar_first": True}, 37),
    "space": ({"angular_velocity": W, "rotation": ASKEW}, 30),
    "late": ({"material_angular_velocity": W, "t_start": 0.7}, 33),
    "fast": ({"material_angular_velocity": -4 * W}, 64),
    "run": ({}, 30),
}


def arguments(problem):
    """Return the body and the arguments of `simulate` for a problem, `start` and `project` among them."""
    scheme, body, (start, count) = schemes()[problem.scheme], BODIES[problem.body](1.0), STARTS[problem.start]
    start = dict(start)
    t = start.pop("t_start", 0.0)
    if problem.start == "run":
        how = {"t_end": 0.5, "step": 0.1, "integrator": scheme, "project": True}
        start, t = {"start": nt.integrate(body, material_angular_velocity=W, **how)}, 0.5
    elif t:
        start["t_start"] = t
    how = {"t_end": t + SPAN, "step": SPAN / count, "load": made_load(problem.load), "integrator": scheme}
    output = dict(OUTPUTS[problem.output])
    if "times" in output:
        output["times"] = t + output["times"]
        if scheme.any_times:
            del how["step"]
    return body, start | {"project": True}, how | output


def few(values, count=INSTANTS):
    """Return at most so many entries along the first axis, the first and the last among them."""
    values = np.asarray(values)
    return values[np.unique(np.linspace(0, len(values) - 1, count).astype(int))] if len(values) else values


def of_run(run, prefix="", count=INSTANTS):
    """Return the numbers of a dataset or a trajectory; of the mean moment of the constraint the impulse."""
    run = run if hasattr(run, "data_vars") else run.to_dataset()
    found = {name: run[name].values for name in KEPT if name in run.data_vars}
    if "spatial_reaction_moment" in found:  # a difference of momenta by the length of an interval, which may be short
        found["spatial_reaction_moment"] = found["spatial_reaction_moment"] * np.diff(run.time.values)[:, None]
    found = {prefix + name: few(array, count) for name, array in found.items()}
    return found | {f"{prefix}time": few(run.time.values, 3), f"{prefix}count": np.array(run.sizes["time"])}


def plain(problem, body, start, how):
    return of_run(nt.simulate(body, **start, **how))


def with_events(terminal, problem, body, start, how):
    level = nt.axis_crosses((0.2, 0.3, 1), (1, 0.4, 0.2), name="level", terminal=terminal)
    slow = nt.spin_below(1.5, "y", direction=0, name="slow")
    return of_run(nt.simulate(body, **start, **how, events=[level, slow]), count=4)


def interrupted(problem, body, start, how):
    """The end of a run that was interrupted once, wherever the package has then stopped, and continued."""
    middle, calls = how["t_end"] - 1.44, []

    def interrupting(t, d, w):
        if t > middle and not calls:
            calls.append(t)
            raise KeyboardInterrupt
        return 0.1 * w[1], 0.0, -0.1 * w[0]

    how = how | {"load": how["load"] + nt.moment(interrupting)}
    try:
        nt.simulate(body, **start, **how)
    except nt.errors.SimulationInterrupt as stop:
        run = stop.partial
    if "times" in how:
        how = how | {"times": how["times"][how["times"] > max(run.time, default=-1)]}
    rest = nt.simulate(body, start=run, project=True, **how)
    names = ("quaternion", "material_angular_velocity", "kinetic_energy")
    return {name: rest[name].values[-1] for name in names}


def continued(problem, body, start, how):
    step = how.get("step", 0.1)
    middle = how["t_end"] - step * round(SPAN / 2 / step)
    first, second = how | {"t_end": middle}, how
    if "times" in how:
        before = how["times"] <= middle
        first, second = first | {"times": how["times"][before]}, how | {"times": how["times"][~before]}
    run = nt.simulate(body, **start, **first)
    return of_run(run, "first ", 3) | of_run(nt.simulate(body, start=run, project=True, **second), "then ", 3)


def many(count, body, start):
    """Return bodies and starts of an ensemble, and the scales of its load."""
    bodies = [BODIES[body](c) for c in np.linspace(1, 1.3, count)]
    key = next((name for name in start if name.endswith("angular_velocity")), None)
    rows = {key: np.linspace(1, 0.8, count)[:, None] * start[key]} if key else {}
    return bodies, start | rows, 1 + 0.05 * (8 - np.arange(count))


def statistics(problem, body, start, how):
    bodies, start, scale = many(3, problem.body, start)
    reduce = ["drift", "extrema", "averages", "total_twist"]
    ensemble = {"load_scale": scale, "reduce": reduce, "variables": ()}
    run = nt.simulate_ensemble(nt.DirectorSystem.stack(bodies), **start, **how, **ensemble)
    names = [name for name in run.data_vars if name.endswith(("_drift", "_min", "_max", "_mean", "_twist", "status"))]
    return {name: run[name].values for name in names}


def members(problem, body, start, how):
    """The members of two groups of lanes; member 8, whose load has the scale 1, has the bits of a run of its own."""
    bodies, rows, scale = many(11, problem.body, start)
    names = ("quaternion", "material_angular_velocity", "kinetic_energy")
    run = nt.simulate_ensemble(nt.DirectorSystem.stack(bodies), **rows, **how, load_scale=scale, variables=names)
    found = {name: run[name].values[[0, 5, 7, 8, 10]][:, [0, -1]] for name in names}
    if "start" not in start:  # which brings what a run remembers
        own = {name: rows[name][8] if name.endswith("velocity") else rows[name] for name in rows}
        alone = nt.simulate(bodies[8], **own, **how)
        found["differing"] = sum(np.sum(run[name].values[8, -1] != alone[name].values[-1]) for name in names)
    return found


def step_by_step(problem, body, start, how):
    loop = nt.stepper(body, how.get("step", 0.1), integrator=how["integrator"], load=how["load"])
    if "t_start" in start:
        start = start | {"time": start.pop("t_start")}
    state, found = loop.reset(**start), []
    for k in range(round(SPAN / how["step"])):
        numbers = [*state.quaternion, *state.material_angular_velocity, state.load_work, state.reaction_moment]
        found.append([state.time, *numbers])
        state = loop.step(body_moment=(0.3 * np.sin(k), 0.1, 0), space_moment=(0, -0.2 * found[-1][5], 0.1))
    return {"states": few(found, 8)}


def call_of(start):
    """Return the arguments of a propagator, and those of a call."""
    made = {name: start[name] for name in ("project", "t_start") if name in start}
    made |= {"t_start": float(start["start"].time[-1])} if "start" in start else {}
    return made, {name: value for name, value in start.items() if name not in made}


def prepared(problem, body, start, how):
    made, call = call_of(start)
    run = nt.propagator(body, **made, **how)
    return of_run(run(**call), "first ", 2) | of_run(run(**call, load_scale=0.6), "then ", 3)


def jacobian(problem, body, start, how):
    made, call = call_of(start)
    run, found = nt.propagator(body, **made, **how), {}
    for name, more in (("first", {}), ("then", {"load_scale": 0.6})):
        turned, velocity = run.jacobian(**call, **more, wrt=parameters(problem, "principal_inertia"))
        found |= {f"{name} d_rotation": turned[-1], f"{name} d_velocity": velocity[-1]}
    return found


def parameters(problem, *others):
    """Return the names of what a problem is differentiated by."""
    own = [*MORE_OF_BODIES.get(problem.body, []), *(["dead_force"] if "heavy" in problem.body else [])]
    return ["material_angular_velocity", "rotation", *others, *own, *LOADS[problem.load][1].split()]


def sensitivities(problem, body, start, how):
    run = nt.sensitivities(body, **start, **how, wrt=parameters(problem, "inertia"))
    return of_run(run, count=2) | {name: run[name].values[-1] for name in ("d_rotation", "d_material_angular_velocity")}


def gradient(problem, body, start, how):
    n = len(nt.integrate(body, **start, **how).time)
    slopes = np.random.default_rng(1).uniform(-1, 1, (2, n, 3)) / n
    given = {"d_rotation": slopes[0], "d_material_angular_velocity": slopes[1]}
    found = nt.gradient(body, **start, **how, **given, wrt=parameters(problem, "principal_inertia", "duration"))
    return {"gradient": found.gradient.values}


def exponents(problem, body, start, how):
    how = {name: value for name, value in how.items() if name != "store"}
    found = nt.lyapunov(body, **start, **how)
    return {"exponents": found.lyapunov_exponent.values}


WAYS = {
    "run": plain,
    "events": partial(with_events, False),
    "terminal": partial(with_events, 2),
    "interrupted": interrupted,
    "continued": continued,
    "statistics": statistics,
    "members": members,
    "stepper": step_by_step,
    "propagator": prepared,
    "jacobian": jacobian,
    "sensitivities": sensitivities,
    "gradient": gradient,
    "lyapunov": exponents,
}
DIFFERENTIATED = ("jacobian", "sensitivities", "gradient", "lyapunov")


def outcome(problem):
    """Return the arrays of a problem by name, or the name of the error in which it is refused or fails."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            found = WAYS[problem.way](problem, *arguments(problem))
        return {name: np.asarray(array) for name, array in found.items()}
    except (ValueError, nt.errors.SimulationError) as error:
        return type(error).__name__
    except TypeError as error:  # there is no such argument
        if "unexpected keyword argument 'times'" not in str(error):
            raise
        return "TypeError"


def factors():
    """Return the names of the choices of every factor."""
    return [list(BODIES), list(LOADS), list(schemes()), list(OUTPUTS), list(STARTS), list(WAYS)]

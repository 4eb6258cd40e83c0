"""Other tools on the same motions: SciPy, heyoka.py, diffrax, Exudyn, MuJoCo.

All but the multibody codes integrate the quaternion form, split at the breakpoints of the load. What they compile or
set up happens before the call that is timed; that call starts from the initial state and returns what the tool gives at
the end, and the attitude is taken from it outside of the timing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import Any

import numpy as np

from .workloads import GRAVITY, Array, J, Workload, attitude, inverse, rates

Call = Callable[[], Any]
TOLERANCES = (1e-2, 1e-15)
STEPS = (64, 2**20)


@dataclass(frozen=True)
class Method:
    """A way to reach t_end: `prepare(setting)` returns what is timed, `attitude` takes Λ from its result."""

    name: str
    prepare: Callable[[float], Call]
    attitude: Callable[[Any], Array]
    settings: tuple[float, float]  # from coarse to fine
    kind: str = "tolerance"  # or "steps"
    own: bool = False


@dataclass(frozen=True)
class Missing:
    """A tool that was not measured, and why."""

    name: str
    reason: str


ABSENT = "not installed"


def peers(w: Workload) -> list[Method | Missing]:
    """Return all tools for a motion."""
    found: list[Method | Missing] = []
    for name, package, make in PEERS:
        if find_spec(package) is None:
            found.append(Missing(name, ABSENT))
            continue
        try:
            found += make(w)
        except NotImplementedError as reason:
            found.append(Missing(name, str(reason)))
    return found


def versions() -> list[str]:
    """Return the tools with their versions, also those that are missing."""
    names = dict.fromkeys(package for _, package, _ in PEERS)
    found = []
    for name in names:
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            found.append(f"{name} (not installed)")
    return found


def initial(w: Workload) -> Array:
    """Return the state (p, W), without W3 for the non-twisting body."""
    return np.array([1.0, 0.0, 0.0, 0.0, *w.velocity])[: size(w)]


def size(w: Workload) -> int:
    """Return the length of the state."""
    return 6 if w.has_axis else 7


def scipy_numpy(w: Workload) -> list[Method]:
    """SciPy with the equations as one writes them with NumPy."""
    K, y0 = inverse(J), initial(w)
    K2, force = np.linalg.inv(J[:2, :2]), w.mass * np.array(GRAVITY)
    centre = np.array(w.centre)

    def turned(p: Array, W: Array) -> Array:
        return 0.5 * np.concatenate([[-p[1:] @ W], p[0] * W + np.cross(p[1:], W)])

    def nontwisting(t: float, y: Array, m0: Array, m1: Array) -> Array:
        return np.concatenate([turned(y[:4], np.append(y[4:], 0.0)), K2 @ (m0 + t * m1)[:2]])

    def free(t: float, y: Array, m0: Array, m1: Array) -> Array:
        p, W = y[:4], y[4:]
        torque = np.cross(J @ W, W)
        if w.mass:
            torque = torque + np.cross(centre, attitude(p).T @ force)
        return np.concatenate([turned(p, W), K @ torque])

    f = nontwisting if w.has_axis else free
    return [Method("SciPy DOP853, NumPy", lambda rtol: _solve_ivp(w, f, y0, rtol), _last, TOLERANCES)]


def scipy_numba(w: Workload) -> list[Method]:
    """SciPy with the equations compiled by Numba."""
    from numba import njit

    f, n, y0 = njit(rates(w), error_model="numpy"), size(w), initial(w)
    if w.has_axis:

        @njit(error_model="numpy")
        def compiled(t, y, m0, m1):  # type: ignore[no-untyped-def]
            return np.array(f(y[0], y[1], y[2], y[3], y[4], y[5], m0[0] + t * m1[0], m0[1] + t * m1[1]))
    else:

        @njit(error_model="numpy")
        def compiled(t, y, m0, m1):  # type: ignore[no-untyped-def]
            m = m0 + t * m1
            return np.array(f(y[0], y[1], y[2], y[3], y[4], y[5], y[6], m[0], m[1], m[2]))

    compiled(0.0, np.zeros(n), np.zeros(3), np.zeros(3))
    return [Method("SciPy DOP853, Numba", lambda rtol: _solve_ivp(w, compiled, y0, rtol), _last, TOLERANCES)]


def _solve_ivp(w: Workload, f: Callable[..., Array], y0: Array, rtol: float) -> Call:
    from scipy.integrate import solve_ivp

    pieces, rtol = w.pieces, max(rtol, 2.3e-14)

    def run() -> Array:
        y = y0
        for t0, t1, m0, m1 in pieces:
            y = solve_ivp(f, (t0, t1), y, "DOP853", rtol=rtol, atol=rtol, args=(m0, m1)).y[:, -1]
        return y

    return run


def _last(y: Array) -> Array:
    return attitude(y)


def heyoka(w: Workload) -> list[Method]:
    """heyoka.py: Taylor series, compiled for each tolerance."""
    return [Method("heyoka.py", lambda tol: heyoka_end(w, tol), _last, TOLERANCES)]


def heyoka_integrator(w: Workload, tol: float, **options: Any) -> Any:
    """Return heyoka's integrator of the quaternion form; its parameters are m0 and m1 where a load acts."""
    import heyoka as hy

    n = size(w)
    y = hy.make_vars(*("p0", "p1", "p2", "p3", "W1", "W2", "W3")[:n])
    m = [hy.par[k] + hy.time * hy.par[n - 4 + k] if w.knots else 0.0 for k in range(n - 4)]
    right = [hy.expression(e) for e in rates(w)(*y, *m)]
    return hy.taylor_adaptive(list(zip(y, right, strict=True)), initial(w), tol=tol, **options)


def heyoka_end(w: Workload, tol: float) -> Call:
    """Return the integration to t_end."""
    ta, y0 = heyoka_integrator(w, tol), initial(w)
    n = size(w) - 4
    pieces = [(t1, np.concatenate([m0[:n], m1[:n]])) for _, t1, m0, m1 in w.pieces]

    def run() -> Array:
        ta.state[:] = y0
        ta.time = 0.0
        if not w.knots:
            ta.propagate_until(w.t_end)
        else:
            for t1, m in pieces:
                ta.pars[:] = m
                ta.propagate_until(t1)
        return np.array(ta.state)

    return run


def heyoka_grid(w: Workload, tol: float, times: Array) -> Call:
    """Return the integration with outputs at `times`, from 0 to t_end: states (k, n)."""
    ta, y0 = heyoka_integrator(w, tol), initial(w)
    grids = [np.unique([t0, *times[(times >= t0) & (times <= t1)], t1]) for t0, t1, *_ in w.pieces]
    n = size(w) - 4
    pieces = [(grid, np.concatenate([m0[:n], m1[:n]])) for grid, (_, _, m0, m1) in zip(grids, w.pieces, strict=True)]

    def run() -> Array:
        ta.state[:] = y0
        ta.time = 0.0
        if not w.knots:
            return ta.propagate_grid(times)[-1]
        found = []
        for grid, m in pieces:
            ta.pars[:] = m
            part = ta.propagate_grid(grid)[-1]
            found.append(part if grid[-1] == w.t_end else part[:-1])
        return np.concatenate(found)

    return run


def diffrax(w: Workload) -> list[Method]:
    """Integrate with diffrax: compiled once, the tolerance is an argument."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import diffrax as dx
    import jax.numpy as jnp

    f, n, y0 = rates(w), size(w), jnp.asarray(initial(w))
    pieces = [(t0, t1, jnp.asarray(m0[: n - 4]), jnp.asarray(m1[: n - 4])) for t0, t1, m0, m1 in w.pieces]

    def field(t: Any, y: Any, moment: Any) -> Any:
        m = moment[0] + t * moment[1]
        return jnp.stack(jnp.broadcast_arrays(*f(*y, *m)))

    def make(solver: Any) -> Callable[[float], Call]:
        @jax.jit
        def end(y: Any, tol: Any) -> Any:
            control = dx.PIDController(rtol=tol, atol=tol)
            for t0, t1, m0, m1 in pieces:
                term = dx.ODETerm(field)
                solution = dx.diffeqsolve(
                    term, solver, t0, t1, None, y, (m0, m1), stepsize_controller=control, max_steps=10**6
                )
                y = solution.ys[-1]
            return y

        def prepare(tol: float) -> Call:
            tolerance = jnp.asarray(tol)
            return lambda: end(y0, tolerance).block_until_ready()

        return prepare

    fine = (TOLERANCES[0], 1e-14)
    return [
        Method("diffrax Tsit5", make(dx.Tsit5()), _last, fine),
        Method("diffrax Dopri8", make(dx.Dopri8()), _last, fine),
    ]


def exudyn(w: Workload) -> list[Method]:
    """Exudyn: generalised-alpha and the explicit Lie-group Runge–Kutta method RK44, fixed steps."""
    if w.key != "C":
        raise NotImplementedError("no non-twisting body" if w.has_axis else "explicit only without a joint")
    import exudyn as exu

    types = exu.DynamicSolverType
    return [
        Method("Exudyn generalised-α", lambda n: _exudyn(w, n, types.GeneralizedAlpha), _as_given, STEPS, "steps"),
        Method("Exudyn RK44", lambda n: _exudyn(w, n, types.RK44), _as_given, STEPS, "steps"),
    ]


def _exudyn(w: Workload, steps: float, solver: Any) -> Call:
    import exudyn as exu
    import exudyn.itemInterface

    items = exudyn.itemInterface
    system = exu.SystemContainer().AddSystem()
    node = system.AddNode(
        items.NodeRigidBodyRotVecLG(
            referenceCoordinates=[0.0] * 6, initialCoordinates=[0.0] * 6, initialVelocities=[0.0, 0.0, 0.0, *w.velocity]
        )
    )
    inertia = [J[0, 0], J[1, 1], J[2, 2], J[1, 2], J[0, 2], J[0, 1]]
    system.AddObject(items.ObjectRigidBody(physicsMass=1.0, physicsInertia=inertia, nodeNumber=node))
    system.Assemble()
    settings = exu.SimulationSettings()
    time = settings.timeIntegration
    time.numberOfSteps, time.endTime, time.automaticStepSize, time.adaptiveStep = int(steps), w.t_end, False, False
    time.verboseMode = settings.displayStatistics = settings.displayComputationTime = 0
    time.newton.relativeTolerance = 1e-10
    time.generalizedAlpha.spectralRadius = 1.0
    time.generalizedAlpha.computeInitialAccelerations = True
    settings.solutionSettings.writeSolutionToFile = False
    settings.solutionSettings.sensorsWriteFileHeader = settings.solutionSettings.sensorsWriteFileFooter = False

    def run() -> Array:
        system.SolveDynamic(settings, solverType=solver, updateInitialValues=False, storeSolver=False)
        return system.GetNodeOutput(node, exu.OutputVariableType.RotationMatrix)

    return run


def _as_given(R: Array) -> Array:
    return np.asarray(R).reshape(3, 3)


def mujoco(w: Workload) -> list[Method]:
    """Integrate with MuJoCo's RK4: a body on a ball joint, fixed steps."""
    if w.has_axis:
        raise NotImplementedError("no non-twisting body")
    return [Method("MuJoCo RK4", lambda n: _mujoco(w, n), _last, STEPS, "steps")]


def _mujoco(w: Workload, steps: float) -> Call:
    import mujoco

    mass, centre = w.mass or 1.0, np.array(w.centre)
    inertia = J - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))  # about the centre of mass
    full = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    numbers = " ".join(f"{x:.17g}" for x in full)
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option integrator="RK4" timestep="{w.t_end / int(steps):.17g}"
        gravity="0 0 {GRAVITY[2] if w.mass else 0}"><flag contact="disable" constraint="disable"/></option>
        <compiler balanceinertia="false"/>
        <worldbody><body><joint type="ball"/><inertial pos="{" ".join(map(str, w.centre))}" mass="{mass}"
        fullinertia="{numbers}"/></body></worldbody></mujoco>"""
    )
    data, velocity, count = mujoco.MjData(model), np.array(w.velocity), int(steps)

    def run() -> Array:
        mujoco.mj_resetData(model, data)
        data.qvel[:] = velocity
        mujoco.mj_step(model, data, count)
        return np.array(data.qpos)

    return run


def numbalsoda(w: Workload) -> list[Method]:
    """LSODA on a right-hand side compiled by Numba."""
    from numba import cfunc
    from numba import njit as jit
    from numbalsoda import lsoda, lsoda_sig

    f, n, y0 = jit(rates(w), error_model="numpy"), size(w), initial(w)
    if w.has_axis:

        @cfunc(lsoda_sig)
        def right(t, y, dy, m):  # type: ignore[no-untyped-def]
            r = f(y[0], y[1], y[2], y[3], y[4], y[5], m[0] + t * m[3], m[1] + t * m[4])
            for k in range(n):
                dy[k] = r[k]
    else:

        @cfunc(lsoda_sig)
        def right(t, y, dy, m):  # type: ignore[no-untyped-def]
            r = f(y[0], y[1], y[2], y[3], y[4], y[5], y[6], m[0] + t * m[3], m[1] + t * m[4], m[2] + t * m[5])
            for k in range(n):
                dy[k] = r[k]

    pieces = [(np.array([t0, t1]), np.concatenate([m0, m1])) for t0, t1, m0, m1 in w.pieces]

    def prepare(tol: float) -> Call:
        def run() -> Array:
            y = y0
            for times, m in pieces:
                y = lsoda(right.address, y, times, m, rtol=tol, atol=tol)[0][-1]
            return y

        return run

    return [Method("numbalsoda LSODA", prepare, _last, TOLERANCES)]


# Name, package that must be there, how it is set up.
PEERS: tuple[tuple[str, str, Callable[[Workload], list[Method]]], ...] = (
    ("SciPy DOP853, NumPy", "scipy", scipy_numpy),
    ("SciPy DOP853, Numba", "numba", scipy_numba),
    ("numbalsoda LSODA", "numbalsoda", numbalsoda),
    ("heyoka.py", "heyoka", heyoka),
    ("diffrax Tsit5, Dopri8", "diffrax", diffrax),
    ("Exudyn generalised-α, RK44", "exudyn", exudyn),
    ("MuJoCo RK4", "mujoco", mujoco),
)

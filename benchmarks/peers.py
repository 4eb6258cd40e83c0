"""Other tools on the same motions: SciPy, heyoka.py, diffrax, Exudyn, MuJoCo.

All but the multibody codes integrate the quaternion form, split at the breakpoints of the load. What they compile or
set up happens before the call that is timed; that call starts from the initial state and returns what the tool gives at
the end, and the attitude is taken from it outside of the timing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from .workloads import GRAVITY, Array, J, Workload, attitude, rates

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


def peers(w: Workload) -> list[Method]:
    """Return all tools for a motion that are installed and can have it."""
    return [method for package, make in PEERS if find_spec(package) for method in make(w)]


def initial(w: Workload) -> Array:
    """Return the state (p, W), without W3 for the non-twisting body."""
    return np.array([1.0, 0.0, 0.0, 0.0, *w.velocity])[: size(w)]


def size(w: Workload) -> int:
    """Return the length of the state."""
    return 6 if w.has_axis else 7


def scipy(w: Workload) -> list[Method]:
    """SciPy with the equations on numbers of Python."""
    return [Method("SciPy DOP853", lambda rtol: _solve_ivp(w, rates(w), rtol), _last, TOLERANCES)]


def _solve_ivp(w: Workload, rates: Callable[..., Any], rtol: float) -> Call:
    from scipy.integrate import solve_ivp

    pieces, rtol, n, y0 = w.pieces, max(rtol, 2.3e-14), size(w) - 4, initial(w)

    def f(t: float, y: Array, m0: Array, m1: Array) -> Any:
        return rates(*y.tolist(), *(m0 + t * m1)[:n].tolist())

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
    """Return the integration to t_end: the last state."""
    ta, y0, n = heyoka_integrator(w, tol), initial(w), size(w) - 4
    pieces = [(t1, np.concatenate([m0[:n], m1[:n]])) for _, t1, m0, m1 in w.pieces]

    def run() -> Array:
        ta.state[:] = y0
        ta.time = 0.0
        for t1, m in pieces:
            if w.knots:
                ta.pars[:] = m
            ta.propagate_until(t1)
        return np.array(ta.state)

    return run


def heyoka_grid(w: Workload, tol: float, times: Array) -> Call:
    """Return the integration with outputs at `times`, from 0 to t_end: states (k, n)."""
    ta, y0, n = heyoka_integrator(w, tol), initial(w), size(w) - 4
    pieces = [
        (np.unique([t0, *times[(times >= t0) & (times <= t1)], t1]), np.concatenate([m0[:n], m1[:n]]))
        for t0, t1, m0, m1 in w.pieces
    ]

    def run() -> Array:
        ta.state[:] = y0
        ta.time = 0.0
        found = []
        for grid, m in pieces:
            if w.knots:
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

    @jax.jit
    def end(y: Any, tol: Any) -> Any:
        control = dx.PIDController(rtol=tol, atol=tol)
        for t0, t1, m0, m1 in pieces:
            how = {"stepsize_controller": control, "max_steps": 10**6}
            y = dx.diffeqsolve(dx.ODETerm(field), dx.Dopri8(), t0, t1, None, y, (m0, m1), **how).ys[-1]
        return y

    def prepare(tol: float) -> Call:
        tolerance = jnp.asarray(tol)
        return lambda: end(y0, tolerance).block_until_ready()

    return [Method("diffrax Dopri8", prepare, _last, (TOLERANCES[0], 1e-14))]


def exudyn(w: Workload) -> list[Method]:
    """Exudyn: generalised-alpha and the explicit Lie-group Runge–Kutta method RK44, fixed steps."""
    if w.key != "C":  # no non-twisting body, and explicit only without a joint
        return []
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
        return []
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


PEERS: tuple[tuple[str, Callable[[Workload], list[Method]]], ...] = (  # package that must be there, how it is set up
    ("scipy", scipy),
    ("heyoka", heyoka),
    ("diffrax", diffrax),
    ("exudyn", exudyn),
    ("mujoco", mujoco),
)

"""`stepper`: a body step by step, under moments that are chosen at every step.

The step of a stepper that its kernels do not take: a run of one step, with all that a run does.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan, sqrt
from typing import Any, NamedTuple, Never

import numpy as np
from numpy.typing import ArrayLike

from ..errors import warn
from ..geometry.arrays import Array, Rotation, as_array, as_floats, as_number, as_positive, vector
from ..geometry.values import hinted, short_repr, unknown_keyword
from ..integrators import INTEGRATORS, IVP, Integrator, SimulationError, Status
from ..integrators.compiled import Compiled
from ..integrators.integrator import Failure
from ..integrators.ivp import segmented
from ..integrators.load_samples import COMMANDED, commanded, wheel_columns
from ..integrators.marched_stacks import ENDS, NUMBERS, Numbers, SingleStep, Vector, Wheels
from ..loads import Load, Term, as_load
from ..loads.load import of_body
from ..loads.memory_terms import Column
from ..loads.terms import Table
from ..models.stack import stacked
from ..models.system import DirectorSystem, as_system
from . import completion
from .completion import OVERFLOW
from .contacts import refusal
from .grid import NODES_APART
from .notices import coarseness, failure_message, say, warn_of_cost
from .planning import internal_states, planned, resolve_integrator
from .problem import STARTS, OfLoop, OfStart, Problem, keywords_of, posed
from .single_run import whole_of
from .starts import AT_REST, BodyState, starts, wheel_axes_of


class MarchedStep:
    """The step of a body under dry friction, or with wheels that have friction: a run of one step."""

    def __init__(self, system: DirectorSystem, load: Load, step: float, scheme: Compiled) -> None:
        self.step, self.scheme = step, scheme
        self._failure: Failure | None = None
        self.stack = IVP(stacked(system), np.eye(4)[3:], np.zeros((1, 3)), load, 0.0, step, 1, ENDS, intervals=True)
        if (reason := refusal(scheme, self.stack)) is not None:
            raise ValueError(reason)
        self._own, self._load = sum(one.count for one in load.wheels), commanded(load)

    def begin(self, problem: IVP) -> Numbers:
        """Return the numbers at the start of a problem, as `SingleStep` does."""
        z = [] if problem.internal is None else problem.internal[0, self._own :].tolist()
        return self._numbers(problem.quaternion[0], problem.velocity[0], 0.0, 0.0, z, 0.0)

    def __call__(
        self,
        numbers: Numbers,
        start: float,
        number: int,
        body: Vector,
        space: Vector,
        wheels: tuple[Wheels, Array] | None,
    ) -> tuple[Numbers, Wheels]:
        """Take a step, as `SingleStep` does."""
        t, h, load = start + number * self.step, self.step, self._load
        own, torques = wheels or ((), np.zeros(0))
        z = [x for one, torque in zip(own, torques.tolist(), strict=True) for x in (*one, torque)]
        z += numbers[NUMBERS.march_state : (NUMBERS.march_state + len(numbers)) // 2]
        around, frames = np.array([t - h, t + 2 * h]), ("body", "space")
        for frame, moment in zip(frames, (body, space), strict=True):
            if any(moment):
                load = load + Table(frame, around, np.array([moment, moment]))  # type: ignore[arg-type]
        begin: dict[str, Any] = {"quaternion": np.array([numbers[:4]]), "velocity": np.array([numbers[4:7]])}
        begin |= {"internal": np.array([z]) if z else None, "t_start": t, "t_end": t + h}
        outcome = completion.checked_march(self.scheme, replace(self.stack, load=load, **begin))
        self._failure = (found := outcome.failure()) and found._replace(step=number)
        end, means = outcome.states.part(0, -1), outcome.intervals
        assert means is not None
        z = [] if end.internal is None else end.internal.tolist()
        ends = tuple(tuple(z[COMMANDED * k :][:3]) for k in range(len(own)))
        mu = float(means.multipliers[0, 0, -1]) if self.stack.systems.axis is not None else 0.0
        work, rest = float(means.load_work[0, 0]), z[COMMANDED * len(own) :]
        status = self._failure.status if self._failure else Status.OK
        return self._numbers(end.quaternion, end.velocity, mu, work, rest, status), ends

    @staticmethod
    def _numbers(p: Array, W: Array, mu: float, work: float, z: list[float], status: float) -> Numbers:
        return (*p.tolist(), *W.tolist(), mu, work, *z, *(0.0 for _ in z), float(status))

    def failure(self, number: int) -> Failure | None:
        """Return why the step just taken failed, None where it did not."""
        return self._failure


ZERO: Vector = (0.0, 0.0, 0.0)
NONE = ()
ASIDE = (*STARTS, "t_start", "t_end", "tolerance", "times", "store")  # of a problem: times and output


@hinted
def stepper(
    system: DirectorSystem | Problem,
    step: float | None = None,
    *,
    integrator: str | Integrator | None = None,
    order: int | None = None,
    load: Load | Term | None = None,
) -> Stepper:
    """Return a body that is integrated step by step, under moments chosen at every step: for closed loops.

    It starts at rest at the identity and t = 0, or as a problem does; `Stepper.reset` sets another start.

    Parameters
    ----------
    system : DirectorSystem or Problem
        The body: `standard`, `nontwisting`, `suslov`, `heavy_top`, `with_gravity`; or a problem, of which times and
        output are not used.
    step : float, s
        Length of all steps; by default that of the problem.
    integrator : str or Integrator
        "lie-midpoint", "gauss" or "energy-momentum", or an instance of these; by default that of the problem, or
        "lie-midpoint": the moments of a controller jump from step to step, and its step is the cheapest.
    order : int, optional
        2 by default for every integrator: a steady turn by θ a step then lags by θ³/12 a step, at 0.1 rad by 5° after
        1000 steps. `gauss` has higher orders; of order 4 it is θ⁵/720.
    load : Load, optional
        What acts in addition to the moments of each step: disturbances, damping, functions of the state, wheels. Under
        dry friction, of the body or of a wheel, a step takes some milliseconds, with several wheels tens of them.

    Returns
    -------
    Stepper

    Raises
    ------
    ValueError
        An argument is invalid; the message names it.

    Warns
    -----
    UserWarning
        A load is a Python function of the state, which costs about 0.1 ms per step.

    Examples
    --------
    A controller damps a tumbling body:

    >>> from nontwist import standard, stepper
    >>> loop = stepper(standard([3, 4, 5]), 0.01)
    >>> state = loop.reset(material_angular_velocity=(1, 2, 0.5))
    >>> while state.time < 10:
    ...     state = loop.step(body_moment=[-2 * W for W in state.material_angular_velocity])
    >>> max(abs(W) for W in state.material_angular_velocity) < 0.05
    True
    """
    own = {"step": step, "integrator": integrator, "order": order, "load": load}
    changes = {name: value for name, value in own.items() if value is not None}
    problem = posed("stepper", system, changes, OfLoop, aside=ASIDE)
    integrator, order = problem.given.get("integrator", "lie-midpoint"), problem.order
    if problem.step is None:
        raise ValueError("give step=, the length of all steps")
    body, h, load = as_system(problem.system), float(as_positive(problem.step, "step", (), "s")), as_load(problem.load)
    scheme = resolve_integrator(integrator, order)
    if not (isinstance(scheme, Compiled) and _takes_steps(type(scheme))):
        *names, last = (name for name, kind in INTEGRATORS.items() if _takes_steps(kind))
        raise ValueError(f"a stepper supports the integrators {', '.join(names)} and {last}, got {scheme.name}")
    scheme.require_memory(load)
    if order is None and isinstance(integrator, str):
        scheme = replace(scheme, order=2)
    warn_of_cost(load)
    loop, plan = Stepper(body, h, scheme, of_body(load, body.inertia)), planned(body, load, scheme, t_end=h, step=h)
    say([plan.remark(AT_REST, whole_of(plan, segmented((0.0, h), (1,))))])
    if isinstance(system, Problem):
        loop.reset(**keywords_of(problem, OfStart), time=problem.t_start)
    return loop


class Kind(NamedTuple):
    """What two steppers must have in common to exchange states."""

    integrator: Compiled
    step: float
    inertia: bytes
    axis: bytes | None
    wheels: tuple[tuple[float, ...], ...]  # inertia and axis of each
    internal: int  # internal states of the load but for wheels
    carried: int  # those and what the numbers have of wheels


def _takes_steps(kind: type[Integrator]) -> bool:
    """Whether an integrator is made of compiled steps, under a moment as without."""
    return kind.march is Compiled.march and not kind.is_exact_without_load


class StepperState(BodyState):
    """The state of a body between two steps. Later steps of its `Stepper` do not change it.

    Its time is the start time plus the number of steps since the last reset times their length.

    All numbers are floats or tuples of floats, but for the array of the directors. States compare equal if all their
    numbers do, and can be pickled.

    Examples
    --------
    >>> from nontwist import standard, stepper
    >>> state = stepper(standard([3, 4, 5]), 0.01).step(body_moment=(0, 0, 1))
    >>> state
    <StepperState: t = 0.01 s, quaternion (0, 0, 5e−06, 1), W (0, 0, 0.002) rad/s>
    >>> state.time, state.rotation.as_rotvec().round(7)
    (0.01, array([0.e+00, 0.e+00, 1.e-05]))
    """

    __slots__ = ("_kind", "_start", "_steps")
    _kind: Kind
    _start: float
    _steps: int

    @property
    def steps(self) -> int:
        """Number of steps since the last reset."""
        return self._steps

    @property
    def internal_state(self) -> tuple[float, ...]:
        """The internal states z of loads with memory but for wheels, one behind the other; none: ()."""
        end = len(self._numbers) - 1 - self._kind.carried  # they end with z, that of wheels first, and its round-off
        return self._numbers[end - self._kind.internal : end]

    @property
    def _carried(self) -> tuple[tuple[float, ...], tuple[Column, ...]]:
        wheels = (Column(np.array(n), I, 3 * k, True, True, False) for k, (I, *n) in enumerate(self._axes))
        return (*(x for one in self._wheels for x in one), *self.internal_state), tuple(wheels)

    @property
    def wheel_work(self) -> tuple[float, ...]:
        """Work of the motor of each wheel since the last reset, or since the start of the run that it continues, J."""
        return tuple(one[1] for one in self._wheels)

    @property
    def wheel_loss(self) -> tuple[float, ...]:
        """Energy that friction of each wheel has taken since then, J."""
        return tuple(one[2] for one in self._wheels)

    @property
    def load_work(self) -> float:
        """Work of the moments and the load over the last step, J; 0 after a reset."""
        return self._numbers[NUMBERS.work]

    @property
    def reaction_moment(self) -> float:
        """Mean moment of the constraint about its axis over the last step, N m; 0 without a constraint."""
        mu: float = self._numbers[NUMBERS.mu]
        return 0.0 if self._kind.axis is None else 0.0 - mu

    def __eq__(self, other: object) -> bool:
        return isinstance(other, StepperState) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def _key(self) -> tuple[Any, ...]:
        return self._kind, self._numbers, self._wheels, self._start, self._steps


class Stepper:
    """A body that is integrated step by step, returned by `stepper`.

    Each stepper has its own workspace: any number of steppers can run at the same time, each in one thread. A copy, by
    `copy.copy` or through a pickle, is an independent stepper in the same state.

    Constant moments M and m give, bit for bit, the states of `integrate` with the same step, integrator and order and
    the load ``body_moment(lambda t: M) + space_moment(lambda t: m)``. Both terms must be given there, even if one is
    zero.

    Attributes
    ----------
    system : DirectorSystem
    integrator : Integrator
    step_size : float, s
    load : Load
        What acts in addition to the moments of each step.

    Examples
    --------
    Predict the effect of each of three moments, then choose the best:

    >>> from nontwist import nontwisting, stepper
    >>> body = stepper(nontwisting([3, 4, 5]), 0.05)
    >>> def ahead(moment, steps=20):
    ...     now = body.state
    ...     for _ in range(steps):
    ...         body.step(space_moment=moment)
    ...     reached, body.state = body.state, now
    ...     return reached.rotation.magnitude()
    >>> best = max([(1, 0, 0), (0, 1, 0), (0, 0, 1)], key=ahead)
    >>> best, body.time
    ((1, 0, 0), 0.0)
    """

    def __init__(self, system: DirectorSystem, step: float, integrator: Compiled, load: Load) -> None:
        self.system, self.integrator, self.step_size, self.load = system, integrator, step, load
        axis = None if system.axis is None else system.axis.tobytes()
        self._single: Any = (MarchedStep if load.is_dry else SingleStep)(system, load, step, integrator)
        self._wheels = load.wheels
        count = load.internal_state.size - sum(one.count for one in load.wheels)
        held = 0 if load.is_dry else COMMANDED * sum(not one.is_driven for one in load.wheels)
        self._axes = wheel_axes_of(load)
        self._kind = Kind(integrator, step, system.euler_inertia.tobytes(), axis, self._axes, count, held + count)
        self._steps_now, self._unremarkable = False, (integrator.largest_turn / step) ** 2
        self.reset()

    @hinted
    def reset(
        self,
        *,
        rotation: Any = None,
        scalar_first: bool | None = None,
        material_angular_velocity: ArrayLike | None = None,
        angular_velocity: ArrayLike | None = None,
        time: float | None = None,
        start: Any = None,
        project: bool = False,
    ) -> StepperState:
        """Set a new initial state and return it.

        Parameters
        ----------
        rotation, scalar_first, material_angular_velocity, angular_velocity
            As in `simulate`: by default the identity, at rest.
        time : float, s, optional
            By default 0, or the end of `start`.
        start : Dataset, Trajectory or BodyState, optional
            Continue from the last state of a run, or from a state, as in `simulate`.
        project : bool
            Remove an initial spin about the constrained axis instead of refusing it.

        Returns
        -------
        StepperState

        Raises
        ------
        ValueError
            An argument is invalid; the message names it, and the state is unchanged.

        Warns
        -----
        InputWarning
            `start` is of another inertia or other wheels, or has no velocities.
        """
        W, is_own = material_angular_velocity, isinstance(start, StepperState) and start._kind == self._kind
        begin = starts(
            self.system,
            start,
            rotation,
            scalar_first,
            W,
            angular_velocity,
            1.0,
            project or is_own,
            time,
            load=self.load,
        )
        t = as_number(time, "time") if time is not None else begin.time or 0.0
        h, resolution = self.step_size, float(np.spacing(abs(t)))
        if h < NODES_APART * resolution:
            raise ValueError(
                f"time = {t:.12g} s is resolved to {resolution:.2g} s, which is too coarse for steps of {h:g} s; "
                "count times from a start at 0"
            )
        systems, p, V, N = stacked(self.system), *begin[:3]
        problem = IVP(systems, p, V, Load(), t, t + h, 1, ENDS, normal=N, memory=begin.memory)
        internal = internal_states(systems, self.load, begin, t)
        numbers = self._single.begin(replace(problem, internal=internal))
        if is_own:  # of which everything is known that a step carries on
            numbers = (*start._numbers[: NUMBERS.mu], 0.0, 0.0, *start._numbers[NUMBERS.march_state :])
        wheels = [] if internal is None else [internal[0, k:][: one.count] for one, k in wheel_columns(self.load)]
        self._state = self._made(numbers, t, 0, tuple((*own.tolist(), 0.0, 0.0)[:3] for own in wheels))
        return self._state

    def step(
        self,
        body_moment: ArrayLike = ZERO,
        space_moment: ArrayLike = ZERO,
        wheel_torque: ArrayLike = NONE,
        **unknown: Never,
    ) -> StepperState:
        """Take one step under moments that are constant over it, and return the state at its end.

        Parameters
        ----------
        body_moment : (3,) array, N m
            Components along the directors: a moment that rotates with the body, such as that of thrusters and motors.
        space_moment : (3,) array, N m
            Components along the axes of space.
        wheel_torque : (k,) array, or a number for one wheel, N m
            Torque of the motor on each wheel of the load about its axis, beside that of the load; 0 by default.

        Returns
        -------
        StepperState

        Raises
        ------
        ValueError
            A moment does not consist of 3 finite numbers, or `wheel_torque` not of a number for each wheel.
        SimulationError
            The step fails: the body would turn by more than half a turn, the load fails, or a number is not finite. The
            state is unchanged; `partial` of the error is None.
        RuntimeError
            A step of this stepper is being taken, in another thread or by a load.

        Warns
        -----
        UserWarning
            The body turns by more than a step resolves; once.

        Notes
        -----
        The moments add to the dead forces of the body and to the load of the stepper. They are processed fastest as
        tuples, lists or arrays of floats.
        """
        if unknown:  # at a tenth of the cost of `hinted`
            known = ("body_moment", "space_moment", "wheel_torque")
            raise unknown_keyword("Stepper.step", next(iter(unknown)), known) from None
        body, space = vector(body_moment, "body_moment"), vector(space_moment, "space_moment")
        if self._steps_now:
            raise RuntimeError("this stepper is taking a step: each thread needs one of its own, a copy.copy of it")
        self._steps_now = True  # nothing lies between: the interpreter changes threads at calls
        try:
            now = self._state
            k = now._steps
            has_torque = wheel_torque is not NONE and np.size(wheel_torque)
            wheels = (now._wheels, self._torques(wheel_torque)) if self._wheels or has_torque else None
            try:
                numbers, ends = self._single(now._numbers, now._start, k, body, space, wheels)
            except ValueError as error:
                raise self._error(Failure(Status.LOAD, k, nan, nan, error)) from error
            if numbers[-1] or not -inf < numbers[NUMBERS.work] < inf:
                failure = self._single.failure(k)
                failure = failure or Failure(Status.NOT_FINITE, k, nan, nan, OVERFLOW.format("load_work"))
                raise self._error(failure) from failure.cause
            self._state = state = self._made(numbers, now._start, k + 1, ends)
            x, y, z = numbers[4:7]
            if (square := x * x + y * y + z * z) > self._unremarkable:
                self._unremarkable = inf  # it is said once
                if (text := coarseness(self.integrator, self._single.stack, sqrt(square), "")) is not None:
                    warn(text)
            return state
        finally:
            self._steps_now = False

    def _torques(self, torque: ArrayLike) -> Array:
        """Return the torque on each wheel."""
        count = len(self._wheels)
        own = as_array(as_floats(torque, "wheel_torque", 1), "wheel_torque", (None,))
        if own.size and not count:
            raise ValueError("wheel_torque needs wheels, and the load has none: load=wheel(axis, inertia)")
        if own.size not in (0, count):
            raise ValueError(f"wheel_torque needs a number for each wheel, {count}, got {own.size}")
        return own if own.size else np.zeros(count)

    @property
    def state(self) -> StepperState:
        """The current state. Set it to return to an earlier state of this stepper, or of one of the same kind.

        A stepper of the same kind has the same integrator, order and step, a body of the same inertia and axis, the
        same wheels, and as many internal states. For any other state use `reset`.
        """
        return self._state

    @state.setter
    def state(self, state: StepperState) -> None:
        if not isinstance(state, StepperState):
            raise ValueError(
                f"state must be a state of a stepper, got {short_repr(state)}; use reset(...) for other starts"
            )
        if state._kind != self._kind:
            raise ValueError(
                "state belongs to a stepper with another integrator, order, step, inertia, axis, wheels or memory; "
                "use reset(rotation=state.rotation, material_angular_velocity=state.material_angular_velocity, "
                "time=state.time)"
            )
        self._state = state

    @property
    def time(self) -> float:
        """Time t, s."""
        return self._state._time

    @property
    def rotation(self) -> Rotation:
        """Attitude Λ, body to space, as a `scipy.spatial.transform.Rotation`."""
        return self._state.rotation

    @property
    def material_angular_velocity(self) -> Vector:
        """Angular velocity W in body components, rad/s."""
        return self._state.material_angular_velocity

    def __repr__(self) -> str:
        how = f"{self.integrator.name} of order {self.integrator.order}, step {self.step_size:g} s"
        return f"<Stepper: {self.system!r}, {how}, t = {self.time:.12g} s>"

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (self.system, self.step_size, self.integrator, self.load, self._state)

    def _made(self, numbers: Numbers, start: float, steps: int, wheels: Wheels) -> StepperState:
        state = StepperState.__new__(StepperState)
        state._wheels, state._axes = wheels, self._axes
        state._kind, state._numbers, state._start, state._steps = self._kind, numbers, start, steps
        state._time = start + steps * self.step_size
        return state

    def _error(self, failure: Failure) -> SimulationError:
        now, h = self._state, self.step_size
        start, k = now._start, now._steps
        if failure.status is Status.STALLED:
            z = np.array([now.internal_state]) if now.internal_state else None
            begin: dict[str, Any] = {
                "quaternion": np.array([now._numbers[:4]]),
                "velocity": np.array([now._numbers[4:7]]),
            }
            one = replace(self._single.stack, internal=z, t_start=now.time, t_end=now.time + h, **begin)
            jump = completion.named_jump(self.integrator, one, failure._replace(step=0))
            failure = jump._replace(step=k) if jump else failure
        grid = replace(self._single.stack, t_start=start, t_end=start + (k + 1) * h, steps=k + 1)
        message = failure_message(grid, failure)
        return SimulationError(message, int(failure.status), self._state._time, h, failure.residual)


def _restored(system: DirectorSystem, step: float, integrator: Compiled, load: Load, state: StepperState) -> Stepper:
    """Return a stepper in a state: a copy, or one out of a pickle."""
    one = Stepper(system, step, integrator, load)
    one.state = state
    return one

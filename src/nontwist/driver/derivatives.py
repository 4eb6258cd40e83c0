"""`sensitivities` and `gradient`: what a run would have been, had its start, its body or its load been another."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..analysis.trajectory import Trajectory
from ..analysis.variables import DERIVATIVES, Described, assembled, described, labelled
from ..geometry.arrays import Array, Dataset, as_array
from ..integrators import IVP
from ..integrators.compiled import Compiled
from ..integrators.ivp import Segments, segmented
from ..integrators.linearised_runs import Linearised, scheme_of
from ..integrators.memory_tangents import RememberingSteps, require_derivatives
from ..integrators.tangents import ForwardTangents, PreparedTangents, back, forward
from ..machine import cached_property
from ..models.system import DirectorSystem
from .grid import stored_steps
from .parameters import EVERY, Parameters
from .planning import Plan
from .problem import OfStored, Problem, plan_of, posed, start_of, takes
from .single_run import Prepared, PreparedPlan, integrated
from .starts import AT_REST, Starts


@takes(OfStored)
def sensitivities(
    system: DirectorSystem | Problem,
    *,
    wrt: str | Iterable[str] = EVERY,
    **keywords: Unpack[OfStored],
) -> Dataset:
    """Integrate the motion of a body and its derivatives with respect to the start, the body and the load.

    They are the exact derivatives of the computed run, step by step, on its time grid. They grow as neighbouring
    motions diverge. Functions are differentiated by dual numbers, and those that do not take them, as functions in C
    and of `math`, by central differences; a warning names them.

    Parameters
    ----------
    system : DirectorSystem or Problem
        The body: `standard`, `nontwisting`, `suslov`, `heavy_top`, `with_gravity`; or a whole problem.
    wrt : str or list of str
        With respect to what to differentiate: "material_angular_velocity" and "rotation" of the start, the latter as a
        rotation vector in the body, with the velocity in the body unchanged; "inertia", the entries 11, 22, 33, 23, 13,
        12 of J, where one off the diagonal stands for both, or "principal_inertia", the principal moments with their
        axes held fixed, in ascending order, or in that of a diagonal J; "axis", the constrained one; "dead_force";
        "spin"; "duration", for which the last segment of the grid is lengthened with the same number of steps;
        "load_scale"; and the parameters of the terms of the load: "pulse" and "sine", their peaks; "frequency";
        "phase"; "values" of tables (of forces along the directors those of their moment, but with "energy-momentum")
        and of momenta of rotors; "rotor", the axis of one; "damping", the entries of its matrix; "linear" and
        "quadratic", the coefficients of a potential; "stiffness" and "rest_length" of a spring; "mean_motion" and
        "eccentricity" of a gravity gradient; "speed", "torque" (of a table, a constant added to it from its first time
        to its last), "viscous" and "wheel", the axis, of wheels, and ``"load[1].inertia"``; fields of loads of your
        own. ``"load[1].values"`` selects those of the second term alone, ``"load[1].scale"`` its factor. Axes are
        vectors of length 1, however long those given are. For a body with a constrained axis only the admissible part
        of a change counts: the part of a velocity orthogonal to the axis, and the part of a change of the axis
        orthogonal to the axis.
        Under loads with memory, friction of wheels among them, only the start, the inertia and these fields of wheels
        count; beside springs and potentials that are functions with `gauss` alone. Where the torque of a wheel is a
        table, there are none by the duration, its factor and its axis; with wheels none by "axis" and "spin".
    t_end, step, tolerance, t_start, start, rotation, scalar_first, material_angular_velocity
        As in `simulate`.
    angular_velocity, load, integrator, order, store, project
        As in `simulate`. "gauss", "lie-midpoint" and "energy-momentum" have derivatives.

    Returns
    -------
    xarray.Dataset
        The run, with two more variables on `parameter`: ``d_rotation`` (time, axis, parameter), the rotation vector in
        the body by which the attitude changes, rad per unit of the parameter, and ``d_material_angular_velocity``
        (time, director, parameter), rad/s per unit. The coordinate `parameter_unit` contains the units.

    Raises
    ------
    ValueError
        An argument is invalid, a parameter is unknown, or the integrator or the load has no derivatives.
    SimulationError, SimulationInterrupt
        As `simulate`.

    Warns
    -----
    UserWarning
        As `simulate`; or a function is differentiated by differences.

    Examples
    --------
    How the attitude after 1 s depends on the moment J2:

    >>> from nontwist import sensitivities, standard
    >>> start = {"material_angular_velocity": (0.1, 2, 0)}
    >>> d = sensitivities(standard([3, 4, 5]), t_end=1, wrt=["principal_inertia", "rotation"], **start)
    >>> d.d_rotation.sel(parameter="principal_inertia[2]").values[-1].round(4)
    array([ 0.0111, -0.0008, -0.0145])
    >>> d.parameter.values.tolist()[:3]
    ['principal_inertia[1]', 'principal_inertia[2]', 'principal_inertia[3]']
    """
    problem = posed("sensitivities", system, keywords, OfStored)
    begin = start_of(problem)
    plan = plan_of(problem, begin)
    solved = Solved(plan, begin, wrt, means=plan.store == 1)
    changes = solved.changes()
    more = described(dict(zip(DERIVATIVES, (changes[:, :3], changes[:, 3:]), strict=True)))
    more |= _units(solved.parameters)
    return _stored(solved, plan, begin)._dataset(more, parameter=solved.parameters.labels)


@takes(OfStored)
def gradient(
    system: DirectorSystem | Problem,
    *,
    d_rotation: ArrayLike | None = None,
    d_material_angular_velocity: ArrayLike | None = None,
    wrt: str | Iterable[str] = EVERY,
    **keywords: Unpack[OfStored],
) -> Dataset:
    """Return the derivatives of a function of the stored states of a run with respect to all parameters at once.

    The function f is given by its derivatives at the states of the run, which is integrated again. The cost does not
    depend on the number of parameters (discrete adjoint).

    Parameters
    ----------
    system : DirectorSystem or Problem
        The body: `standard`, `nontwisting`, `suslov`, `heavy_top`, `with_gravity`; or a whole problem.
    d_rotation : (n, 3) array, optional
        Derivatives of f with respect to the attitudes at the n stored times, as rotation vectors in the body: a small
        rotation δ of an attitude changes f by the scalar product of δ with its row. Zero by default.
    d_material_angular_velocity : (n, 3) array, optional
        Derivatives of f with respect to the velocities W at these times. Zero by default.
    wrt : str or list of str
        As in `sensitivities`.
    t_end, step, tolerance, t_start, start, rotation, scalar_first, material_angular_velocity
        As in `simulate`.
    angular_velocity, load, integrator, order, store, project
        As in `sensitivities`.

    Returns
    -------
    xarray.Dataset
        ``gradient`` on `parameter`: the derivatives of f, per unit of the parameter, in `parameter_unit`.

    Raises
    ------
    ValueError, SimulationError, SimulationInterrupt
        As `sensitivities`; a ValueError also if the derivatives have the wrong shape.

    Warns
    -----
    UserWarning
        As `sensitivities`.

    Examples
    --------
    How the moments at each time change the final velocity about the second axis:

    >>> import numpy as np
    >>> from nontwist import body_moment, gradient, nontwisting
    >>> push = body_moment(np.linspace(0, 1, 5), np.zeros((5, 3)))
    >>> how = {"t_end": 1, "step": 0.05, "store": "end", "load": push, "wrt": "values"}
    >>> last = np.array([[0, 0, 0], [0, 1, 0]])
    >>> g = gradient(nontwisting([3, 4, 5]), d_material_angular_velocity=last, **how)
    >>> g.gradient.values.reshape(5, 3)[:, 1].round(4)  # the weights of the table, over J2
    array([0.0312, 0.0625, 0.0625, 0.0625, 0.0312])
    """
    if d_rotation is None and d_material_angular_velocity is None:
        raise ValueError(
            "give d_rotation= or d_material_angular_velocity=, the derivatives of f by the stored states, (n, 3); "
            "those of the states themselves are what sensitivities returns"
        )
    problem = posed("gradient", system, keywords, OfStored)
    begin = start_of(problem)
    plan = plan_of(problem, begin)
    solved = Solved(plan, begin, wrt)
    slopes = np.zeros((len(solved.rows), 6))
    for at, name, given in (
        (0, "d_rotation", d_rotation),
        (3, "d_material_angular_velocity", d_material_angular_velocity),
    ):
        if given is not None:
            slopes[:, at : at + 3] = as_array(given, name, (len(slopes), 3))
    about = {"long_name": "derivative of f", "units": "per unit of the parameter"}
    found = _units(solved.parameters) | {"gradient": (("parameter",), solved.slopes(slopes), about)}
    return assembled(labelled(found, parameter=solved.parameters.labels), {})


class Solved:
    """A run with all its states, and its derivatives by some parameters; wrong ones are refused before the run.

    `means`: whether the run has means over its steps.
    """

    def __init__(self, plan: Plan, begin: Starts, wrt: Any, means: bool = False) -> None:
        Parameters(differentiable(plan, begin), wrt, linearised_by(plan))
        self.run = Prepared(plan._replace(store=1, means=means), begin).run()
        assert self.run.segments is not None
        self.rows, self.is_stored = _rows_of(plan, self.run.segments)
        self.problem = plan.problem(begin._replace(grid=None, memory=None), self.run.segments, self.rows)
        self.parameters = Parameters(self.problem, wrt, linearised_by(plan))
        self._removed = float(begin.removed[0])  # rad/s, of the velocity that was given, along the constrained axis

    @cached_property
    def _steps(self) -> tuple[Linearised | RememberingSteps, Array]:
        """The steps, linearised, and the changes of the first state by the parameters."""
        own, problem, first = self.parameters, self.problem, self.problem.velocity[0]
        scheme: Any = self.run.integrator
        if problem.load.memories:
            remembering = RememberingSteps(problem, scheme, own.of_memories, own.inertias)
            return remembering, remembering.start(own.start(6, first, self._removed))
        steps = Linearised(problem, scheme, own.inputs, own.changes)
        return steps, own.start(steps.rows, first, self._removed)

    def changes(self, directions: Array | None = None) -> Array:
        """Return the derivatives of the stored states by the parameters, or along `directions` (count, d); (n, 6, d).

        Along many directions all those by parameters are carried.
        """
        own, (steps, first) = self.parameters, self._steps
        if directions is not None and directions.shape[1] >= own.count:
            return self.changes() @ directions
        entries, along = own.entries, np.eye(own.count)
        if directions is not None:
            first, entries, along = first @ directions, partial(own.entries_along, directions), directions
        if isinstance(steps, RememberingSteps):
            ends = steps.forward(self.run.states, first, along, self.is_stored)
        else:
            ends = forward(steps, self.run.states, first, entries, self.is_stored)
        return np.concatenate([first[None, :6], ends])

    def slopes(self, by_states: Array) -> Array:
        """Return the derivatives of f by the parameters, (count,), from those by the stored states, (n, 6)."""
        own, (steps, first), states = self.parameters, self._steps, self.run.states
        ends = np.ascontiguousarray(by_states[1:])
        if isinstance(steps, RememberingSteps):
            at_start, found = steps.back(states, ends, self.is_stored)
        else:
            at_start, found = back(steps, states, ends, own.entries, self.is_stored, own.count)
        at_start[:6] += by_states[0]
        return found + first.T @ at_start


def _rows_of(plan: Plan, grid: Segments) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the numbers of the stored states, and 1 for each step at whose end the state is stored, else 0."""
    rows = stored_steps(grid.steps, plan.store)
    is_stored = np.zeros(grid.steps, dtype=np.int64)
    is_stored[rows[1:] - 1] = 1
    return rows, is_stored


def differentiable(plan: Plan, begin: Starts) -> IVP:
    """Return the problem of a plan, on any grid; a ValueError where its runs have no derivatives."""
    first = plan.grid or segmented((plan.t_start, plan.t_end), (1,))
    scheme = linearised_by(plan)
    problem = plan.problem(begin._replace(grid=None), first, np.array([0, first.steps]))
    if plan.load.memories:
        require_derivatives(problem, scheme)
    return problem


def linearised_by(plan: Plan) -> Compiled:
    """Return what linearises the steps of a plan."""
    return scheme_of(plan.scheme, plan.load, True)


def jacobian_of(plan: Plan, begin: Starts, wrt: Any) -> Array:
    """Return the derivatives of the stored states of a run, (n, 6, count)."""
    return Solved(plan, begin, wrt).changes()


class Jacobian:
    """The derivatives of the runs of a plan with a grid by some parameters, prepared for starts."""

    def __init__(self, plan: Plan, grid: Segments, wrt: Any) -> None:
        rows, is_stored = _rows_of(plan, grid)
        problem = plan.problem(AT_REST, grid, rows)
        self._parameters = Parameters(problem, wrt, linearised_by(plan))
        steps = Linearised(problem, plan.scheme, self._parameters.inputs, self._parameters.changes)
        self._prepared = PreparedPlan(plan._replace(store=1), grid)
        is_few = steps.forward_run is not None and self._parameters.count <= ForwardTangents.MOST
        self._rows, self._still = steps.rows, self._parameters.start(steps.rows, np.zeros(3))
        how = self._parameters.entries, is_stored
        self._forward = ForwardTangents(steps, self._still, *how) if is_few else None
        self._tangents = None if is_few else PreparedTangents(steps, self._parameters.count, *how)

    def __call__(self, p: Any, W: Any, scale: float, removed: float) -> Array | None:
        """Return the derivatives of the run from the quaternion `p`, scalar last, and W; None where it fails.

        `removed`: the part of W along the constrained axis that is no longer in it, rad/s.
        """
        are_scaled = any(one.term is not None or one.field == "duration" for one in self._parameters.all)
        if scale != 1 and (are_scaled or self._prepared.is_damped):
            return None
        start = None
        if any(one.name == "axis" for one in self._parameters.all):  # which the velocity is across
            start = self._parameters.start(self._rows, np.array(W), removed)
        if self._forward is not None:
            return self._forward(p, W, start, scale)
        assert self._tangents is not None
        states = self._prepared.states(p, W, scale)
        return None if states is None else self._tangents(states, self._still if start is None else start, scale)


def _stored(solved: Solved, plan: Plan, begin: Starts) -> Trajectory:
    """Return the run with the states that are to be stored."""
    run = solved.run
    if plan.store == 1:
        return run
    thin = integrated(plan._replace(scheme=run.integrator), begin, solved.problem.grid)
    return replace(thin, tolerance=run.tolerance, error_estimate=run.error_estimate, warning=run.warning)


def _units(parameters: Parameters) -> dict[str, Described]:
    return {"parameter_unit": (("parameter",), np.array(parameters.units, dtype=np.str_), {})}

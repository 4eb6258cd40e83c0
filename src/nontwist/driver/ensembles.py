"""`simulate_ensemble` and `propagator`: many bodies, starts and scales of one load at once, or one after the other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from typing import Any, Literal, Unpack

from numpy.typing import ArrayLike

from ..analysis import statistics
from ..analysis.trajectory import Trajectory
from ..errors import InputError, Option, warn
from ..geometry.arrays import Array, Dataset, as_number, largest_size, vector
from ..geometry.values import among, as_list, as_whole, short_repr
from ..integrators import Status
from ..integrators.compiled import Compiled
from ..integrators.ivp import segmented
from ..machine import cores
from ..models.stack import SystemStack
from ..models.system import DirectorSystem, as_system
from . import completion
from .derivatives import Jacobian, jacobian_of
from .first_steps import finer, first_run
from .grid import SMALL, free_memory, require_resolution
from .notices import (
    announce,
    coarseness,
    members_cost,
    progress_bar,
    say,
    warn_of_cost,
    warn_of_grid,
    with_messages,
)
from .parameters import EVERY
from .planning import Plan, require_observed
from .problem import STARTS, OfEnsemble, OfStarts, Problem, every_stored, plan_of, posed, starts_of, takes
from .single_run import Prepared, PreparedPlan, integrated, with_warning
from .starts import AT_REST, Starts, last_attitude, separate_spin, starts
from .tolerance import controlled


@takes(OfEnsemble, "variables", "reduce", "progress", "threads", "device", store="end")
def simulate_ensemble(
    system: DirectorSystem | SystemStack | Sequence[DirectorSystem] | Problem,
    *,
    variables: str | Iterable[str] = ("quaternion", "material_angular_velocity"),
    reduce: str | Iterable[str] = (),
    progress: bool = False,
    threads: int | None = None,
    device: Literal["cpu", "gpu"] = "cpu",
    **keywords: Unpack[OfEnsemble],
) -> Dataset:
    """Integrate the motions of many bodies, or of one from many starts, and return them as one dataset.

    Each argument with a member axis, which is its first, has m entries along it, or 1 for all members. The result of a
    member is the same, bit for bit, whatever the number of threads and the other members.

    Parameters
    ----------
    system : DirectorSystem, list of m, SystemStack or Problem
        One body, or m, also as ``DirectorSystem.stack([...])``; or a whole problem.
    t_end, step, tolerance, t_start, scalar_first, load, integrator, order, times, project, progress
        As in `nontwist.simulate`, the same for all members. ``step=None``: a tolerance of 1e-8 with `gauss`; with other
        integrators no member turns by more than 0.05 rad per step, by a bound from its energy, and the load is
        resolved. With a tolerance all members share one grid, determined by the least accurate member.
    start : Dataset or Trajectory, optional
        Continue from the last states of an ensemble, or start all members from the last state of a run. Its time grid
        is continued if whole steps of it lead to `t_end`.
    rotation : Rotation, (m, 3, 3) or (3, 3) Λ, (m, 4) or (4,) quaternions, ..., optional
        Initial attitudes; the identity by default.
    material_angular_velocity : (m, 3) or (3,) array, rad/s, optional
        Initial angular velocities W in body components. Give these or `angular_velocity`; at rest by default.
    angular_velocity : (m, 3) or (3,) array, rad/s, optional
        Initial angular velocities w in space.
    load_scale : float or (m,) array
        Factors that multiply the load.
    wheel_torque : (m, w) or (w,) array, N m, optional
        Torques of the motors of the w wheels of the load, in its order, for each member. They are constant, and add to
        those of the load, to a table from its first to its last time; `load_scale` does not multiply them. Tables,
        functions and friction are the same for all members.
    store : int or "end"
        Store every `store`-th state, or only the first and the last, which is the default since all may not fit into
        memory.
    variables : "all" or names, optional
        Variables of the stored states; by default the quaternion and the material angular velocity, from which the
        others follow. ``()``: none, for statistics alone. `sticking` and `dissipated_energy`, of dry friction, are
        variables of single runs only.
    reduce : names, optional
        Statistics over all steps, whatever is stored. "drift": `energy_drift` (kinetic and potential energy less the
        work of the load) and, where momentum is conserved, `momentum_drift`. "extrema": `..._min` and `..._max` of
        energies, momenta, twist rate and reaction moment, between the ends of steps as well in `gauss` above order 2,
        unless functions run in Python or loads have memory. "averages": `..._mean`, the means of the same over time.
        "total_twist".
    threads : int, optional
        Number of threads; by default one per processor.
    device : "cpu" or "gpu"
        Where the members march: "gpu" is the first one of NVIDIA, one member a thread, for `gauss`, `lie-midpoint` and
        `energy-momentum`. It has not been tried on a GPU.

    Returns
    -------
    xarray.Dataset
        Variables of `simulate` with the dimension `member` first, statistics, and the `status` of each member. A member
        that fails does not stop the others: from the failure on its numbers are NaN, and the variable `message` states
        the reason.

    Raises
    ------
    ValueError
        An argument is invalid; the message names it. There is no GPU, or a part of the load does not run there.

    Warns
    -----
    UserWarning
        Members have failed; or as in `simulate`.

    Notes
    -----
    `gauss`, `lie-midpoint` and `energy-momentum` integrate 8 members at a time, `split` one after the other, and
    `exact` evaluates its closed forms, all in compiled code. `continuous` integrates one member after the other in
    Python. A Python load is called for each member.

    Examples
    --------
    Four starts at once, and the energy of each after a second:

    >>> from nontwist import nontwisting, simulate_ensemble
    >>> body, W = nontwisting([3, 4, 5]), [[0, 0.5, 0], [0, 1, 0], [0, 1.5, 0], [0, 2, 0]]
    >>> many = simulate_ensemble(body, t_end=1, material_angular_velocity=W, variables="kinetic_energy")
    >>> many.kinetic_energy.isel(time=-1).values.round(9)
    array([0.5, 2. , 4.5, 8. ])
    """
    names, requested = statistics.checked_variables(variables), statistics.checked_statistics(reduce)
    task = posed("simulate_ensemble", system, keywords, OfEnsemble, store="end")
    begin, store = starts_of(task), task.store
    plan = plan_of(task, begin, store=every_stored(task))
    systems = plan.systems
    scheme, load, t0, t1, m = plan.scheme, plan.load, plan.t_start, plan.t_end, len(begin.quaternion)
    if requested:
        require_observed(scheme, load)
    if on_gpu := is_gpu(device):
        from ..integrators.gpu_stack import require

        require(scheme, load)
    grid, first = plan.grid, None
    if grid is None and scheme.any_times and store == "end":
        grid = segmented((t0, t1), (1,))
    if plan.is_controlled and grid is None:
        first = first_run(plan, begin)
        scheme, grid = first.scheme, finer(first.grid)
    if grid is None:
        grid = plan.automatic(begin, is_bound=True)
    problem = plan.problem(begin, grid, observed=bool(requested), on_gpu=on_gpu)
    count = len(problem.stored_times)
    _require_memory(names, m, count)
    if scheme.is_compiled:
        warn_of_cost(load)
        warn_of_grid(load, systems, t0, t1, grid)
        say([plan._replace(scheme=scheme).remark(begin, problem)])
    size, one = int(statistics.bytes_of(names, m, count)), problem.member(0)
    workers = cores() if threads is None else as_whole(threads, "threads", 1)
    if not on_gpu:
        cost = members_cost(scheme, one, m, count, size, workers)
        inside = completion.extrema_seconds(scheme, one, m) if "extrema" in requested else 0.0
        announce(cost._replace(seconds=cost.seconds + inside), scheme, one)
    kept: dict[str, Any] = {}
    with progress_bar(m, "members") if progress else nullcontext() as report:
        if plan.is_controlled:
            on_grid = plan._replace(output_times=None)  # the steps do not heed output times
            options = {"observed": bool(requested), "progress": report}
            found, goal, estimate = controlled(on_grid, begin, workers, first, on_gpu, **options)
            scheme, problem, outcome = found.scheme, found.problem, found.outcome
            kept = {"tolerance": goal, "error_estimate": estimate}
            if plan.output_times is not None:
                own = plan._replace(scheme=scheme)
                problem = own.problem(begin, problem.grid, observed=bool(requested), on_gpu=on_gpu)
                outcome = completion.checked_march(scheme, problem, workers)
        else:
            problem = replace(problem, progress=report)
            outcome = completion.checked_march(scheme, problem, workers)
    if "extrema" in requested:
        outcome = completion.with_extrema(scheme, problem, outcome, workers)
    done = outcome.states.velocity[outcome.failures[:, 0] == Status.OK]
    if not plan.is_controlled and (text := coarseness(scheme, problem, largest_size(done))) is not None:
        warn(text)
        kept["warning"] = text
    many = statistics.dataset(scheme, problem, outcome, names, requested).assign_attrs(kept)
    return with_messages(many, problem, outcome)


def is_gpu(device: Any) -> bool:
    """Whether a device is the GPU, and not the processor; an InputError where it is neither."""
    if not among(device, ("cpu", "gpu")):
        raise InputError("type", name=Option("device"), words="'cpu' or 'gpu'", value=short_repr(device))
    return bool(device == "gpu")


def _require_memory(variables: tuple[str, ...], members: int, times: int) -> None:
    needed = statistics.bytes_of(variables, members, times)
    if needed > SMALL and needed > (free := free_memory()):
        raise ValueError(
            f"{members} members with {times} states each need {needed / 1e9:.3g} GB, {free / 1e9:.3g} GB are free; "
            "store fewer states or variables, or run the members in parts"
        )


ASIDE = [name for name in STARTS if name != "start"]  # of a problem: calls give them
IDENTITY, STILL, NAME = (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0), "material_angular_velocity"


@takes(OfStarts, store="end")
def propagator(system: DirectorSystem | Problem, **keywords: Unpack[OfStarts]) -> Propagator:
    """Return a function that maps starts to runs of one body, under one load, over one span of time.

    Everything that does not depend on the start is checked, prepared and sampled once, here. A call then costs a few µs
    in addition to the integration, compared with about a hundred for `integrate`. For fits, shooting and Monte Carlo in
    your own loop.

    Parameters
    ----------
    system : DirectorSystem or Problem
        The body: `standard`, `nontwisting`, `suslov`, `heavy_top`, `with_gravity`; or a whole problem, whose
        start each call gives.
    t_end, step, tolerance, t_start, times, load, integrator, order, project
        As in `simulate`. With a tolerance, or ``step=None``, steps are chosen for each start; a call then takes as long
        as `integrate`.
    store : int or "end"
        Store every `store`-th state, or only the first and the last, which is the default.

    Returns
    -------
    Propagator

    Raises
    ------
    ValueError
        An argument is invalid; the message names it.

    Warns
    -----
    UserWarning
        As `simulate`.

    Examples
    --------
    How far a body turns in 1 s, from three starts:

    >>> from nontwist import nontwisting, propagator
    >>> run = propagator(nontwisting([3, 4, 5]), t_end=1, step=0.01)
    >>> [run(material_angular_velocity=(0, W, 0)).rotation[-1].magnitude().round(6).item() for W in (1, 2, 3)]
    [1.0, 2.0, 3.0]
    """
    problem = posed("propagator", system, keywords, OfStarts, aside=ASIDE, store="end")
    body, plan = as_system(problem.system), plan_of(problem, store=every_stored(problem))
    if plan.grid is not None:
        Prepared(plan, AT_REST).announced()
    return Propagator(body, plan, problem.project)


class Propagator:
    """A function that maps starts to runs, returned by `propagator`.

    It has no state: any number of threads may call it at the same time.

    Attributes
    ----------
    system : DirectorSystem
    load : Load
    integrator : Integrator
    t_start, t_end : float, s

    Examples
    --------
    >>> from nontwist import propagator, sine, standard
    >>> run = propagator(standard([3, 4, 5]), t_end=2, step=0.01, load=sine((0, 0, 1), frequency=0.5))
    >>> W0 = (0.1, 2, 0)
    >>> [run(material_angular_velocity=W0, load_scale=c).load_work.sum().round(3).item() for c in (0, 1, 2)]
    [0.0, 0.018, 0.014]
    """

    def __init__(self, system: DirectorSystem, plan: Plan, project: bool) -> None:
        self.system, self._plan, self._project = system, plan, project
        self.load, self.integrator, self.t_start, self.t_end = plan.load, plan.scheme, plan.t_start, plan.t_end
        self._axis = None if system.axis is None else system.axis.tolist()
        self._prepared, self._jacobians = None, dict[Any, Jacobian | None]()
        self._known = 0.0  # up to which a coarse step is no news, rad/s
        if plan.grid is not None:
            require_resolution(plan.t_start, plan.t_end, plan.grid)
            self._prepared = PreparedPlan(plan, plan.grid) if PreparedPlan.accepts(plan, plan.grid) else None

    def __call__(
        self,
        *,
        material_angular_velocity: ArrayLike | None = None,
        angular_velocity: ArrayLike | None = None,
        rotation: Any = None,
        scalar_first: bool | None = None,
        start: Any = None,
        load_scale: float = 1.0,
    ) -> Trajectory:
        """Return the run from a start: bit for bit that of `integrate` with the same arguments.

        Parameters
        ----------
        material_angular_velocity, angular_velocity, rotation, scalar_first, start
            As in `simulate`. The span is that of the propagator, whatever the last time of `start`.
        load_scale : float
            Factor of the load.

        Returns
        -------
        Trajectory

        Raises
        ------
        ValueError, SimulationError, SimulationInterrupt
            As `simulate`.

        Warns
        -----
        UserWarning
            The step is too coarse for a start: issued once, and again for a faster body. Every such run has the text in
            `warning`.
        """
        scale = as_number(load_scale, "load_scale")
        if self._prepared is not None and start is None and angular_velocity is None:
            p, W, _, is_admissible = self._plain(material_angular_velocity, rotation, scalar_first)
            if is_admissible and (run := self._prepared.run(p, W, scale)) is not None:
                if run._fastest <= self._prepared.unremarkable:
                    return run
                run = with_warning(self._plan, run, self._prepared, self._known)
                self._known = max(self._known, run._fastest if run.warning else 0.0)
                return run
        begin = self._begin(start, rotation, scalar_first, material_angular_velocity, angular_velocity, scale)
        if self._plan.grid is None:
            return Prepared(self._plan, begin).run()
        return with_warning(self._plan, integrated(self._plan, begin, self._plan.grid))

    def jacobian(
        self,
        *,
        wrt: str | Iterable[str] = EVERY,
        material_angular_velocity: ArrayLike | None = None,
        angular_velocity: ArrayLike | None = None,
        rotation: Any = None,
        scalar_first: bool | None = None,
        start: Any = None,
        load_scale: float = 1.0,
    ) -> tuple[Array, Array]:
        """Return the derivatives of the run from a start, those of `nontwist.sensitivities`.

        What does not depend on the start is prepared at the first call for each `wrt`.

        Parameters
        ----------
        wrt : str or list of str
            With respect to what to differentiate, as in `nontwist.sensitivities`.
        material_angular_velocity, angular_velocity, rotation, scalar_first, start, load_scale
            As in a call.

        Returns
        -------
        d_rotation : (n, 3, k) array, rad per unit of the parameters
            The rotation vectors in the body by which the attitudes change, for the n states that a call returns.
        d_material_angular_velocity : (n, 3, k) array, rad/s per unit

        Raises
        ------
        ValueError, SimulationError, SimulationInterrupt
            As `nontwist.sensitivities`; a ValueError also if the propagator has `times`.

        Warns
        -----
        InputWarning
            `start` is of another inertia: W is kept.

        Examples
        --------
        Find the start from which a body reaches an attitude in 1 s:

        >>> import numpy as np
        >>> from scipy.optimize import least_squares
        >>> from nontwist import propagator, rotations, standard
        >>> run = propagator(standard([3, 4, 5]), t_end=1, step=0.05)
        >>> goal = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
        >>> def gap(W):
        ...     return rotations.log(goal.T @ run(material_angular_velocity=W).rotation[-1].as_matrix())
        >>> def slope(W):
        ...     turned, _ = run.jacobian(material_angular_velocity=W, wrt="material_angular_velocity")
        ...     return rotations.dexp_inverse(-gap(W)) @ turned[-1]
        >>> least_squares(gap, (0.1, 0.1, 1), jac=slope).x.round(6)
        array([0.      , 0.      , 1.570796])
        """
        if self._plan.output_times is not None:
            raise ValueError("derivatives are those at nodes of the time grid: make the propagator without times=")
        scale = as_number(load_scale, "load_scale")
        if self._prepared is not None and start is None and angular_velocity is None:
            p, W, removed, is_admissible = self._plain(material_angular_velocity, rotation, scalar_first)
            prepared = self._jacobian(wrt)
            if is_admissible and prepared is not None and (found := prepared(p, W, scale, removed)) is not None:
                return found[:, :3], found[:, 3:]
        begin = self._begin(start, rotation, scalar_first, material_angular_velocity, angular_velocity, scale)
        found = jacobian_of(self._plan, begin, wrt)
        return found[:, :3], found[:, 3:]

    def _begin(self, start: Any, rotation: Any, scalar_first: bool | None, W: Any, w: Any, scale: float) -> Starts:
        """Return the start of a run, from what a call is given."""
        t_start = self._plan.t_start
        load = self._plan.load
        return starts(self.system, start, rotation, scalar_first, W, w, scale, self._project, t_start, load=load)

    def _plain(self, W: Any, rotation: Any, scalar_first: bool | None) -> tuple[Any, Any, float, bool]:
        """Return the quaternion and W of a start, what was removed of it, and whether it is admissible."""
        W = STILL if W is None else vector(W, NAME)
        p = IDENTITY if rotation is None else last_attitude(rotation, scalar_first)[0]
        if self._axis is None:
            return p, W, 0.0, True
        W, removed, is_admissible = separate_spin(W, self._axis)
        return p, W, float(removed), bool(is_admissible) or self._project

    def _jacobian(self, wrt: Any) -> Jacobian | None:
        """Return the prepared derivatives by some parameters; None where they cannot be prepared."""
        key = wrt if isinstance(wrt, str) else tuple(as_list(wrt, "wrt"))
        try:
            return self._jacobians[key]
        except (KeyError, TypeError):  # words that are none are refused as in `sensitivities`
            plan = self._plan._replace(store=1)
            assert plan.grid is not None
            found = Jacobian(self._plan, plan.grid, key) if PreparedPlan.accepts(plan, plan.grid) else None
            self._jacobians[key] = found
            return found

    def __repr__(self) -> str:
        scheme, grid = self._plan.scheme, self._plan.grid
        order = f" of order {scheme.order}" if isinstance(scheme, Compiled) else ""
        how = "" if self._plan.output_times is not None or grid is None else f", {grid.steps} steps"
        return f"<Propagator: {self.system!r}, {scheme.name}{order}, {self.t_start:g} to {self.t_end:g} s{how}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return Propagator, (self.system, self._plan, self._project)

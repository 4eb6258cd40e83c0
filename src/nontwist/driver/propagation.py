"""`propagator`: many runs of one plan, checked and prepared once."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Unpack

from numpy.typing import ArrayLike

from ..analysis.trajectory import Trajectory
from ..geometry.arrays import Array, as_number, vector
from ..geometry.values import as_list
from ..integrators.compiled import Compiled
from ..models.system import DirectorSystem, as_system
from .derivatives import Jacobian, jacobian_of
from .grid import require_resolution
from .parameters import EVERY
from .planning import Plan
from .problem import STARTS, OfStarts, Problem, every_stored, plan_of, posed, takes
from .single_run import PreparedPlan, check_cost, integrated, run_of, with_warning
from .starts import AT_REST, Starts, last_attitude, starts, without_spin

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
        check_cost(plan, AT_REST, plan.grid)
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
            return run_of(self._plan, begin)
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

        >>>         >>> from scipy.optimize import least_squares
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
        return starts(self.system, start, rotation, scalar_first, W, w, scale, self._project, t_start)

    def _plain(self, W: Any, rotation: Any, scalar_first: bool | None) -> tuple[Any, Any, float, bool]:
        """Return the quaternion and W of a start, what was removed of it, and whether it is admissible."""
        W = STILL if W is None else vector(W, NAME)
        p = IDENTITY if rotation is None else last_attitude(rotation, scalar_first)[0]
        if self._axis is None:
            return p, W, 0.0, True
        W, removed, is_admissible = without_spin(W, self._axis)
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

"""`propagator`: many runs of one plan, checked and prepared once."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..analysis.trajectory import Trajectory
from ..geometry.arrays import LARGEST, as_number, vector
from ..integrators import DEFAULT, Integrator
from ..integrators.compiled import Compiled
from ..loads import Load
from ..models.system import DirectorSystem, as_system
from .grid import require_resolution
from .planning import Plan, planned
from .single_run import AT_REST, PreparedPlan, check_cost, integrated, run_of, with_warning
from .starts import last_attitude, start_of_one, without_spin

IDENTITY, STILL, NAME = (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0), "material_angular_velocity"


def propagator(
    system: DirectorSystem,
    *,
    t_end: float | None = None,
    step: float | None = None,
    tolerance: float | None = None,
    t_start: float | None = None,
    times: ArrayLike | None = None,
    load: Load | None = None,
    integrator: str | Integrator = DEFAULT,
    order: int | None = None,
    store: int | Literal["end"] = "end",
    project: bool = False,
) -> Propagator:
    """Return a function from starts to runs of one body, under one load, over one span of time.

    Everything that does not depend on the start is checked, prepared and sampled here, once. A call then costs a few µs
    besides the integration itself, where `integrate` takes a hundred: for fits, shooting, Monte Carlo in your own loop.

    Parameters
    ----------
    system : DirectorSystem
        The body: `standard`, `nontwisting`, `suslov`, `heavy_top`, `with_gravity`.
    t_end, step, tolerance, t_start, times, load, integrator, order, project
        As in `simulate`. With a tolerance, or ``step=None``, steps are chosen for each start, which takes as long
        as `integrate`.
    store : int or "end"
        Store every `store`-th state, or only the first and the last: the default.

    Returns
    -------
    Propagator

    Raises
    ------
    ValueError
        Wrong input; the message names the value.

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
    system = as_system(system)
    every = 1 if times is not None and store == "end" else store
    plan = planned(system, load, integrator, order, t_start, t_end, times, step, every, None, tolerance)
    if plan.grid is not None:
        check_cost(plan, AT_REST, plan.grid)
    return Propagator(system, plan, project)


class Propagator:
    """A function from starts to runs, made by `propagator`.

    It holds no state: any number of threads may call it at once.

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
        self._axis = None if system.axis is None else system.axis.tolist()
        self._prepared = None
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
        """Return the run from a start: the bits of `integrate` with the same arguments.

        Parameters
        ----------
        material_angular_velocity, angular_velocity, rotation, scalar_first, start
            As in `simulate`. The span stays that of the propagator, whenever `start` ends.
        load_scale : float
            Factor of the load.

        Returns
        -------
        Trajectory

        Raises
        ------
        ValueError, SimulationError, SimulationInterrupt
            As `simulate`.
        """
        is_plain = type(load_scale) is float and abs(load_scale) <= LARGEST
        scale = float(load_scale if is_plain else as_number(load_scale, "load_scale"))
        if self._prepared is not None and start is None and angular_velocity is None:
            W = STILL if material_angular_velocity is None else vector(material_angular_velocity, NAME)
            p = IDENTITY if rotation is None else last_attitude(rotation, scalar_first)[0]
            is_admissible = True
            if self._axis is not None:
                W, _, is_admissible = without_spin(W, self._axis)
            if (is_admissible or self._project) and (run := self._prepared.run(p, W, scale)) is not None:
                return run if run._fastest <= self._prepared.unremarkable else with_warning(self._plan, run)
        begin = start_of_one(
            self.system, start, rotation, scalar_first, material_angular_velocity, angular_velocity, self._project
        )
        begin = begin._replace(load_scale=np.array([scale]))
        if self._plan.grid is None:
            return run_of(self._plan, begin)
        return with_warning(self._plan, integrated(self._plan, begin, self._plan.grid))

    @property
    def load(self) -> Load:
        """The load."""
        return self._plan.load

    @property
    def integrator(self) -> Integrator:
        """The integrator."""
        return self._plan.scheme

    @property
    def t_start(self) -> float:
        """Time of the starts, s."""
        return self._plan.t_start

    @property
    def t_end(self) -> float:
        """Time at which runs end, s."""
        return self._plan.t_end

    def __repr__(self) -> str:
        scheme, grid = self._plan.scheme, self._plan.grid
        order = f" of order {scheme.order}" if isinstance(scheme, Compiled) else ""
        how = "" if self._plan.asked is not None or grid is None else f", {grid.steps} steps"
        return f"<Propagator: {self.system!r}, {scheme.name}{order}, {self.t_start:g} to {self.t_end:g} s{how}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return Propagator, (self.system, self._plan, self._project)

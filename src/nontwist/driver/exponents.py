"""`lyapunov`: how fast neighbouring motions of a body part from each other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..engine import linear
from ..geometry.arrays import Array
from ..integrators import DEFAULT, Integrator
from ..integrators.linearised import Chain, Linearised
from ..loads import Load
from ..models.system import DirectorSystem, as_system
from .derivatives import solved_with
from .planning import planned
from .starts import start_of_one

if TYPE_CHECKING:
    import xarray

TOGETHER = 32  # steps between two orthonormalisations


def lyapunov(
    system: DirectorSystem,
    *,
    t_end: float | None = None,
    step: float | None = None,
    tolerance: float | None = None,
    t_start: float | None = None,
    start: Any = None,
    rotation: Any = None,
    scalar_first: bool | None = None,
    material_angular_velocity: ArrayLike | None = None,
    angular_velocity: ArrayLike | None = None,
    load: Load | None = None,
    integrator: str | Integrator = DEFAULT,
    order: int | None = None,
    project: bool = False,
) -> xarray.Dataset:
    """Return the Lyapunov exponents of a motion, from its tangent flow.

    Changes of the attitude and of W, orthonormal at the start, are carried along the run and orthonormalised again
    every 32 steps (Benettin, Galgani, Giorgilli & Strelcyn, Meccanica 15 (1980) 9); the exponents are the means of
    the logarithms of what they have grown by. In a regular motion all go to zero, like log(t)/t; in a chaotic one the
    largest stays positive. Of a body under its weight they are pairs ±λ, and their sum is the rate at which volumes
    grow: 0, or with damping -tr(J⁻¹C).

    Parameters
    ----------
    system : DirectorSystem
        The body: `standard`, `nontwisting`, `suslov`, `heavy_top`, `with_gravity`.
    t_end, step, tolerance, t_start, start, rotation, scalar_first, material_angular_velocity
        As in `simulate`.
    angular_velocity, load, integrator, order, project
        As in `sensitivities`.

    Returns
    -------
    xarray.Dataset
        ``lyapunov_exponent`` on `time` and `exponent`: the means from the start to each time, 1/s, the first one the
        largest in the end; 6 of them, of a body with a constrained axis 5.

    Raises
    ------
    ValueError, SimulationError, SimulationInterrupt
        As `sensitivities`.

    Warns
    -----
    UserWarning
        As `simulate`.

    Examples
    --------
    A rotation about the middle axis is unstable, and neighbours leave it at the rate ``W2 sqrt((J3 - J2)(J2 - J1)/(J1
    J3))``:

    >>> from nontwist import lyapunov, standard
    >>> found = lyapunov(standard([3, 4, 5]), t_end=500, step=0.1, material_angular_velocity=(0, 2, 0))
    >>> found.lyapunov_exponent.values[-1, 0].round(2).item(), round(2 / 15**0.5, 2)
    (0.52, 0.52)
    """
    import xarray

    system = as_system(system)
    begin = start_of_one(system, start, rotation, scalar_first, material_angular_velocity, angular_velocity, project)
    plan = planned(system, load, integrator, order, t_start, t_end, None, step, "end", begin.time, tolerance)
    known, _ = solved_with(plan, begin, "rotation")
    steps = Linearised(known.problem, known.run.integrator, ())
    times, sums = exponents(steps, known.run.states, system.axis)
    means = sums / (times - known.problem.t_start)[:, None]
    attributes = {"units": "s-1", "long_name": "mean rate of growth from the start", "symbol": "λ"}
    found = xarray.DataArray(means, dims=("time", "exponent"), attrs=attributes)
    along = {"time": ("time", times, {"units": "s", "long_name": "time", "symbol": "t"})}
    return xarray.Dataset({"lyapunov_exponent": found}, {**along, "exponent": np.arange(1, means.shape[1] + 1)})


def exponents(steps: Linearised, states: Any, axis: Array | None) -> tuple[Array, Array]:
    """Return times, and the logarithms of what orthonormal changes have grown by until then, (k, 6 or 5)."""
    fastest = float(np.sqrt(np.square(states.velocity).sum(axis=1)).max()) or 1.0
    units = np.repeat([1.0, fastest], [3, steps.rows - 3])[:, None]  # rad/s of a change that counts as 1 rad
    first = np.eye(steps.rows, 6)
    if axis is not None:
        across = np.linalg.svd(axis[None])[2][1:].T
        first = np.zeros((steps.rows, 5))
        first[:3, :3], first[3:6, 3:] = np.eye(3), across
    count = first.shape[1]
    first = first @ np.linalg.qr(np.random.default_rng(0).normal(size=(count, count)))[0]  # along nothing in particular
    x, room = np.zeros((steps.rows, 8)), np.empty((steps.rows, 8))
    x[:, :count] = units * first
    own, total, times, sums = steps.workspace(), np.zeros(count), list[float](), list[Array]()
    never, nowhere, run = np.zeros(TOGETHER, dtype=np.int64), np.zeros(1), linear.forward
    for acting, _ in steps.layouts(count, lambda nodes: ()):
        steps.matrices(own, acting, states)
        for k in range(0, acting.last - acting.first, TOGETHER):
            n = min(TOGETHER, acting.last - acting.first - k)
            chain = Chain(steps, count, (), 0, n)
            arrays = {"state": x, "room": room, "kept": never, "states": nowhere}
            block = chain.put(chain.block, matrices=own.matrices[k:], **arrays)
            carry: Any = run
            carry(block.ctypes.data)
            Q, R = np.linalg.qr(x[:, :count] / units)
            x[:, :count] = units * Q
            total = total + np.log(abs(R.diagonal()))
            times.append(float(steps.problem.times(acting.first + k + n)))
            sums.append(total)
    return np.array(times), np.array(sums)

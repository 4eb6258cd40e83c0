"""Positions and velocities of material points of a run.

A point of the body is ``X = θ¹ D1 + θ² D2 + θ³ D3`` (eq-reference-conf). In space it is at ``x = θ^i d_i``
(eq_position_vector_rigidbody) and moves with ``x' = θ^i d_i'`` (eq_velocity_vector_rigidbody). Both are linear in the
directors and their velocities, which are used as the integrator has them. On tangent velocities ``x' = w × x``. The
director velocities of energy-momentum under load are not tangent at the nodes: x' then has a part along x, and it is
this x' whose kinetic energy ``∫ ρ/2 |x'|²`` is K (eq-director-K).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, overload

from numpy.typing import ArrayLike

from ..geometry.arrays import Array, as_array, as_floats
from .datasets import RUN, as_dataset
from .trajectory import Trajectory

if TYPE_CHECKING:
    import xarray

POSITION = {"units": "m", "long_name": "position of a material point", "symbol": "x"}
VELOCITY = {"units": "m s-1", "long_name": "velocity of a material point", "symbol": "x'"}


@overload
def point_position(run: xarray.Dataset, X: ArrayLike) -> xarray.DataArray: ...
@overload
def point_position(run: Trajectory, X: ArrayLike) -> Array: ...
def point_position(run: xarray.Dataset | Trajectory, X: ArrayLike) -> xarray.DataArray | Array:
    """Return the position ``x = θ^i d_i`` of material points in space (eq_position_vector_rigidbody).

    Parameters
    ----------
    run : Dataset of `simulate` or `simulate_ensemble`, or Trajectory
        It must have the variable `directors`; an ensemble has it only if ``variables=`` names it.
    X : (3,) or (n, 3) array, m
        Components θ^i of one point or of n points along the directors, from the fixed point (eq-reference-conf).

    Returns
    -------
    DataArray or array, m, spatial components from the fixed point
        For a dataset, a DataArray with the dimensions (time, axis), or (time, point, axis) for n points, with `member`
        first for ensembles; NaN where the run has NaN. For a Trajectory, a (k, 3) or (k, n, 3) array.

    Raises
    ------
    ValueError
        X is not an array of finite numbers of this shape, or `run` is not a run or has no variable `directors`.

    Examples
    --------
    The tip of a body that turns about its second director, by 2 rad:

    >>> from nontwist import nontwisting, point_position, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, step=0.1, angular_velocity=(0, 2, 0), integrator="split")
    >>> tip = point_position(run, (0, 0, 0.5))
    >>> tip.sel(time=1).values.round(6)  # 0.5 (sin 2, 0, cos 2)
    array([ 0.454649,  0.      , -0.208073])
    >>> tip.dims, tip.attrs["units"]
    (('time', 'axis'), 'm')
    """
    return _along(run, X, "directors", POSITION)


@overload
def point_velocity(run: xarray.Dataset, X: ArrayLike) -> xarray.DataArray: ...
@overload
def point_velocity(run: Trajectory, X: ArrayLike) -> Array: ...
def point_velocity(run: xarray.Dataset | Trajectory, X: ArrayLike) -> xarray.DataArray | Array:
    """Return the velocity ``x' = θ^i d_i'`` of material points in space (eq_velocity_vector_rigidbody).

    It equals w × x wherever the director velocities are tangent, that is, except at the nodes of `energy-momentum`
    under load. There x' also has a part along x.

    Parameters
    ----------
    run : Dataset of `simulate` or `simulate_ensemble`, or Trajectory
        It must have the variable `director_velocities`; an ensemble has it only if ``variables=`` names it.
    X : (3,) or (n, 3) array, m
        Components θ^i of one point or of n points along the directors, from the fixed point (eq-reference-conf).

    Returns
    -------
    DataArray or array, m/s, spatial components
        Laid out as the positions of `point_position`; NaN where the run has NaN.

    Raises
    ------
    ValueError
        X is not an array of finite numbers of this shape, or `run` is not a run or has no variable
        `director_velocities`.

    Examples
    --------
    >>> from nontwist import integrate, nontwisting, point_velocity
    >>> start = {"angular_velocity": (0, 2, 0)}
    >>> run = integrate(nontwisting([3, 4, 5]), t_end=1, step=0.1, integrator="split", **start)
    >>> point_velocity(run, [(0, 0, 0.5), (0, 0.5, 0)])[0].round(6)  # w × x
    array([[1., 0., 0.],
           [0., 0., 0.]])
    """
    return _along(run, X, "director_velocities", VELOCITY)


def _along(run: Any, X: ArrayLike, name: str, attributes: dict[str, str]) -> xarray.DataArray | Array:
    """Return Σ θ^i a_i for the rows a_i of a variable of a run."""
    X = as_floats(X, "X")
    X = as_array(X, "X", (3,) if X.ndim == 1 else (None, 3))
    if isinstance(run, Trajectory):
        of_run: Array = X @ getattr(run, name)
        return of_run
    as_dataset(run, f"a Trajectory, or {RUN}")
    if name not in run.data_vars:
        known = ", ".join(map(str, run.data_vars))
        raise ValueError(f"the run has no variable {name!r}; it has {known}; for ensembles pass variables=[{name!r}]")
    if not {"director", "axis"} <= {*run[name].dims}:
        raise ValueError(f"{name} must have the dims director and axis, got {', '.join(map(str, run[name].dims))}")
    variable = run[name].transpose(..., "director", "axis")
    rows = as_floats(variable.values, name)
    if rows.shape[-2:] != (3, 3):
        raise ValueError(f"{name} must have three directors of three components, got {rows.shape[-2:]}; select later")
    import xarray

    points = () if X.ndim == 1 else ("point",)
    coordinates = {key: value for key, value in variable.coords.items() if "director" not in value.dims}
    dims = (*variable.dims[:-2], *points, "axis")
    return xarray.DataArray(X @ rows, coordinates, dims, attributes["long_name"].split()[0], attributes)

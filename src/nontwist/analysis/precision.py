"""Measured orders from three runs with steps h, h/2, h/4 (eq:second_quotient).

With an expansion ``ξ(t, h) = ξ(t) + h^n ψ_n(t) + …`` the second quotient of precision

    Q_II(t) = |ξ(t, h) - ξ(t, h/2)| / |ξ(t, h/2) - ξ(t, h/4)|

tends to 2^n. For a symmetric scheme the expansion has even powers only, hence Q_II = 2^n + O(h²).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.arrays import Array, as_number
from ..geometry.values import among, shown
from .datasets import RUN, as_dataset

if TYPE_CHECKING:
    import xarray


def second_quotient(
    run_h: xarray.Dataset, run_h2: xarray.Dataset, run_h4: xarray.Dataset, *, variable: str = "directors"
) -> xarray.DataArray:
    """Return the second quotient of precision Q_II (eq:second_quotient).

    Parameters
    ----------
    run_h, run_h2, run_h4 : Dataset
        Runs of one problem with steps h, h/2 and h/4; the others must contain every time of the first.
    variable : str
        The variable ξ; the paper uses the nine director components, with the Euclidean norm.

    Returns
    -------
    DataArray
        Over time, from the second stored time of `run_h`. NaN where the finer two runs agree to the last bit.

    Raises
    ------
    ValueError
        An argument is not a run, the steps are not in the ratio 4 : 2 : 1, a finer run lacks a time of the first, or a
        variable is missing.

    Examples
    --------
    >>> from nontwist import nontwisting, simulate
    >>> from nontwist.comparison import second_quotient
    >>> start = {"material_angular_velocity": (1, -2, 0), "integrator": "energy-momentum"}
    >>> runs = [simulate(nontwisting([3, 4, 5]), t_end=1, step=h, **start) for h in (0.02, 0.01, 0.005)]
    >>> round(second_quotient(*runs)[-1].item(), 2)  # 2² of a scheme of order 2
    4.0
    """
    import xarray

    runs = [as_dataset(run, RUN, ("time",), ("step",)) for run in (run_h, run_h2, run_h4)]
    if any(run.sizes["time"] < 2 for run in runs):
        raise ValueError("a run has fewer than two states: orders are measured at the times after its start")
    steps = [as_number(run.attrs["step"], "the step of a run") for run in runs]
    if not np.allclose([steps[0] / 2, steps[0] / 4], steps[1:], rtol=1e-9):
        raise ValueError(f"the steps must be h, h/2, h/4; got {', '.join(f'{h:.12g}' for h in steps)} s")
    time = run_h["time"].values[1:]
    x, x2, x4 = (_at(run, variable, time) for run in (run_h, run_h2, run_h4))
    numerator, denominator = (np.linalg.norm(d.reshape(len(d), -1), axis=1) for d in (x - x2, x2 - x4))
    with np.errstate(divide="ignore", invalid="ignore"):
        quotient = np.where(denominator > 0, numerator / denominator, np.nan)
    attrs = {"units": "1", "long_name": "second quotient of precision", "symbol": "Q_II", "variable": variable}
    return xarray.DataArray(quotient, {"time": run_h["time"][1:]}, ("time",), "second_quotient", attrs)


def observed_order(
    run_h: xarray.Dataset, run_h2: xarray.Dataset, run_h4: xarray.Dataset, *, variable: str = "directors"
) -> xarray.DataArray:
    """Return the observed order ``log2 Q_II`` over time.

    Parameters
    ----------
    run_h, run_h2, run_h4, variable
        As in `second_quotient`.

    Returns
    -------
    DataArray
        Over time, at the times of `second_quotient`; NaN where the quotient is NaN or 0.

    Raises
    ------
    ValueError
        As `second_quotient`.

    Examples
    --------
    >>> from nontwist import simulate, standard
    >>> from nontwist.comparison import observed_order
    >>> start = {"material_angular_velocity": (1, 2, 0.1), "integrator": "gauss", "order": 4}
    >>> runs = [simulate(standard([3, 4, 5]), t_end=2, step=h, **start) for h in (0.1, 0.05, 0.025)]
    >>> round(observed_order(*runs)[-1].item(), 1)
    4.0
    """
    quotient = second_quotient(run_h, run_h2, run_h4, variable=variable)
    attrs = quotient.attrs | {"long_name": "observed order", "symbol": "n"}
    order: Any = np.log2(quotient.where(quotient > 0))
    return order.rename("observed_order").assign_attrs(attrs)  # type: ignore[no-any-return]


def _at(run: xarray.Dataset, variable: str, time: Array) -> Array:
    if not among(variable, run.data_vars):
        raise ValueError(f"the run has no variable {shown(variable)}; it has {', '.join(map(str, run.data_vars))}")
    run = as_dataset(run, RUN, (variable,))
    if "time" not in run[variable].dims:
        raise ValueError(f"{variable} has no dim time: choose a variable of the states")
    own = run["time"].values
    index = np.clip(np.searchsorted(own, time), 1, len(own) - 1)
    index -= (time - own[index - 1]) < (own[index] - time)
    gap = abs(own[index] - time)
    if gap.max() > 1e-9 * (own[-1] - own[0]):
        raise ValueError(
            f"the run with step {run.attrs['step']:.12g} s does not contain the time {time[np.argmax(gap)]:.12g} s"
        )
    values: Array = run[variable].transpose("time", ...).values[index]
    return values

"""Drifts of invariants and measured orders: energy balance, orthonormality, second quotient."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.values import as_whole
from .looks import variable
from .timelines import Curves, over_time

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .looks import Look, Quotients, Runs

ROUND_OFF = float(np.finfo(float).eps)
SECTIONS = 200


def energy_drift(runs: Runs, ax: Axes | None = None, **properties: Any) -> Axes:
    """Draw the error of the energy balance, |E(t) - E(0) - A(t)| over the largest energy, on a logarithmic scale.

    E = K + V, and A is the work of the load by the energy balance of the scheme. Under the gravity gradient and under
    internal dissipation E changes by itself; `nontwist.drifts` shows what is conserved there. For a long run the
    largest value in each 1/200 of its length is drawn. Values below the round-off of 1 are drawn on a grey line at that
    level.

    Parameters
    ----------
    runs : Dataset, or dict of str to Dataset
        A run, or several to compare with their labels.
    ax : Axes, optional
        Axes to draw on; by default those of a new figure, one column wide, available as ``ax.figure``.
    **properties
        Properties of the curves, as for `matplotlib.lines.Line2D`: linewidth, color, alpha.

    Returns
    -------
    Axes
        One line for each run, and the line of round-off.

    Raises
    ------
    ValueError
        A run under load has no `load_work`, as after `resample`; or lines do not have one of the properties.

    Examples
    --------
    >>> from nontwist import plot, simulate, standard
    >>> run = simulate(standard([3, 4, 5]), t_end=5, material_angular_velocity=(0.1, 2, 0.1))
    >>> ax = plot.energy_drift(run)
    >>> drift, round_off = ax.lines
    >>> bool(drift.get_ydata().max() < 1e-12)
    True
    >>> plot.save(ax, "drift.pdf")
    """

    def curves(run: Any, label: str) -> dict[str, Any]:
        K, V = (variable(run, label, f"{kind}_energy") for kind in ("kinetic", "potential"))
        E = K + V
        balance = E.values - E.values[0]
        if "load_work" in run or run.attrs["load"] != "[]":
            work = variable(run, label, "load_work", "draw the run before it is resampled")
            balance[1:] -= np.cumsum(work.values)
        scale = float((K + abs(V)).max()) or 1.0
        drift = E.copy(data=abs(balance) / scale).rename("energy_drift")
        return {"drift": drift.assign_attrs(units="1", symbol=r"|E-E_0-A|/\max E")}

    return _logarithmic(runs, ax, curves, "energy_drift", properties)


def orthonormality(runs: Runs, ax: Axes | None = None, **properties: Any) -> Axes:
    """Draw the orthonormality defect of the directors, the largest entry of |q qᵀ - I|, on a logarithmic scale.

    Parameters
    ----------
    runs, ax, **properties
        As in `energy_drift`.

    Returns
    -------
    Axes
        One line for each run, and the line of round-off.

    Raises
    ------
    ValueError
        An argument is not of the required kind, `ax` is not a Matplotlib Axes, or lines do not have one of the
        properties.

    Examples
    --------
    >>> from nontwist import plot, simulate, standard
    >>> how = {"t_end": 5, "material_angular_velocity": (0.1, 2, 0.1)}
    >>> runs = {name: simulate(standard([3, 4, 5]), integrator=name, **how) for name in ("gauss", "split")}
    >>> *lines, round_off = plot.orthonormality(runs).lines
    >>> [line.get_label() for line in lines]
    ['δ, gauss', 'δ, split']
    """

    def curves(run: Any, label: str) -> dict[str, Any]:
        return {"δ": variable(run, label, "orthonormality_defect")}

    return _logarithmic(runs, ax, curves, "orthonormality", properties)


def second_quotient(quotients: Quotients, ax: Axes | None = None, *, order: int = 2, **properties: Any) -> Axes:
    """Draw the second quotient of precision over time, with the limit 2^order.

    Parameters
    ----------
    quotients : DataArray, or dict of str to DataArray
        Results of `nontwist.comparison.second_quotient`, one or several with their labels.
    ax : Axes, optional
        Axes to draw on; by default those of a new figure, one column wide, available as ``ax.figure``.
    order : int
    **properties
        Properties of the curves, as for `matplotlib.lines.Line2D`: linewidth, color, alpha.

    Returns
    -------
    Axes
        One line for each quotient, and the limit.

    Raises
    ------
    ValueError
        An argument is not of the required kind, `ax` is not a Matplotlib Axes, or lines do not have one of the
        properties.

    Examples
    --------
    >>> from nontwist import nontwisting, plot, simulate
    >>> from nontwist.comparison import second_quotient
    >>> start = {"material_angular_velocity": (1, -2, 0), "integrator": "energy-momentum"}
    >>> runs = [simulate(nontwisting([3, 4, 5]), t_end=1, step=h, **start) for h in (0.02, 0.01, 0.005)]
    >>> curve, limit = plot.second_quotient(second_quotient(*runs)).lines
    >>> limit.get_ydata()
    [4, 4]
    """

    def curves(quotient: Any, label: str) -> dict[str, Any]:
        if hasattr(quotient, "data_vars"):
            raise ValueError("pass the result of nontwist.comparison.second_quotient(run_h, run_h2, run_h4), not a run")
        return {"Q": quotient}

    limit = 2 ** as_whole(order, "order", 1, 20)
    ax, lines = over_time(quotients, ax, curves, "second_quotient", properties)
    reach = max(0.05, *(1.1 * np.nanmax(abs(line.get_ydata() - limit), initial=0) for line in lines))
    ax.set_ylim(limit - reach, limit + reach)
    ax.axhline(limit, color="0.6", linewidth=0.6, zorder=0)
    return ax


def _logarithmic(runs: Runs, ax: Axes | None, curves: Curves, function: str, properties: Look) -> Axes:
    def floored(run: Any, label: str) -> dict[str, Any]:
        return {name: np.maximum(_largest(curve), ROUND_OFF) for name, curve in curves(run, label).items()}

    ax, lines = over_time(runs, ax, floored, function, properties, logarithmic=True)
    highest = max(np.nanmax(line.get_ydata()) for line in lines)
    ax.set_ylim(ROUND_OFF / 3, max(1e-13, 10 * highest))
    ax.axhline(ROUND_OFF, color="0.6", linewidth=0.6, zorder=0)
    return ax


def _largest(curve: Any) -> Any:
    """Return the largest value in each of `SECTIONS` sections of a long curve, at its time."""
    y = curve.values
    if y.size <= 2 * SECTIONS:
        return curve
    sections = np.array_split(np.arange(y.size), SECTIONS)
    return curve[[k[np.argmax(y[k])] for k in sections]]

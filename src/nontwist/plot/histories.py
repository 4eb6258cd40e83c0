"""Curves over time: momenta, directors, energy, reaction moment, multipliers.

Drifts of invariants and measured orders: energy balance, orthonormality, second quotient.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from ..analysis.invariants import work_of
from ..geometry.arrays import Array, Axes
from ..geometry.values import as_whole, require_among
from .looks import Look, Quotients, Runs, labelled, symbol, unit, variable
from .timelines import Curves, over_time

_VISIBLE = 0.2  # of an axis: changes of an energy that are seen at once
_ROUND_OFF = 1e-12  # of the same: a body at rest
_BRACKETS = str.maketrans("", "", "()")


def momenta(
    runs: Runs, ax: Axes | None = None, *, frame: Literal["space", "body"] = "space", **properties: Any
) -> Axes:
    """Draw the three components of the spatial or the material angular momentum over time.

    Parameters
    ----------
    runs : Dataset, or dict of str to Dataset
        A run, or several to compare with their labels.
    ax : Axes, optional
        Axes to draw on; by default those of a new figure, one column wide, available as ``ax.figure``.
    frame : "space" or "body"
    **properties
        Properties of the curves, as for `matplotlib.lines.Line2D`: linewidth, color, alpha.

    Returns
    -------
    Axes
        Shown by a notebook. ``ax.lines`` are the curves, run by run, one for each component.

    Raises
    ------
    ValueError
        An argument is not a run, or lacks the variables to be drawn; `ax` is not a Matplotlib Axes; or an option or
        property is unknown.

    Warns
    -----
    UserWarning
        A run has so few states, and so far apart, that its curves are polygons; `resample` gives more.

    Examples
    --------
    >>> from nontwist import nontwisting, plot, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, material_angular_velocity=(6, -18, 0))
    >>> ax = plot.momenta(run, frame="body")
    >>> [round(float(line.get_ydata()[-1]), 6) + 0.0 for line in ax.lines]
    [18.0, -72.0, 0.0]
    >>> plot.save(ax, "momenta.pdf", "momenta.png")
    """
    require_among(frame, "frame", ("space", "body"))
    name, dim = ("spatial_momentum", "axis") if frame == "space" else ("material_momentum", "director")

    def curves(run: Any, label: str) -> dict[str, Any]:
        momentum = variable(run, label, name)
        return {symbol(momentum, str(k)): momentum.sel({dim: k}) for k in momentum[dim].values}

    return over_time(runs, ax, curves, "momenta", properties)[0]


def directors(runs: Runs, ax: Axes | None = None, *, director: int = 3, **properties: Any) -> Axes:
    """Draw the three spatial components of a director over time.

    Parameters
    ----------
    runs, ax, **properties
        As in `momenta`.
    director : 1, 2 or 3

    Returns
    -------
    Axes
        One line for each component, run by run.

    Raises
    ------
    ValueError
        An argument is not a run, or lacks the variables to be drawn; `ax` is not a Matplotlib Axes; or an option or
        property is unknown.

    Warns
    -----
    UserWarning
        A run has so few states, and so far apart, that its curves are polygons; `resample` gives more.

    Examples
    --------
    >>> from nontwist import nontwisting, plot, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, material_angular_velocity=(1, 2, 0))
    >>> [line.get_label() for line in plot.directors(run, director=1).lines]
    ['$d_{1x}$', '$d_{1y}$', '$d_{1z}$']
    """
    require_among(director, "director", (1, 2, 3))

    def curves(run: Any, label: str) -> dict[str, Any]:
        d = variable(run, label, "directors").sel(director=director)
        return {f"$d_{{{director}{x}}}$": d.sel(axis=x) for x in d["axis"].values}

    ax, _ = over_time(runs, ax, curves, "directors", properties)
    ax.set_ylabel(f"director $d_{director}$")
    return ax


def energy(runs: Runs, ax: Axes | None = None, **properties: Any) -> Axes:
    """Draw the kinetic energy over time; if dead forces act, the potential and the total energy as well.

    That of wheels is not drawn: it is in the variable ``total_kinetic_energy``. Where these change little compared with
    their differences, as those of a fast top, their changes since the first state are drawn, and the legend gives the
    values that are subtracted.

    Parameters
    ----------
    runs, ax, **properties
        As in `momenta`.

    Returns
    -------
    Axes
        The lines are in the order of the runs.

    Raises
    ------
    ValueError
        An argument is not a run, or lacks the variables to be drawn; `ax` is not a Matplotlib Axes; or an option or
        property is unknown.

    Warns
    -----
    UserWarning
        A run has so few states, and so far apart, that its curves are polygons; `resample` gives more.

    Examples
    --------
    >>> from nontwist import heavy_top, plot, simulate
    >>> top = heavy_top([2, 2, 1], mass=1.5, centre_of_mass=(0, 0, 0.6))
    >>> run = simulate(top, t_end=2, material_angular_velocity=(2, 0, 1))
    >>> [line.get_label() for line in plot.energy(run).lines]
    ['$K$', '$V$', '$K+V$']
    """

    def curves(run: Any, label: str) -> dict[str, Any]:
        K, V = (variable(run, label, f"{kind}_energy") for kind in ("kinetic", "potential"))
        return {symbol(K): K} | ({symbol(V): V, "$K+V$": K + V} if V.values.any() else {})

    def changes(run: Any, label: str) -> dict[str, Any]:
        own = curves(run, label)
        starts = [(float(E[0]), unit(E).translate(_BRACKETS)) for E in own.values()]
        values = [f" {'+−'[at > 0]} {abs(at):.4g}{of}" if at else "" for at, of in starts]
        names = [f"Δ({name})" for name in own] if several else map("".join, zip(own, values, strict=True))
        return {name: E - E[0] for name, E in zip(names, own.values(), strict=True)}

    runs = labelled(runs)
    table, several = runs.values(), len(runs) > 1
    drawn = {label: curves(run, label) for label, run in runs.items()}
    hidden = _exchange_is_hidden([[E.values for E in own.values()] for own in drawn.values()])
    ax, _ = over_time(runs, ax, changes if hidden else curves, "energy", properties)
    if any(run["potential_energy"].values.any() for run in table):
        ax.set_ylabel(("change of energy" if hidden else "energy") + unit(next(iter(table))["kinetic_energy"]))
    else:
        ax.set_ylim(0, 1.15 * max(float(run["kinetic_energy"].max()) for run in table) or 1.0)
    return ax


def _exchange_is_hidden(energies: list[list[Array]]) -> bool:
    """Whether no curve of several changes by a visible part of what all of them span, but more than round-off."""
    every = [E for own in energies for E in own]
    span = max(float(E.max()) for E in every) - min(float(E.min()) for E in every)
    largest = max(float(np.ptp(E)) for E in every)
    return any(len(own) > 1 for own in energies) and _ROUND_OFF * span < largest < _VISIBLE * span


def reaction_moment(runs: Runs, ax: Axes | None = None, **properties: Any) -> Axes:
    """Draw the moment of the constraint on the body about its axis, as means over the stored intervals.

    Parameters
    ----------
    runs, ax, **properties
        As in `momenta`.

    Returns
    -------
    Axes
        One line for each run.

    Raises
    ------
    ValueError
        A body has no constrained axis, or lines do not have one of the properties.

    Warns
    -----
    UserWarning
        A run has so few states, and so far apart, that its curves are polygons; `resample` gives more.

    Examples
    --------
    >>> from nontwist import nontwisting, plot, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, material_angular_velocity=(6, -18, 0))
    >>> ax = plot.reaction_moment(run)
    >>> round(float(ax.lines[0].get_ydata()[-1]), 6)  # (J2 - J1) W1 W2
    -108.0
    """

    def curves(run: Any, label: str) -> dict[str, Any]:
        moment = variable(run, label, "reaction_moment", "its body may turn about every axis")
        return {symbol(moment): moment}

    return over_time(runs, ax, curves, "reaction_moment", properties)[0]


def multipliers(runs: Runs, ax: Axes | None = None, **properties: Any) -> Axes:
    """Draw the Lagrange multipliers as means over the stored intervals: λ of orthonormality, μ of the constrained axis.

    Parameters
    ----------
    runs, ax, **properties
        As in `momenta`.

    Returns
    -------
    Axes
        One line for each constraint, run by run.

    Raises
    ------
    ValueError
        A run has no multipliers, or lines do not have one of the properties.

    Warns
    -----
    UserWarning
        A run has so few states, and so far apart, that its curves are polygons; `resample` gives more.

    Examples
    --------
    >>> from nontwist import nontwisting, plot, simulate
    >>> how = {"t_end": 1, "step": 0.005, "integrator": "energy-momentum"}
    >>> run = simulate(nontwisting([3, 4, 5]), material_angular_velocity=(6, -18, 0), **how)
    >>> [line.get_label() for line in plot.multipliers(run).lines]
    ['$λ_{11}$', '$λ_{22}$', '$λ_{33}$', '$λ_{23}$', '$λ_{13}$', '$λ_{12}$', '$μ$']
    """

    def curves(run: Any, label: str) -> dict[str, Any]:
        remedy = "the integrator 'energy-momentum' gives those of every constraint"
        values = variable(run, label, "multipliers", remedy)
        names = {k: "$μ$" if k == "nh" else f"$λ_{{{k}}}$" for k in map(str, values["constraint"].values)}
        return {text: values.sel(constraint=k) for k, text in names.items()}

    ax, lines = over_time(runs, ax, curves, "multipliers", properties)
    if {line.get_label() for line in lines} == {"$μ$"}:
        ax.set_ylabel("multiplier $μ$" + unit(next(iter(labelled(runs).values()))["multipliers"]))
    return ax


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
        if "load_work" in run or run.attrs.get("load", "[]") != "[]":
            variable(run, label, "load_work")
            work = work_of(run)[0]
            balance -= work - work[0]
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
        named = getattr(quotient, "name", None) in (None, "second_quotient")
        if hasattr(quotient, "data_vars") or quotient.dims != ("time",) or not named:
            raise ValueError("pass the result of nontwist.comparison.second_quotient(run_h, run_h2, run_h4)")
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

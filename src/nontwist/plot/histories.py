"""Curves over time: momenta, directors, energy, reaction moment, multipliers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from ..geometry.values import among, shown
from .labels import labelled, symbol, unit, variable
from .timelines import over_time

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

    from .labels import Runs


def momenta(runs: Runs, ax: Axes | None = None, *, frame: Literal["space", "body"] = "space") -> list[Artist]:
    """Draw the three components of the spatial or the material angular momentum over time.

    Parameters
    ----------
    runs : Dataset, or dict of str to Dataset
        A run, or several to compare with their labels.
    ax : Axes, optional
        Where to draw; a new figure by default, one column wide, reached as ``artists[0].figure``.
    frame : "space" or "body"

    Returns
    -------
    list of Artist: the lines, run by run, one a component.

    Raises
    ------
    ValueError
        Not a run, or a run without the variables that are drawn; axes that are none; an unknown option.

    Examples
    --------
    >>> from nontwist import nontwisting, plot, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, material_angular_velocity=(6, -18, 0))
    >>> lines = plot.momenta(run, frame="body")
    >>> [round(float(line.get_ydata()[-1]), 6) + 0.0 for line in lines]
    [18.0, -72.0, 0.0]
    >>> plot.save(lines, "momenta.pdf", "momenta.png")
    """
    if not among(frame, ("space", "body")):
        raise ValueError(f"frame must be 'space' or 'body', got {shown(frame)}")
    name, dim = ("spatial_momentum", "axis") if frame == "space" else ("material_momentum", "director")

    def curves(run: Any, label: str) -> dict[str, Any]:
        momentum = variable(run, label, name)
        return {symbol(momentum, str(k)): momentum.sel({dim: k}) for k in momentum[dim].values}

    return over_time(runs, ax, curves)


def directors(runs: Runs, ax: Axes | None = None, *, director: int = 3) -> list[Artist]:
    """Draw the three spatial components of a director over time.

    Parameters
    ----------
    runs, ax
        As in `momenta`.
    director : 1, 2 or 3

    Returns
    -------
    list of Artist: the lines, run by run, one a component.

    Raises
    ------
    ValueError
        Not a run, or a run without the variables that are drawn; axes that are none; an unknown option.

    Examples
    --------
    >>> from nontwist import nontwisting, plot, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, material_angular_velocity=(1, 2, 0))
    >>> [line.get_label() for line in plot.directors(run, director=1)]
    ['$d_{1x}$', '$d_{1y}$', '$d_{1z}$']
    """
    if not among(director, (1, 2, 3)):
        raise ValueError(f"director must be 1, 2 or 3, got {shown(director)}")

    def curves(run: Any, label: str) -> dict[str, Any]:
        d = variable(run, label, "directors").sel(director=director)
        return {f"$d_{{{director}{x}}}$": d.sel(axis=x) for x in d["axis"].values}

    lines = over_time(runs, ax, curves)
    lines[0].axes.set_ylabel(f"director $d_{director}$")  # type: ignore[union-attr]
    return lines


def energy(runs: Runs, ax: Axes | None = None) -> list[Artist]:
    """Draw the kinetic energy over time; where dead forces act, potential and total energy as well.

    Parameters
    ----------
    runs, ax
        As in `momenta`.

    Returns
    -------
    list of Artist: the lines, run by run.

    Raises
    ------
    ValueError
        Not a run, or a run without the variables that are drawn; axes that are none; an unknown option.

    Examples
    --------
    >>> from nontwist import heavy_top, plot, simulate
    >>> top = heavy_top([2, 2, 1], mass=1.5, centre_of_mass=(0, 0, 0.6))
    >>> run = simulate(top, t_end=1, material_angular_velocity=(0.5, 0, 10))
    >>> [line.get_label() for line in plot.energy(run)]
    ['$K$', '$V$', '$K+V$']
    """

    def curves(run: Any, label: str) -> dict[str, Any]:
        K, V = (variable(run, label, f"{kind}_energy") for kind in ("kinetic", "potential"))
        return {symbol(K): K} | ({symbol(V): V, "$K+V$": K + V} if V.values.any() else {})

    lines = over_time(runs, ax, curves)
    axes: Any = lines[0].axes
    table = labelled(runs).values()
    if any(run["potential_energy"].values.any() for run in table):
        axes.set_ylabel("energy" + unit(next(iter(table))["kinetic_energy"]))
    else:
        axes.set_ylim(0, 1.15 * max(float(run["kinetic_energy"].max()) for run in table) or 1.0)
    return lines


def reaction_moment(runs: Runs, ax: Axes | None = None) -> list[Artist]:
    """Draw the moment by which the constraint acts on the body about its axis, mean over each stored interval.

    Parameters
    ----------
    runs, ax
        As in `momenta`.

    Returns
    -------
    list of Artist: the lines, one a run.

    Raises
    ------
    ValueError
        A body has no axis that it may not turn about.

    Examples
    --------
    >>> from nontwist import nontwisting, plot, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, material_angular_velocity=(6, -18, 0))
    >>> (line,) = plot.reaction_moment(run)
    >>> round(float(line.get_ydata()[-1]), 6)  # (J2 - J1) W1 W2
    -108.0
    """

    def curves(run: Any, label: str) -> dict[str, Any]:
        moment = variable(run, label, "reaction_moment", "its body may turn about every axis")
        return {symbol(moment): moment}

    return over_time(runs, ax, curves)


def multipliers(runs: Runs, ax: Axes | None = None) -> list[Artist]:
    """Draw the Lagrange multipliers, mean over each stored interval: λ of orthonormality, μ of the axis.

    Parameters
    ----------
    runs, ax
        As in `momenta`.

    Returns
    -------
    list of Artist: the lines, run by run, one a constraint.

    Raises
    ------
    ValueError
        A run has none.

    Examples
    --------
    >>> from nontwist import nontwisting, plot, simulate
    >>> how = {"t_end": 1, "step": 0.005, "integrator": "energy-momentum"}
    >>> run = simulate(nontwisting([3, 4, 5]), material_angular_velocity=(6, -18, 0), **how)
    >>> [line.get_label() for line in plot.multipliers(run)]
    ['$λ_{11}$', '$λ_{22}$', '$λ_{33}$', '$λ_{23}$', '$λ_{13}$', '$λ_{12}$', '$μ$']
    """

    def curves(run: Any, label: str) -> dict[str, Any]:
        remedy = "the integrator 'energy-momentum' gives those of every constraint"
        values = variable(run, label, "multipliers", remedy)
        names = {k: "$μ$" if k == "nh" else f"$λ_{{{k}}}$" for k in map(str, values["constraint"].values)}
        return {text: values.sel(constraint=k) for k, text in names.items()}

    lines = over_time(runs, ax, curves)
    axes: Any = lines[0].axes
    if {line.get_label() for line in lines} == {"$μ$"}:
        axes.set_ylabel("multiplier $μ$" + unit(next(iter(labelled(runs).values()))["multipliers"]))
    return lines

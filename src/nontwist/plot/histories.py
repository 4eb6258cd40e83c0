"""Curves over time: momenta, directors, energy, reaction moment, multipliers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

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
    """
    if frame not in ("space", "body"):
        raise ValueError(f"frame must be 'space' or 'body', got {frame!r}")
    name, dim = ("spatial_momentum", "axis") if frame == "space" else ("material_momentum", "director")

    def curves(run: Any, label: str) -> dict[str, Any]:
        momentum = variable(run, label, name)
        return {symbol(momentum, str(k)): momentum.sel({dim: k}) for k in momentum[dim].values}

    return over_time(runs, ax, curves)


def directors(runs: Runs, ax: Axes | None = None, *, director: int = 3) -> list[Artist]:
    """Draw the three spatial components of a director over time.

    Parameters and result as in `momenta`, and `director`: 1, 2 or 3.
    """
    if director not in (1, 2, 3):
        raise ValueError(f"director must be 1, 2 or 3, got {director!r}")

    def curves(run: Any, label: str) -> dict[str, Any]:
        d = variable(run, label, "directors").sel(director=director)
        return {f"$d_{{{director}{x}}}$": d.sel(axis=x) for x in d["axis"].values}

    lines = over_time(runs, ax, curves)
    lines[0].axes.set_ylabel(f"director $d_{director}$")  # type: ignore[union-attr]
    return lines


def energy(runs: Runs, ax: Axes | None = None) -> list[Artist]:
    """Draw the kinetic energy over time; where dead forces act, potential and total energy as well.

    Parameters and result as in `momenta`.
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

    Parameters and result as in `momenta`. Raises a ValueError where a body has no axis that it may not turn about.
    """

    def curves(run: Any, label: str) -> dict[str, Any]:
        moment = variable(run, label, "reaction_moment", "its body may turn about every axis")
        return {symbol(moment): moment}

    return over_time(runs, ax, curves)


def multipliers(runs: Runs, ax: Axes | None = None) -> list[Artist]:
    """Draw the Lagrange multipliers, mean over each stored interval: λ of orthonormality, μ of the axis.

    Parameters and result as in `momenta`. Raises a ValueError where a run has none.
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

"""Curves over time: momenta, energy, second quotient of precision."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from .style import new_axes, style

if TYPE_CHECKING:
    import xarray
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes


def momenta(run: xarray.Dataset, ax: Axes | None = None, *, frame: Literal["space", "body"] = "space") -> list[Artist]:
    """Draw the three components of the spatial or the material angular momentum over time.

    Parameters
    ----------
    run : Dataset
    ax : Axes, optional
        Where to draw; a new figure by default, reached as ``artists[0].figure``.
    frame : "space" or "body"

    Returns
    -------
    list of Artist, one line a component.
    """
    if frame not in ("space", "body"):
        raise ValueError(f"frame must be 'space' or 'body', got {frame!r}")
    word, letter = ("spatial", "π") if frame == "space" else ("material", "Π")
    ax = ax or new_axes()[0]
    with style():
        lines: list[Artist] = []
        cycle = _cycle()
        for k, label in enumerate("xyz" if frame == "space" else "123"):
            lines += ax.plot(run["time"], run[f"{word}_momentum"][:, k], label=rf"${letter}_{label}$", **cycle[k])
        _time_axis(ax, run, f"{word} momentum ${letter}$ (kg m²/s)")
        ax.margins(y=0.22)
        ax.legend(ncols=3, loc="upper center", bbox_to_anchor=(0.5, 1.02), columnspacing=1.2)
    return lines


def energy(run: xarray.Dataset, ax: Axes | None = None) -> list[Artist]:
    """Draw the kinetic energy over time; where dead forces act, potential and total energy as well.

    Parameters and result as in `momenta`.
    """
    ax = ax or new_axes()[0]
    curves = {"K": run["kinetic_energy"]}
    if abs(run["potential_energy"]).max() > 0:
        curves |= {"V": run["potential_energy"], "K+V": run["kinetic_energy"] + run["potential_energy"]}
    with style():
        lines: list[Artist] = []
        cycle = _cycle()
        for k, (label, curve) in enumerate(curves.items()):
            lines += ax.plot(run["time"], curve, label=f"${label}$", **cycle[k])
        _time_axis(ax, run, "kinetic energy (J)" if len(curves) == 1 else "energy (J)")
        if len(curves) > 1:
            ax.legend()
        else:
            ax.set_ylim(0, 1.15 * float(curves["K"].max()) or 1.0)
    return lines


def second_quotient(quotient: xarray.DataArray, ax: Axes | None = None, *, order: int = 2) -> list[Artist]:
    """Draw the second quotient of precision over time, with the limit 2^order.

    Parameters
    ----------
    quotient : DataArray
        From `nontwist.second_quotient`.
    ax : Axes, optional
    order : int

    Returns
    -------
    list of Artist: the curve and the limit.
    """
    ax = ax or new_axes()[0]
    limit = 2**order
    with style():
        cycle = _cycle()
        reach = max(0.05, 1.3 * float(abs(quotient - limit).quantile(0.98)))
        lines: list[Artist] = list(ax.plot(quotient["time"], quotient, **cycle[0]))
        lines.append(ax.axhline(limit, color="0.6", linewidth=0.6, zorder=0))
        _time_axis(ax, quotient, r"second quotient $Q_\mathrm{II}$ (–)")
        ax.set_ylim(limit - reach, limit + reach)
    return lines


def _cycle() -> list[dict[str, Any]]:
    import matplotlib

    return list(matplotlib.rcParams["axes.prop_cycle"])


def _time_axis(ax: Axes, data: xarray.Dataset | xarray.DataArray, label: str) -> None:
    time = data["time"].values
    ax.set_xlim(min(time[0], 0) if time[0] < 0.05 * time[-1] else time[0], time[-1])
    ax.set_xlabel("time (s)")
    ax.set_ylabel(label)

"""The figure of a fit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..plot.journals import new_axes, style
from ..plot.looks import cycle

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .result import Fit


def drawn(fit: Fit, recording: int) -> Axes:
    """Draw data and model, residuals, and principal moments with their intervals; return the first axes."""
    part, found = fit.parts[recording], fit.principal
    first = sum(len(one.time) for one in fit.parts[:recording])
    rest = fit.residual[first : first + len(part.time)]
    with style():
        data, left_over, moments = new_axes(columns=2, height=2.6, panels=3)
        for k, name in enumerate("xyz"):
            colour = cycle()[k]["color"]
            data.plot(part.time, part.measured[:, k], ".", color=colour, markersize=2)
            data.plot(part.time, part.model[:, k], "-", color=colour, linewidth=0.8, label=name)
            left_over.plot(part.time, rest[:, k], ".", color=colour, markersize=2)
        data.set(xlabel="time $t$ (s)", ylabel="angular velocity (rad s$^{-1}$)", title="data and model")
        low, high = data.get_ylim()
        data.set_ylim(low, high + 0.15 * (high - low))  # room for the legend
        data.legend(loc="upper left", ncols=3, handlelength=1.2, columnspacing=0.8)
        for level in (-2, 2):
            left_over.axhline(level * fit.noise, color="0.5", linewidth=0.6, linestyle="--")
        unit = "rad s$^{-1}$" if fit.has_gyroscope else "rad"
        left_over.set(xlabel="time $t$ (s)", ylabel=f"residual ({unit})", title="residual and 2 σ")
        shown = np.flatnonzero(np.isfinite(found.moments))
        if len(shown):
            value = found.moments[shown]
            errors = abs(found.intervals[shown].T - value)
            moments.errorbar(shown + 1, value, errors, fmt="o", markersize=3, capsize=4, color="0.1")
        how: dict[str, Any] = {"ha": "center", "va": "center", "rotation": 90, "color": "0.4"}
        for k in set(range(3)) - set(shown.tolist()):
            moments.text(k + 1, 0.45, "undetermined", transform=moments.get_xaxis_transform(), **how)
        top = 0.56
        if fit.unit:
            top = 1.1 * max([fit.size / 3, *found.intervals[shown, 1]])
            label = "moment (kg m$^2$)" if fit.unit == "kg m²" else "moment / (m|c|) (m)"
        else:
            moments.axhline(0.5, color="0.5", linewidth=0.6, linestyle=":")
            label = "moment / sum; dotted: flat bodies"
        moments.set(xlim=(0.5, 3.5), ylim=(0, top), xticks=[1, 2, 3], title="principal moments")
        moments.set(xlabel="axis", ylabel=label)
    return data

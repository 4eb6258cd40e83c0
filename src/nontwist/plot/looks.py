"""Looks of curves, and the legend that explains them.

One run: each component has a colour and a line style. One component of several runs: each run has them. Several
components of several runs: the colour shows the component, the line style the run. The first three colours differ in
grey as well; from the fifth on, colours repeat, with markers where line styles belong to runs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .labels import visible

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Look = dict[str, Any]
COLOURS, _MARKS = 4, "os^D"
_CHARACTER, _HANDLE = 0.45, 4.0  # widths in a legend, in font sizes
_ROW = 0.15  # in
_ABOVE: Look = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0)}
_BELOW: Look = {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0)}


def cycle() -> list[Look]:
    """Return the looks of the style file, colour and line style each."""
    import matplotlib

    return list(matplotlib.rcParams["axes.prop_cycle"])


def looks(components: list[str], runs: list[str]) -> dict[tuple[str, str], Look]:
    """Return the look of every component of every run."""
    own = cycle()
    most = max(len(components), len(runs))
    if most > len(own):
        raise ValueError(f"{most} curves cannot be told apart, at most {len(own)}: choose fewer runs")
    if len(runs) == 1 or len(components) == 1:
        return {(c, r): own[max(i, k)] for k, r in enumerate(runs) for i, c in enumerate(components)}
    return {
        (c, r): {"color": own[i]["color"], "linestyle": own[k]["linestyle"]} | _mark(i)
        for k, r in enumerate(runs)
        for i, c in enumerate(components)
    }


def _mark(i: int) -> Look:
    return {} if i < COLOURS else {"marker": _MARKS[i - COLOURS], "markevery": 0.15, "markersize": 3}


def handle(label: str, look: Look) -> Any:
    """Return the legend handle of a curve."""
    from matplotlib.lines import Line2D

    return Line2D([], [], label=label, **look)


def explain(ax: Axes, components: list[str], runs: list[str]) -> None:
    """Put a legend of components and runs above the axes; none for a single curve."""
    own = cycle()
    if len(runs) > 1 and len(components) > 1:
        by_component = [handle(c, {"color": own[i]["color"]} | _mark(i)) for i, c in enumerate(components)]
        by_run = [handle(r, {"color": "0.35", "linestyle": own[k]["linestyle"]}) for k, r in enumerate(runs)]
        legend(ax, [by_component, by_run])
    elif len(names := runs if len(runs) > 1 else components) > 1:
        legend(ax, [[handle(name, look) for name, look in zip(names, own, strict=False)]])


def legend(ax: Axes, groups: list[list[Any]], below: bool = False) -> None:
    """Put rows of a legend above (or `below`) the axes; groups that do not fit in one row start new ones."""
    from matplotlib.transforms import ScaledTranslation

    rows = _rows(groups, _available_width(ax))
    step = ScaledTranslation(0, -_ROW if below else _ROW, ax.figure.dpi_scale_trans)
    place = ax.transAxes
    for k, row in enumerate(rows if below else rows[::-1]):
        own = ax.legend(handles=row, ncols=len(row), bbox_transform=place, **_BELOW if below else _ABOVE)
        place = place + step
        if k + 1 < len(rows):  # the axes hold one legend by themselves
            ax.add_artist(own)


def _rows(groups: list[list[Any]], available: float) -> list[list[Any]]:
    handles = [handle for group in groups for handle in group]
    if _width(handles) <= available:
        return [handles]
    rows: list[list[Any]] = []
    for group in groups:
        rows.append([])
        for handle in group:
            if rows[-1] and _width([*rows[-1], handle]) > available:
                rows.append([])
            rows[-1].append(handle)
    return rows


def _width(handles: list[Any]) -> float:
    """Return the estimated width of a row, in."""
    import matplotlib

    letters = sum(visible(str(handle.get_label())) for handle in handles)
    return float((_HANDLE * len(handles) + _CHARACTER * letters) * matplotlib.rcParams["legend.fontsize"] / 72)


def _available_width(ax: Axes) -> float:
    """Return the width that a legend may take, in: the figure's share of the axes without their labels."""
    figure, spec = ax.figure, ax.get_subplotspec()
    width = figure.bbox.width / figure.dpi
    return float(width / (spec.get_gridspec().ncols if spec else 1) - (0.5 if ax.axison else 0.1))

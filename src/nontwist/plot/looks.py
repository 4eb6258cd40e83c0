"""Looks of curves, and the legend that explains them.

One run: each component has a colour and a line style, in some figures its own. One component of several runs: each run
has them, by its place alone, so that it looks the same in all figures. Several components of several runs: the colour
shows the component, the line style the run. Colours are those of the pages, and differ in grey as well; from the fifth
on they repeat, with markers where line styles belong to runs. Properties that a caller gives count for all curves and
for the legend.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..analysis.datasets import RUN, as_dataset
from ..analysis.variables import VARIABLES
from ..geometry.arrays import Axes, DataArray, Dataset
from ..viewer.drawing import colours

Look = dict[str, Any]
CURVES = ("d1", "d2", "d3", "twist")  # the names of the colours
COLOURS, _MARKS = len(CURVES), "os^D"
STYLES: tuple[Any, ...] = (
    *("-", (0, (5, 1.5)), (0, (6, 1.5, 1, 1.5)), (0, (1, 1.2))),
    *((0, (6, 1.2, 1, 1.2, 1, 1.2)), (0, (9, 2)), (0, (2.5, 1.2)), (0, (9, 1.5, 2.5, 1.5))),
)
LEAST = 3.0  # contrast with white of what must be seen
_CHARACTER, _HANDLE = 0.45, 4.0  # widths in a legend, in font sizes
_ROW = 1.35  # height of a row of a legend, in font sizes
_ABOVE: Look = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0)}
_BELOW: Look = {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0)}


def property_cycle() -> Any:
    """Return colours and line styles as a cycle of properties of Matplotlib."""
    from cycler import cycler

    ink = colours()
    return cycler(color=2 * [ink[name] for name in CURVES]) + cycler(linestyle=STYLES)


def cycle(*first: str) -> list[Look]:
    """Return the looks of curves, colour and line style each: those of the user, or ours, with these colours first."""
    import matplotlib

    users, ours = matplotlib.rcParams["axes.prop_cycle"], property_cycle()
    if users != ours:
        return [{**own, **look} for own, look in zip(ours, itertools.cycle(users), strict=False)]
    ink, others = colours(), [name for name in 2 * CURVES if name not in first]
    return [look | {"color": ink[name]} for look, name in zip(ours, [*first, *others, *first], strict=False)]


def given_look(properties: Look, function: str, kind: str = "Line2D") -> Look:
    """Return properties of curves that a caller has given, by their whole names.

    Raises
    ------
    ValueError
        One that artists of this kind do not have, or that has no such value.
    """
    from matplotlib import cbook, collections, lines

    makers: dict[str, Any] = {"Line2D": lines.Line2D, "PolyCollection": collections.PolyCollection}
    try:
        whole: Look = cbook.normalize_kwargs(properties, makers[kind])
        makers[kind]([], **({"ydata": []} if kind == "Line2D" else {}), **whole)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"plot.{function} accepts its own arguments and properties of matplotlib's {kind}; got "
            f"{', '.join(properties)}: {error}"
        ) from error
    return whole


def shade(colour: Any) -> Any:
    """Return a colour of figures in black on white in those of the style: white is its ground, black its letters."""
    import matplotlib
    from matplotlib.colors import to_rgb, to_rgba

    *rgb, alpha = to_rgba(matplotlib.rcParams["figure.facecolor"])
    ground, ink = (1 - alpha * (1 - x) for x in rgb), to_rgb(matplotlib.rcParams["text.color"])
    return tuple(part * a + (1 - part) * b for part, a, b in zip(to_rgb(colour), ground, ink, strict=True))


def shaded(look: Look) -> Look:
    """Return a look with its colours in those of the style."""
    return {key: shade(value) if "color" in key else value for key, value in look.items()}


def contrast(colour: Any, ground: Any = "white") -> float:
    """Return the contrast of a colour with the ground, 1 to 21, by the formula of WCAG."""
    from matplotlib.colors import to_rgb

    both = np.array([to_rgb(colour), to_rgb(ground)])
    linear = np.where(both <= 0.04045, both / 12.92, ((both + 0.055) / 1.055) ** 2.4) @ (0.2126, 0.7152, 0.0722) + 0.05
    return float(linear.max() / linear.min())


def pale(colour: Any) -> Any:
    """Return a colour mixed with the ground as far as their contrast allows; one that has too little as it is."""
    from matplotlib.colors import to_rgb

    ground = shade("white")
    mixes = (
        tuple(g - part / 20 * (g - x) for g, x in zip(ground, to_rgb(colour), strict=True)) for part in range(1, 20)
    )
    return next((mix for mix in mixes if contrast(mix, ground) >= LEAST), colour)


def looks(
    components: list[str], runs: list[str], given: Look, first: tuple[str, ...] = ()
) -> dict[tuple[str, str], Look]:
    """Return the look of every component of every run."""
    own = cycle(*(first if len(runs) == 1 or len(components) > 1 else ()))  # runs know of no colours of components
    most = max(len(components), len(runs))
    if most > len(own):
        raise ValueError(f"{most} curves cannot be distinguished, at most {len(own)}: choose fewer runs")
    found: dict[tuple[str, str], Look] = {}
    for (k, run), (i, component) in itertools.product(enumerate(runs), enumerate(components)):
        look = own[max(i, k)]
        if len(runs) > 1 and len(components) > 1:
            look = {"color": own[i]["color"], "linestyle": own[k]["linestyle"]}
            if i >= COLOURS:
                look |= {"marker": _MARKS[i - COLOURS], "markevery": 0.15, "markersize": 3}
        found[component, run] = look | given
    return found


def handle(label: str, look: Look) -> Any:
    """Return the legend handle of a curve."""
    from matplotlib.lines import Line2D

    return Line2D([], [], **look | {"label": label})


def explain(ax: Axes, look: dict[tuple[str, str], Look], given: Look) -> None:
    """Put a legend of components and runs with these looks above the axes; none for a single curve."""
    components, runs = (list(dict.fromkeys(names)) for names in zip(*look, strict=True))
    if len(runs) > 1 and len(components) > 1:
        by_component = [handle(c, look[c, runs[0]] | {"linestyle": "-"} | given) for c in components]
        grey = {"color": shade("0.35"), "marker": ""} | given
        legend(ax, [by_component, [handle(r, look[components[0], r] | grey) for r in runs]])
    elif len(names := runs if len(runs) > 1 else components) > 1:
        legend(ax, [[handle(name, one) for name, one in zip(names, look.values(), strict=True)]])


def legend(ax: Axes, groups: list[list[Any]], below: bool = False) -> None:
    """Put rows of a legend above (or `below`) the axes; groups that do not fit in one row start new ones."""
    from matplotlib.transforms import ScaledTranslation

    rows = _rows(groups, _available_width(ax))
    row_height = _ROW * _legend_size()
    step = ScaledTranslation(0, -row_height if below else row_height, ax.figure.dpi_scale_trans)
    place = ax.transAxes
    if not below and _has_exponent(ax):
        place = place + step
    for k, row in enumerate(rows if below else rows[::-1]):
        own = ax.legend(handles=row, ncols=len(row), bbox_transform=place, **_BELOW if below else _ABOVE)
        place = place + step
        if k + 1 < len(rows):  # the axes hold one legend by themselves
            ax.add_artist(own)


def _has_exponent(ax: Axes) -> bool:
    """Whether a factor such as ×10⁻⁷ stands above the vertical axis."""
    formatter = ax.yaxis.get_major_formatter()
    formatter.format_ticks(list(ax.get_yticks()))
    return bool(formatter.get_offset())


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
    letters = sum(visible(str(handle.get_label())) for handle in handles)
    return (_HANDLE * len(handles) + _CHARACTER * letters) * _legend_size()


def _legend_size() -> float:
    """Return the font size of legends, in."""
    import matplotlib
    from matplotlib.font_manager import FontProperties

    return float(FontProperties(size=matplotlib.rcParams["legend.fontsize"]).get_size_in_points()) / 72


def _available_width(ax: Axes) -> float:
    """Return the width that a legend may take, in: the figure's share of the axes without their labels."""
    figure, spec = ax.figure, ax.get_subplotspec()
    width = figure.bbox.width / figure.dpi
    return float(width / (spec.get_gridspec().ncols if spec else 1) - (0.5 if ax.axison else 0.1))


# Labels of axes and curves: runs with their labels, symbols and units from the attributes of the data.


Runs = Dataset | Mapping[str, Dataset]
Quotients = DataArray | Mapping[str, DataArray]

_LINE = 32  # characters along an axis 2 in long


def labelled(runs: Any) -> dict[str, Any]:
    """Return `runs` as a dictionary from labels to runs; a single run has the label ''.

    Raises
    ------
    ValueError
        Neither a run nor a mapping of runs, or an ensemble.
    """
    table = {"": runs} if hasattr(runs, "dims") else dict(runs) if isinstance(runs, Mapping) else {}
    if not table or not all(hasattr(run, "dims") for run in table.values()):
        got = {name: type(run).__name__ for name, run in table.items()} or type(runs).__name__
        raise ValueError(f"give a run (a Dataset), or several as {{'a label': run, 'another': run2}}; got {got}")
    for name, run in table.items():
        if "member" in run.dims:
            raise ValueError(f"{_named(name)} is an ensemble: choose a member, run.isel(member=0)")
        if not run.sizes.get("time"):
            raise ValueError(f"{_named(name)} has no times: nothing can be drawn over time")
    return {str(name): as_dataset(run, RUN) if hasattr(run, "data_vars") else run for name, run in table.items()}


def variable(run: Any, label: str, name: str, remedy: str = "") -> Any:
    """Return the variable `name` of a run; a ValueError with the `remedy` where it has none."""
    run = as_dataset(run, RUN)
    if name not in run:
        has_intervals = "midtime" in run.dims or VARIABLES[name][0][0] != "midtime"
        why = remedy if has_intervals else "what resample returns, and members of ensembles, have nothing of intervals"
        raise ValueError(f"{_named(label)} has no {name}: {why or 'it has ' + ', '.join(map(str, run))}")
    return as_dataset(run, RUN, (name,))[name]


def _named(label: str) -> str:
    return f"the run {label!r}" if label else "the run"


def symbol(data: Any, index: str = "") -> str:
    """Return the symbol of a variable, with an index, as mathematical text; an index replaces the i of d_i."""
    text = re.sub(r"_(\w\w+)", r"_{\\mathrm{\1}}", data.attrs.get("symbol", data.name))
    if index and "_i" in text:
        return f"${text.replace('_i', f'_{{{index}}}')}$"
    return f"${text}_{{{index}}}$" if index else f"${text}$"


def unit(data: Any) -> str:
    """Return the unit of a variable, as in ' (kg m² s⁻¹)'; "" where it has none."""
    text = data.attrs.get("units", "1")
    return "" if text == "1" else " (" + re.sub(r"(?<=[A-Za-z])(-?\d+)", r"$^{\1}$", text) + ")"


def axis_label(data: Any) -> str:
    """Return name, symbol and unit of a variable, in one line or, where they are long, in two."""
    name = str(data.name).replace("_", " ")
    end = (symbol(data) if "symbol" in data.attrs else "") + unit(data)
    return name + ("\n" if visible(name + end) > _LINE else " ") + end


def visible(text: str) -> int:
    """Return the approximate number of visible characters of a text with mathematics."""
    return len(re.sub(r"\\[a-z]+|[${}_^\\]", "", text))

"""A figure of one quantity over one or two swept keys."""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.arrays import Array
from ..plot.journals import column_width, new_axes, style
from ..plot.looks import symbol, unit
from .reading import open_sweep
from .store import open_store

if TYPE_CHECKING:
    from matplotlib.artist import Artist

MOST = 200_000  # members that are drawn
DENSE = 300  # points from which on dots replace discs
MOST_TICKS, GAP = 8, 4  # along x; points between their labels


def draw(store: str | os.PathLike[str], keys: Sequence[str], quantity: str, ax: Any = None) -> Any:
    """Draw a result of a sweep over swept keys.

    Parameters
    ----------
    store : path
    keys : 1 or 2 str
        Swept keys, or components of them: "body.axis", "body.axis.0".
    quantity : str
        A variable, or a component of it; of a vector the length is drawn.
    ax : Axes, optional
        A new figure, one column wide, by default.

    Returns
    -------
    Axes
        Its labels name components as the columns of exported tables do.

    Raises
    ------
    ValueError
        A key that was not swept, a quantity that was not kept or that no member has, or a whole matrix.
    """
    data, kept = open_sweep(store), open_store(store)
    sweep = kept.members.sweep
    swept = [one.key for one in sweep.over]
    every = -(-data.sizes["member"] // MOST)
    shown = data.isel(member=slice(None, None, every))
    x = [_numbers(shown, key, swept, "was not swept") for key in keys]
    results = [str(name) for name in data.data_vars if name not in swept]
    y = _numbers(shown, quantity, results, "was not kept")
    finite = np.isfinite(y)
    if not finite.any():
        raise ValueError(f"no member has a {quantity}: none is done, or all have failed")
    with style():
        if ax is None:
            ax = new_axes(height=column_width() * (0.7 if len(keys) == 1 else 0.85))[0]
        label = _label(data, quantity, results)
        parts = [_split(key, swept, "was not swept") for key in keys]
        names = [_column(data, *part) + unit(data[part[0]]) for part in parts]
        ax.set_xlabel(names[0])
        if len(keys) == 1:
            ax.set_ylabel(label)
            _curve(ax, x[0][finite], y[finite], sweep)
            _logarithmic(ax, keys, sweep)
            _spread_ticks(ax)
            return ax
        ax.set_ylabel(names[1])
        drawn = _map(ax, x[0], x[1], y, sweep, keys) or _dots(ax, x[0][finite], x[1][finite], c=y[finite])
        ax.figure.colorbar(drawn[0], ax=ax, label=label)
        _logarithmic(ax, keys, sweep)
        _spread_ticks(ax)
        return ax


def _spaced_logarithmically(sweep: Any) -> list[str]:
    return [one.key for one in sweep.over if getattr(one, "spacing", "") == "log" and one.start > 0]


def _logarithmic(ax: Any, keys: Sequence[str], sweep: Any) -> None:
    """Make the axes of keys logarithmic whose values are spaced so."""
    for key, axis in zip(keys, "xy", strict=False):
        if key in _spaced_logarithmically(sweep):
            ax.set(**{f"{axis}scale": "log"})


def _dots(ax: Any, x: Array, y: Array, **colour: Any) -> list[Artist]:
    size = 9 if len(x) < DENSE else max(0.3, 9 * DENSE / len(x))
    return [ax.scatter(x, y, s=size, linewidths=0, rasterized=len(x) > 5000, **colour)]


def _curve(ax: Any, x: Array, y: Array, sweep: Any) -> None:
    """Draw a line where one key alone was swept, along a grid or a list; dots else."""
    if len(sweep.over) == 1 and len(sweep.axes) == 1 and sweep.samples == 1:
        order = np.argsort(x, kind="stable")
        ax.plot(x[order], y[order], marker="." if len(x) < 50 else None)
    else:
        _dots(ax, x, y)


def _map(ax: Any, x: Array, y: Array, values: Array, sweep: Any, keys: Sequence[str]) -> list[Artist]:
    """Cells, where the sweep is the product of two grids and nothing else."""
    whole = [one.key for one in sweep.axes]
    if sweep.drawn or sweep.combine != "product" or sorted(whole) != sorted(keys) or len(values) != sweep.members:
        return []
    shape = sweep.shape
    order = [whole.index(key) for key in keys]
    grids = (x.reshape(shape).transpose(order)[:, 0], y.reshape(shape).transpose(order)[0])
    logarithmic = _spaced_logarithmically(sweep)
    a, b = (_borders(one, key in logarithmic) for one, key in zip(grids, keys, strict=True))
    places = [np.argsort(one) for one in grids]
    cells = values.reshape(shape).transpose(order)[np.ix_(*places)]
    return [ax.pcolormesh(a, b, cells.T, shading="flat", rasterized=True)]


def _borders(values: Array, logarithmic: bool) -> Array:
    """Return the borders of the cells of a grid, half way between its values, increasing."""
    x = np.sort(np.log(values) if logarithmic else values)
    gaps = np.diff(x) if len(x) > 1 else np.array([1.0])
    borders = np.concatenate([x[:1] - gaps[:1] / 2, x[:-1] + gaps[: len(x) - 1] / 2, x[-1:] + gaps[-1:] / 2])
    found: Array = np.exp(borders) if logarithmic else borders
    return found


def _split(name: str, known: Sequence[str], fault: str) -> tuple[str, list[int]]:
    """Return the variable that a name begins with, and the components that follow."""
    base = max((one for one in known if name == one or name.startswith(f"{one}.")), key=len, default=None)
    rest = name[len(base) + 1 :].split(".") if base is not None and name != base else []
    if base is None or not all(part.isdecimal() for part in rest):
        raise ValueError(f"{name} {fault}; known are {', '.join(known)}, and their components, as in {known[0]}.0")
    return base, [int(part) for part in rest]


def _numbers(data: Any, name: str, known: Sequence[str], fault: str) -> Array:
    base, place = _split(name, known, fault)
    values: Array = np.asarray(data[base].values, dtype=np.float64)
    if len(place) > values.ndim - 1 or any(k >= n for k, n in zip(place, values.shape[1:], strict=False)):
        raise ValueError(f"{base} has components {' × '.join(f'0 to {n - 1}' for n in values.shape[1:])}, not {name}")
    entry: Any = (slice(None), *place)
    values = values[entry]
    if values.ndim > 2:
        last = ".".join(str(n - 1) for n in values.shape[1:])
        size = " × ".join(map(str, values.shape[1:]))
        raise ValueError(
            f"{name} is a matrix, {size}, which has no length; name one of its components, as in {name}.{last}"
        )
    return values if values.ndim == 1 else np.sqrt((values * values).sum(axis=1))


def _label(data: Any, name: str, known: Sequence[str]) -> str:
    base, place = _split(name, known, "was not kept")
    variable = data[base]
    if " " in variable.attrs.get("symbol", " "):  # of a reduction, which repeats the name
        return name.replace("_", " ") + unit(variable)
    text = symbol(variable, "".join(_labels(data, base, place)))
    length = variable.ndim - 1 > len(place)
    words = _column(data, base, place) if place else base.replace("_", " ")
    return f"{words} {f'|{text}|' if length else text}{unit(variable)}"


def _labels(data: Any, base: str, place: Sequence[int]) -> list[str]:
    """Return the labels of a component, as the columns of exported tables have them."""
    return [str(data[dim].values[k]) for dim, k in zip(data[base].dims[1:], place, strict=False)]


def _column(data: Any, base: str, place: Sequence[int]) -> str:
    """Return the name of a component, as the columns of exported tables are called: quaternion_z."""
    return "_".join([base, *_labels(data, base, place)])


def _spread_ticks(ax: Any) -> None:
    """Take as many ticks along x as have labels that do not touch."""
    from matplotlib.ticker import MaxNLocator

    for count in range(MOST_TICKS, 1, -1) if ax.get_xscale() == "linear" else ():
        ax.xaxis.set_major_locator(MaxNLocator(count, steps=[1, 2, 2.5, 5, 10]))
        ax.figure.draw_without_rendering()
        low, high = sorted(ax.get_xlim())
        ticks = [tick for tick in ax.xaxis.get_major_ticks() if low <= tick.get_loc() <= high]
        boxes = [tick.label1.get_window_extent() for tick in ticks]
        room = GAP * ax.figure.dpi / 72
        if all(one.x1 + room < two.x0 for one, two in pairwise(boxes)):
            break

"""A figure of one quantity over one or two swept keys."""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from ..geometry.arrays import Array
from ..plot.journals import column_width, new_axes, style
from ..plot.looks import symbol, unit
from .reading import dataset
from .store import open_store

if TYPE_CHECKING:
    from matplotlib.artist import Artist

MOST = 200_000  # members that are drawn
DENSE = 300  # points from which on dots replace discs
MOST_TICKS, GAP = 8, 4  # along x; points between their labels


def draw(store: str | os.PathLike[str], keys: Sequence[str], quantity: str) -> Any:
    """Draw a result of a sweep over swept keys.

    Parameters
    ----------
    store : path
    keys : 1 or 2 str
        Swept keys, or components of them: "body.axis", "body.axis.0".
    quantity : str
        A variable, or a component of it; of a vector the length is drawn.

    Returns
    -------
    Axes
        Of a new figure, one column wide. Its labels name components as the columns of exported tables do.

    Raises
    ------
    ValueError
        A key that was not swept, a quantity that was not kept or that no member has, or a whole matrix.
    """
    kept = open_store(store)
    data, sweep = dataset(kept), cast(Any, kept.members.sweep)
    swept = [one.key for one in sweep.over]
    across = [_component(data, key, swept, "was not swept") for key in keys]
    results = [str(name) for name in data.data_vars if name not in swept]
    drawn = _component(data, quantity, results, "was not kept")
    every = slice(None, None, -(-data.sizes["member"] // MOST))
    x, y = [one.numbers(every) for one in across], drawn.numbers(every)
    finite = np.isfinite(y)
    if not finite.any():
        raise ValueError(f"no member has a {quantity}: none is done, or all have failed")
    logarithmic = [one.key for one in sweep.over if getattr(one, "spacing", "") == "log" and one.start > 0]
    with style():
        ax: Any = new_axes(height=column_width() * (0.7 if len(keys) == 1 else 0.85))[0]
        ax.set_xlabel(across[0].column + unit(across[0].variable))
        if len(keys) == 1:
            ax.set_ylabel(drawn.label)
            _curve(ax, x[0][finite], y[finite], sweep)
        else:
            ax.set_ylabel(across[1].column + unit(across[1].variable))
            shown = _map(ax, x[0], x[1], y, sweep, keys, logarithmic) or _dots(
                ax, x[0][finite], x[1][finite], c=y[finite]
            )
            ax.figure.colorbar(shown, ax=ax, label=drawn.label)
        for key, axis in zip(keys, "xy", strict=False):
            if key in logarithmic:
                ax.set(**{f"{axis}scale": "log"})
        _spread_ticks(ax)
        return ax


class _Component(NamedTuple):
    """A variable of a store, or a component of it, under the name by which it was asked for."""

    name: str
    variable: Any
    place: list[int]

    def numbers(self, every: slice) -> Array:
        """Return the numbers of some members, of a vector its lengths."""
        shape, name = self.variable.shape[1:], self.variable.name
        if len(self.place) > len(shape) or any(k >= n for k, n in zip(self.place, shape, strict=False)):
            ends = " × ".join(f"0 to {n - 1}" for n in shape)
            raise ValueError(f"{name} has components {ends}, not {self.name}")
        entry: Any = (slice(None), *self.place)
        values: Array = np.asarray(self.variable[every].values, dtype=np.float64)[entry]
        if values.ndim > 2:
            last = ".".join(str(n - 1) for n in values.shape[1:])
            size = " × ".join(map(str, values.shape[1:]))
            raise ValueError(
                f"{self.name} is a matrix, {size}, which has no length; name one of its components, as in "
                f"{self.name}.{last}"
            )
        return values if values.ndim == 1 else np.sqrt((values * values).sum(axis=1))

    @property
    def labels(self) -> list[str]:
        """The labels of the component, as the columns of exported tables have them."""
        dims = self.variable.dims[1:]
        return [str(self.variable[dim].values[k]) for dim, k in zip(dims, self.place, strict=False)]

    @property
    def column(self) -> str:
        """The name of the component, as the columns of exported tables are called: quaternion_z."""
        return "_".join([str(self.variable.name), *self.labels])

    @property
    def label(self) -> str:
        """Name, symbol and unit; of a vector the symbol of its length."""
        if " " in self.variable.attrs.get("symbol", " "):  # of a reduction, which repeats the name
            return self.name.replace("_", " ") + unit(self.variable)
        text = symbol(self.variable, "".join(self.labels))
        words = self.column if self.place else self.column.replace("_", " ")
        length = self.variable.ndim - 1 > len(self.place)
        return f"{words} {f'|{text}|' if length else text}{unit(self.variable)}"


def _component(data: Any, name: str, known: Sequence[str], fault: str) -> _Component:
    """Return the variable that a name begins with, and the components that follow."""
    base = max((one for one in known if name == one or name.startswith(f"{one}.")), key=len, default=None)
    rest = name[len(base) + 1 :].split(".") if base is not None and name != base else []
    if base is None or not all(part.isdecimal() for part in rest):
        raise ValueError(f"{name} {fault}; known are {', '.join(known)}, and their components, as in {known[0]}.0")
    return _Component(name, data[base], [int(part) for part in rest])


def _dots(ax: Any, x: Array, y: Array, **colour: Any) -> Artist:
    size = 9 if len(x) < DENSE else max(0.3, 9 * DENSE / len(x))
    dots: Artist = ax.scatter(x, y, s=size, linewidths=0, rasterized=len(x) > 5000, **colour)
    return dots


def _curve(ax: Any, x: Array, y: Array, sweep: Any) -> None:
    """Draw a line where one key alone was swept, along a grid or a list; dots else."""
    if len(sweep.over) == 1 and len(sweep.axes) == 1 and sweep.samples == 1:
        order = np.argsort(x, kind="stable")
        ax.plot(x[order], y[order], marker="." if len(x) < 50 else None)
    else:
        _dots(ax, x, y)


def _map(
    ax: Any, x: Array, y: Array, values: Array, sweep: Any, keys: Sequence[str], logarithmic: Sequence[str]
) -> Artist | None:
    """Draw cells, where the sweep is the product of two grids and nothing else."""
    whole = [one.key for one in sweep.axes]
    if sweep.drawn or sweep.combine != "product" or sorted(whole) != sorted(keys) or len(values) != sweep.members:
        return None
    x, y, values = (one.reshape(sweep.shape).transpose([whole.index(key) for key in keys]) for one in (x, y, values))
    grids = x[:, 0], y[0]
    a, b = (_borders(one, key in logarithmic) for one, key in zip(grids, keys, strict=True))
    cells = values[np.ix_(*map(np.argsort, grids))]
    mesh: Artist = ax.pcolormesh(a, b, cells.T, shading="flat", rasterized=True)
    return mesh


def _borders(values: Array, logarithmic: bool) -> Array:
    """Return the borders of the cells of a grid, half way between its values, increasing."""
    x = np.sort(np.log(values) if logarithmic else values)
    ends = [2 * x[0] - x[1], *x, 2 * x[-1] - x[-2]] if len(x) > 1 else [x[0] - 1, x[0], x[0] + 1]
    borders: Array = np.convolve(ends, [0.5, 0.5], "valid")
    return np.exp(borders) if logarithmic else borders


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

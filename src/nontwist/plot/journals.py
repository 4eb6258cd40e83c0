"""Widths, type and files of figures.

Where `matplotlib.pyplot` has been imported a new figure is one of its own, so `plt.show()` and `plt.savefig()` find it.
Elsewhere it is made without pyplot, so nothing global changes, and a notebook shows it where a cell ends in its axes.

The style file and the journal say how a figure looks where the user's `matplotlib.rcParams` are Matplotlib's own
defaults; what the user has set is left as it is. A figure remembers the journal that it was made for.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from io import BytesIO
from pathlib import Path
from threading import RLock
from typing import TYPE_CHECKING, Any, cast

from ..geometry.arrays import Axes, as_positive
from ..geometry.values import among, as_path, as_whole, short_repr
from ..io.whole import require_free, written
from .looks import property_cycle

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

SANS = {
    "font.family": ["sans-serif"],
    "font.sans-serif": ["Arial", "Helvetica", "Liberation Sans", "Nimbus Sans", "DejaVu Sans"],
    "mathtext.fontset": "stixsans",
}
# One column and two columns (mm), and what differs from the style file.
JOURNALS: dict[str, tuple[float, float, dict[str, Any]]] = {
    "nontwist": (88.9, 182.88, {}),
    "springer": (84, 174, SANS),
    "elsevier": (90, 190, SANS),
}
MM = 1 / 25.4  # in
UNDATED = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
HIGHEST, MOST_PANELS = 100, 20
LETTERS = "abcdefghijklmnopqrst"
_journal = ContextVar("journal", default="nontwist")
_RC = RLock()  # for `matplotlib.rcParams`, which all threads share
_is_apart = ContextVar("apart", default=False)


@contextmanager
def style(journal: str | None = None) -> Iterator[None]:
    """Draw for a journal, in a `with` block: figures have the column widths and the fonts that it requires.

    The font size is 8 pt in print. Settings of `matplotlib.rcParams` that differ from Matplotlib's defaults take
    precedence, and so do those made inside the block. At its end all settings are restored.

    Parameters
    ----------
    journal : "nontwist", "springer" or "elsevier", optional
        Columns of 89 and 183 mm with STIX; 84 and 174 mm, or 90 and 190 mm, with Arial, Helvetica or the closest font
        on the machine. By default the journal of the enclosing block, or "nontwist".

    Raises
    ------
    ValueError
        The journal is unknown.

    Examples
    --------
    >>> from nontwist import nontwisting, plot, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, material_angular_velocity=(6, -18, 0))
    >>> with plot.style("springer"):
    ...     ax = plot.momenta(run)
    >>> round(float(25.4 * ax.figure.get_figwidth()), 6)  # mm
    84.0
    """
    import matplotlib

    if journal is not None and not among(journal, JOURNALS):
        raise ValueError(f"journal must be {', '.join(map(repr, JOURNALS))}, got {short_repr(journal)}")
    with _RC:
        token = _journal.set(_journal.get() if journal is None else journal)
        ours = _style_file() | JOURNALS[_journal.get()][2] | {"axes.prop_cycle": property_cycle()}
        users, defaults = cast(Any, matplotlib.rcParams), cast(Any, matplotlib.rcParamsDefault)
        left: Any = {key: value for key, value in ours.items() if users[key] == defaults[key]}
        try:
            with matplotlib.rc_context(left):
                yield
        finally:
            _journal.reset(token)


@contextmanager
def apart() -> Iterator[None]:
    """Draw figures for files, of which pyplot knows nothing."""
    token = _is_apart.set(True)
    try:
        yield
    finally:
        _is_apart.reset(token)


@cache
def _style_file() -> dict[str, Any]:
    from matplotlib import rc_params_from_file

    settings: Any = rc_params_from_file(Path(__file__).with_name("nontwist.mplstyle"), use_default_template=False)
    return dict(settings)


def column_width(columns: int = 1) -> float:
    """Return the width of one or two columns of the journal, in."""
    one, two, _ = JOURNALS[_journal.get()]
    return (one if columns == 1 else two) * MM


def axes_for(ax: Any, height: float | None = 2.4) -> Any:
    """Return `ax`, or new axes where it is None, square ones without a `height`; a ValueError where it is none."""
    from matplotlib.axes import Axes

    if ax is None:
        return new_axes(height=column_width() if height is None else height)[0]
    if not isinstance(ax, Axes):
        raise ValueError(f"ax must be the Axes of a figure of matplotlib, got {short_repr(ax)}")
    return ax


def new_axes(columns: int = 1, height: float = 2.4, panels: int = 1, *, letters: bool = True) -> list[Axes]:
    """Return the axes of a new figure for a journal, to be passed to the functions of `nontwist.plot`.

    Parameters
    ----------
    columns : 1 or 2
        Width of the figure: one column (89 mm) or two (183 mm) of a journal's page; other widths with `style`.
    height : float, in
    panels : int
        Number of axes, side by side.
    letters : bool
        Label several panels a, b, c at the upper left.

    Returns
    -------
    list of Axes, of length `panels`
        If `matplotlib.pyplot` has been imported, the figure is its current one. With or without pyplot, a notebook
        shows the figure if a cell ends in one of the axes.

    Raises
    ------
    ValueError
        `columns` is neither 1 nor 2, the height is not between 0 and 100 in, or there are not 1 to 20 panels.

    Examples
    --------
    >>> from nontwist import nontwisting, plot, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, material_angular_velocity=(6, -18, 0))
    >>> left, right = plot.new_axes(columns=2, panels=2)
    >>> ax = plot.momenta(run, left)
    >>> ax is left
    True
    >>> ax = plot.momenta(run, right, frame="body")
    >>> [text.get_text() for panel in (left, right) for text in panel.texts]
    ['a', 'b']
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    if not among(columns, (1, 2)):
        raise ValueError(f"columns must be 1 or 2 of a journal's page, got {short_repr(columns)}")
    height = float(as_positive(height, "height", (), "in"))
    if height > HIGHEST:
        raise ValueError(f"height must be at most {HIGHEST} in, got {height:g} in")
    panels = as_whole(panels, "panels", 1, MOST_PANELS)
    pyplot: Any = None if _is_apart.get() else sys.modules.get("matplotlib.pyplot")
    with style():
        how: dict[str, Any] = {"figsize": (column_width(columns), height), "layout": "constrained"}
        if pyplot is not None:
            figure, kind = pyplot.figure(**how), {}
        else:
            shown_figure, shown_axes = _shown()
            figure, kind = shown_figure(**how), {"axes_class": shown_axes}
            FigureCanvasAgg(figure)
        figure.journal = _journal.get()
        axes = list(figure.subplots(1, panels, squeeze=False, subplot_kw=kind)[0])
        for ax, letter in zip(axes, LETTERS if letters and panels > 1 else "", strict=False):
            place: dict[str, Any] = {"xycoords": _whole_place(ax), "textcoords": "offset points", "ha": "right"}
            ax.annotate(letter, (0, 1), (-5, 5), va="bottom", weight="bold", **place)
        return axes


def _whole_place(ax: Axes) -> Any:
    """Return coordinates in the place of axes, which those with equal scales do not fill."""
    from matplotlib.transforms import TransformedBbox

    return lambda _: TransformedBbox(ax.get_position(original=True), cast(Any, ax.figure).transSubfigure)


@cache
def _shown() -> tuple[type[Any], type[Any]]:
    """Return figures, and axes, that a notebook shows where a cell ends in them, without pyplot."""
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    class ShownFigure(Figure):
        journal = "nontwist"

        def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
            picture = BytesIO()
            with style(self.journal):
                self.draw_without_rendering()
                self.savefig(picture, format="png", dpi=200)
            return picture.getvalue(), {"width": round(100 * self.get_figwidth())}

    class ShownAxes(Axes):
        def _repr_png_(self) -> Any:
            figure: Any = self.figure
            return figure.figure._repr_png_()

    return ShownFigure, ShownAxes


def save(drawn: Axes | Figure | SubFigure, *paths: str | os.PathLike[str], force: bool = False) -> None:
    """Write a figure as PDF, SVG or PNG, with embedded fonts, 300 dots per inch and no date.

    The figure is laid out once, for the first file, so that all files look the same. Each file appears under its name
    only once it has been written completely to disk.

    Parameters
    ----------
    drawn : Axes or Figure
        Axes that a function of `nontwist.plot` returned, or a figure.
    paths : path
        One or more files; the suffix determines the format.
    force : bool
        Overwrite existing files.

    Raises
    ------
    ValueError
        `drawn` is neither Axes nor a Figure, there is no path, or a suffix is not that of a figure format; nothing is
        written.
    FileExistsError
        One of the files exists, and `force` is not set; nothing is written.
    BlockingIOError
        Another process is writing one of these files.
    OSError
        A folder does not exist or cannot be written, or the disk is full; a partial file is removed.

    Examples
    --------
    >>> from pathlib import Path
    >>> from nontwist import nontwisting, plot, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, material_angular_velocity=(6, -18, 0))
    >>> plot.save(plot.energy(run), "energy.pdf", "energy.png")
    >>> sorted(path.name for path in Path().iterdir())
    ['energy.pdf', 'energy.png']
    """
    own: Any = getattr(drawn, "figure", drawn)
    figure = getattr(own, "figure", own)  # of axes in a part of a figure, the whole
    if not hasattr(figure, "savefig"):
        raise ValueError(f"drawn must be axes that nontwist.plot returned, or a figure; got {short_repr(drawn)}")
    formats = require_places(*paths, force=force)
    layout = figure.get_layout_engine()
    with style(getattr(figure, "journal", None)):
        if layout is not None:
            figure.draw_without_rendering()  # ticks fit the axes that are laid out, and labels the ticks
        try:
            for path, form in zip(paths, formats, strict=True):
                picture = BytesIO()
                figure.savefig(picture, format=form, metadata=UNDATED.get(form))
                if layout is not None:
                    figure.set_layout_engine(None)  # the first file has laid it out
                with written(path, force=force) as file:
                    file.write(picture.getbuffer())
        finally:
            if layout is not None:
                figure.set_layout_engine(layout)


def require_places(*paths: str | os.PathLike[str], force: bool = False) -> list[str]:
    """Raise the errors of `save` at once, before long work; return the formats."""
    from matplotlib.backend_bases import FigureCanvasBase

    formats = [as_path(path, "path").suffix[1:].lower() for path in paths]
    for path, form in zip(paths, formats, strict=True):
        if form not in FigureCanvasBase.get_supported_filetypes():
            raise ValueError(f"{path}: the suffix {form!r} names no format of figures; use .pdf, .svg or .png")
    require_free(*paths, force=force)
    return formats

"""Sizes, style and files of all figures; figures are made without pyplot, so nothing global changes."""

from __future__ import annotations

import os
from contextlib import AbstractContextManager
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..geometry.arrays import as_positive
from ..geometry.values import among, as_path, as_whole, shown
from ..io.whole import require_free, written

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

ONE_COLUMN, TWO_COLUMNS = 3.5, 7.2  # inches: 89 mm and 183 mm
UNDATED = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
HIGHEST, MOST_PANELS = 100, 20


def style() -> AbstractContextManager[None]:
    """Return the context in which the package draws."""
    import matplotlib.style

    return matplotlib.style.context(str(Path(__file__).with_name("nontwist.mplstyle")))


def axes_for(ax: Any, height: float = 2.4) -> Any:
    """Return `ax`, or new axes where it is None; a ValueError where it is something else."""
    from matplotlib.axes import Axes

    if ax is None:
        return new_axes(height=height)[0]
    if not isinstance(ax, Axes):
        raise ValueError(f"ax must be the Axes of a figure of matplotlib, got {shown(ax)}")
    return ax


def new_axes(columns: int = 1, height: float = 2.4, panels: int = 1) -> list[Axes]:
    """Return the axes of a new figure for a journal, to be passed to the functions of `nontwist.plot`.

    Parameters
    ----------
    columns : 1 or 2
        Width of the figure: one column (3.5 in, 89 mm) or two (7.2 in, 183 mm) of a journal's page.
    height : float, in
    panels : int
        Axes side by side.

    Returns
    -------
    list of Axes, of length `panels`
        A notebook shows the figure where a cell ends in ``axes[0].figure``.

    Raises
    ------
    ValueError
        Neither 1 nor 2 columns, a height that is not between 0 and 100 in, not 1 to 20 panels.

    Examples
    --------
    >>> from nontwist import nontwisting, plot, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, material_angular_velocity=(6, -18, 0))
    >>> left, right = plot.new_axes(columns=2, panels=2)
    >>> drawn = plot.momenta(run, left) + plot.momenta(run, right, frame="body")
    >>> left.figure.get_size_inches()
    array([7.2, 2.4])
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    if not among(columns, (1, 2)):
        raise ValueError(f"columns must be 1 (3.5 in wide) or 2 (7.2 in), got {shown(columns)}")
    height = float(as_positive(height, "height", (), "in"))
    if height > HIGHEST:
        raise ValueError(f"height must be at most {HIGHEST} in, got {height:g} in")
    panels = as_whole(panels, "panels", 1, MOST_PANELS)
    with style():
        figure = _figure_class()(figsize=(ONE_COLUMN if columns == 1 else TWO_COLUMNS, height), layout="constrained")
        FigureCanvasAgg(figure)
        return list(figure.subplots(1, panels, squeeze=False)[0])


@cache
def _figure_class() -> type[Figure]:
    """Return figures that notebooks show; pyplot's own are shown by pyplot alone."""
    from matplotlib.figure import Figure

    class ShownFigure(Figure):
        def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
            picture = BytesIO()
            with style():
                self.savefig(picture, format="png", dpi=200)
            return picture.getvalue(), {"width": round(100 * self.get_figwidth())}

    return ShownFigure


def save(drawn: Figure | SubFigure | list[Artist], *paths: str | os.PathLike[str], force: bool = False) -> None:
    """Write a figure as PDF, SVG or PNG: fonts embedded, 300 dots an inch, no date inside.

    The figure is laid out once, for the first file, so that all show the same. Each file appears under its name only
    when it is complete and on the disk.

    Parameters
    ----------
    drawn : Figure, or the artists that a function of `nontwist.plot` returned
    paths : path, one file each; the suffix says the format
    force : bool
        Replace files of these names.

    Raises
    ------
    ValueError
        Neither a figure nor artists, no path, or a suffix that names no format of figures; nothing is written.
    FileExistsError
        There is a file of one of these names, and `force` was not given; nothing is written.
    BlockingIOError
        Another process writes one of these files.
    OSError
        A folder does not exist, cannot be written, or is full; a file that fails is removed.

    Examples
    --------
    >>> from pathlib import Path
    >>> from nontwist import nontwisting, plot, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, material_angular_velocity=(6, -18, 0))
    >>> plot.save(plot.energy(run), "energy.pdf", "energy.png")
    >>> sorted(path.name for path in Path().iterdir())
    ['energy.pdf', 'energy.png']
    """
    figure: Any = drawn[0].figure if isinstance(drawn, list) and drawn and hasattr(drawn[0], "figure") else drawn
    if not hasattr(figure, "savefig"):
        raise ValueError(f"drawn must be a figure, or artists that nontwist.plot returned; got {shown(drawn)}")
    formats = require_places(*paths, force=force)
    layout = figure.get_layout_engine()
    with style():
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
            raise ValueError(f"{path}: the suffix {form!r} names no format of figures; take .pdf, .svg or .png")
    require_free(*paths, force=force)
    return formats

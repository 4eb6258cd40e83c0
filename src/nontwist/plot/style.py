"""Sizes and the style of all figures; figures are made without pyplot, so nothing global changes."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ONE_COLUMN, TWO_COLUMNS = 3.35, 6.9  # inches: 85 mm and 175 mm
COLOURS = ("#0072B2", "#D55E00", "#000000")


def style() -> AbstractContextManager[None]:
    """Return the context in which the package draws."""
    import matplotlib.style

    return matplotlib.style.context(str(Path(__file__).with_name("nontwist.mplstyle")))


def new_axes(columns: int = 1, height: float = 2.2, panels: int = 1) -> list[Axes]:
    """Return the axes of a new figure, one or two columns wide (`height` in inches), panels side by side."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with style():
        figure = Figure(figsize=(ONE_COLUMN if columns == 1 else TWO_COLUMNS, height), layout="constrained")
        FigureCanvasAgg(figure)
        return list(figure.subplots(1, panels, squeeze=False)[0])

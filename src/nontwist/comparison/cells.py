"""Cells, headings, legends and notes of the tables of a comparison."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..analysis.datasets import as_dataset
from ..analysis.invariants import in_words
from ..geometry.arrays import Array
from .settings import short

if TYPE_CHECKING:
    import xarray
    from rich.table import Table

CONSERVED, NONE = 1e-13, "–"


TEXTS = ("integrator", "message", "invariant", "invariant_symbol", "family")
NUMBERS = (
    "step",
    "status",
    "takes_steps",
    *(
        f"{of}_{what}"
        for of in ("attitude", "momentum")
        for what in ("error_max", "order", "below_bar", "reference_error")
    ),
    "drift",
    "run_time",
)


def as_comparison(data: Any) -> Any:
    """Return `data`; a ValueError where it is not a comparison."""
    return as_dataset(data, "a comparison of nontwist.compare", NUMBERS, ("title", "shared_times", "reference"), TEXTS)


def empty_table(title: str, comparison: xarray.Dataset) -> Table:
    """Return a table without rows; many columns have no padding between them."""
    from rich import box
    from rich.table import Table

    gap = int(len(invariant_headings(comparison)) < 4)
    return Table(
        title=title,
        title_justify="left",
        caption_justify="left",
        caption_style="",
        box=box.SIMPLE_HEAD,
        show_edge=False,
        padding=(0, gap, 0, 0),
    )


def invariant_headings(comparison: xarray.Dataset) -> list[str]:
    """Return the headings of the columns of `invariant_drifts`."""
    headings = [f"drift\n{symbol}" for symbol in comparison["invariant_symbol"].values]
    return [*headings, "twist\nrad/s"] if "twist_defect" in comparison else headings


def invariant_legend(comparison: xarray.Dataset) -> str:
    """Return the legend of `invariant_headings`."""
    symbols, names = comparison["invariant_symbol"].values, comparison["invariant"].values
    drifts = ", ".join(f"{symbol} {in_words(name)}" for symbol, name in zip(symbols, names, strict=True))
    twist = "; twist: largest rate about the constrained axis" if "twist_defect" in comparison else ""
    return f"Largest relative drifts: {drifts}{twist}."


def invariant_drifts(runs: xarray.Dataset) -> list[Array]:
    """Return the drift of each invariant, and the twist defect where there is one, over the steps of `runs`."""
    drifts = list(runs["drift"].transpose("invariant", ...).values)
    return [*drifts, runs["twist_defect"].values] if "twist_defect" in runs else drifts


def largest(drifts: Array) -> float:
    """Return the largest drift of the completed runs; inf where there is none."""
    done = drifts[~np.isnan(drifts)]
    return float(done.max()) if done.size else np.inf


def numbered(notes: list[str], message: object) -> str:
    """Return the number of a message, added to `notes` if it is new; "" for "done"."""
    text = str(message).removeprefix("done").removeprefix("; ")
    if not text:
        return ""
    if text not in notes:
        notes.append(text)
    return f" \\[{notes.index(text) + 1}]"


def explained(notes: list[str]) -> list[str]:
    """Return the notes with their numbers, as rich markup."""
    from rich.markup import escape

    return [f"\\[{k + 1}] {escape(note)}" for k, note in enumerate(notes)]


def failed(status: ArrayLike) -> str:
    """Return the cell of a run without numbers."""
    return "[red]refused[/]" if np.asarray(status) < 0 else "[red]failed[/]"


def drift_cell(drift: float) -> str:
    """Return a drift, green where it is round-off."""
    text = short(drift, 0) if drift else "0"
    return f"[green]{text}[/]" if drift <= CONSERVED else text


def milliseconds(seconds: float) -> str:
    """Return seconds as milliseconds in three digits."""
    ms = 1e3 * seconds
    return NONE if np.isnan(ms) else f"{ms:.2f}" if ms < 10 else f"{ms:.1f}" if ms < 100 else f"{ms:.0f}"

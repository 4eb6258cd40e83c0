"""Runs of this package, in NetCDF."""

from __future__ import annotations

from pathlib import Path

from ...io.results import open_run
from ..options import ReadOptions
from .content import Content


def read_run(path: Path, how: ReadOptions) -> Content:
    """Read the attitudes of a run."""
    from ..motions import raw_motion

    run = open_run(path)
    found = raw_motion(run, how.scalar_first)
    return Content(bodies={path.stem: found.values}, time=found.time, notes=("orientation: a run of this package",))

"""Runs of this package, in NetCDF."""

from __future__ import annotations

from pathlib import Path

from ...analysis.motions import raw_motion
from ...analysis.tables import Reading
from ..results import open_run
from .content import Content


def read_run(path: Path, how: Reading) -> Content:
    """Read the attitudes of a run."""
    run = open_run(path)
    values, time = raw_motion(run, how.scalar_first)
    return Content(bodies={path.stem: values}, time=time, notes=("orientation: a run of this package",))

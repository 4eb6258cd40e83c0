"""Runs on disk, written atomically and sealed; exports for other programs; recorded motions from files."""

from .recordings import read_motion
from .results import ResultFileError, open_run, reserved, save_run

__all__ = ["ResultFileError", "open_run", "read_motion", "reserved", "save_run"]

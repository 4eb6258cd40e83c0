"""Result files: runs as NetCDF, exports, and writing that leaves whole files."""

from .results import open_run, reserved, save_run

__all__ = ["open_run", "reserved", "save_run"]

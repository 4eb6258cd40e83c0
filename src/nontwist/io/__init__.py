"""Result files: runs as NetCDF, exports, and writing that leaves whole files."""

from .results import ResultFileError, open_run, reserved, save_run

__all__ = ["ResultFileError", "open_run", "reserved", "save_run"]

"""Run files: a body, its start, loads and times as a TOML file, checked, and run."""

from .document import RunFile, read_run_file

__all__ = ["RunFile", "read_run_file"]

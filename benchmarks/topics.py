"""The topics, and one of them measured: importable by name, as a process that is spawned for it needs."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from .rows import Row, Table

TOPICS = {  # the name of the module, and its title on the page
    "workprecision": "Work and precision",
    "defaults": "The default integrator",
    "outputs": "Many outputs of one run",
    "steps": "One step",
    "ensembles": "Ensembles",
    "derivatives": "Derivatives",
    "sweeps": "Sweeps",
    "startup": "Start-up",
    "frames": "Frames and twist",
    "files": "Result files",
}


class Measured(NamedTuple):
    """What a topic has found."""

    rows: list[Row]
    tables: list[Table]
    about: str


def measured(topic: str, folder: Path | None) -> Measured:
    """Measure a topic, in a process of its own: what other tools leave behind slows the next topic down.

    With a folder, files that the page shows are written there.
    """
    module = import_module(f"{__package__}.{topic}")
    rows, tables = module.rows(), module.tables() if hasattr(module, "tables") else []
    if folder is not None and hasattr(module, "write"):
        module.write(folder)
    return Measured(rows, tables, (module.__doc__ or "").strip())

"""The topics; what each reports: figures measured in this run; and the machine that they were measured on."""

from __future__ import annotations

import os
import platform
import re
import warnings
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from subprocess import SubprocessError

import numpy as np

TOOLS = ("numpy", "llvmlite", "scipy", "heyoka", "diffrax", "exudyn", "mujoco")


TOPICS = {  # the module, and what it measures
    "workprecision": "Work and precision",
    "outputs": "Many outputs of one run",
    "ensembles": "Ensembles",
    "gpu": "Ensembles on a GPU",
    "growth": "Growth",
    "steps": "One step, one call",
    "defaults": "The default integrator",
    "derivatives": "Derivatives",
    "sweeps": "Sweeps",
    "startup": "Start-up",
    "frames": "Frames and twist",
    "files": "Result files",
}


@dataclass(frozen=True)
class Row:
    """One figure; None where it could not be measured, with a note why."""

    name: str
    measured: float | None
    unit: str
    note: str = ""

    @property
    def value(self) -> str:
        """Return the figure with its unit."""
        return "–" if self.measured is None else f"{digits(self.measured)} {self.unit}".strip()


def digits(x: float) -> str:
    """Return three significant digits, written out where the number is of usual size."""
    if x and not 1e-3 <= abs(x) < 1e7:
        return f"{x:.2e}"
    return np.format_float_positional(x, precision=3, unique=False, fractional=False, trim="-")


def processor() -> str:
    """Return the model of the processor."""
    info = Path("/proc/cpuinfo")
    facts = dict(re.findall(r"^([\w ]+?)\s*: (.+)$", info.read_text(encoding="utf-8"), re.M) if info.exists() else [])
    numbers = [f"{key} {facts[key]}" for key in ("cpu family", "model") if key in facts]
    return ", ".join([facts.get("model name", platform.processor() or platform.machine()), *numbers])


def machine() -> str:
    """Return the processor, the system and the versions of all tools; no names, no paths."""
    tools = [f"{name} {version(name)}" if find_spec(name) else f"no {name}" for name in TOOLS]
    system = f"{os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"
    return f"{processor()}; {system}; nontwist {version('nontwist')}, {', '.join(tools)}"


def measured(topic: str, folder: Path | None) -> list[Row]:
    """Measure a topic; with a folder, write the files there that the page shows."""
    warnings.simplefilter("ignore")  # of coarse steps
    try:
        module = import_module(f"{__package__}.{topic}")
        rows: list[Row] = module.rows()
        if folder is not None and hasattr(module, "write"):
            module.write(folder)
    except (ImportError, OSError, SubprocessError) as error:  # a tool that is not there
        return [Row(TOPICS[topic], None, "", note=f"not measured: {error}")]
    return rows

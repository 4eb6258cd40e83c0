"""The machine and the versions behind a run, in words; no names, no paths."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from importlib.metadata import version
from pathlib import Path

from .peers import versions


def words() -> str:
    """Return a paragraph for the page."""
    tools = [*(f"{name} {version(name)}" for name in ("nontwist", "numpy", "llvmlite")), *versions()]
    return (
        f"Measured on {processor()}, {os.cpu_count()} cores, {platform.system()}, "
        f"{platform.python_implementation()} {platform.python_version()}; {', '.join(tools)}; {compiler()}."
    )


def processor() -> str:
    """Return the model of the processor."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = info.read_text(encoding="utf-8").splitlines()
        pairs = (line.partition(":") for line in reversed(lines))
        facts = {key.strip(): value.strip() for key, _, value in pairs if value}
        numbers = ", ".join(f"{key} {facts[key]}" for key in ("cpu family", "model") if key in facts)
        return f"{facts.get('model name', platform.machine())} ({numbers})"
    return platform.processor() or platform.machine()


def compiler() -> str:
    """Return the C compiler and its version."""
    cc = shutil.which("cc")
    if cc is None:
        return "no C compiler"
    return "C compiler " + subprocess.run([cc, "--version"], capture_output=True, text=True).stdout.split("\n")[0]

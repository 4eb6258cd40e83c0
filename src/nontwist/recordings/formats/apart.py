"""Reading in a process of its own: on damaged files SciPy's loadmat and ezc3d may end the process that calls them."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[np.generic]]
CHILD = (
    "import sys; from importlib import import_module; import numpy; module, function, path = sys.argv[1:]; "
    "found = getattr(import_module(module), function)(path); "
    "numpy.savez(sys.stdout.buffer, **{'_' + name: array for name, array in found.items()})"
)


def read_apart(function: Callable[[str], Arrays], path: Path) -> Arrays:
    """Return the arrays that a function of a module finds in a file.

    Raises
    ------
    RuntimeError
        Its process did not end well.
    """
    command = [sys.executable, "-c", CHILD, function.__module__, function.__name__, str(path.resolve())]
    env = os.environ | {"PYTHONPATH": os.pathsep.join(one for one in sys.path if one)}
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, env=env)
    if done.returncode:
        raise RuntimeError(f"the process that reads it ended with {done.returncode}")
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as file:
        return {name.removeprefix("_"): file[name] for name in file.files}

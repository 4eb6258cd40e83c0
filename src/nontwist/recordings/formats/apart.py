"""Reading by libraries, which raise what they like on damaged files; loadmat and ezc3d even end their process."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError

Arrays = dict[str, NDArray[np.generic]]
CHILD = (
    "import sys; from importlib import import_module; import numpy; module, function, path = sys.argv[1:]; "
    "found = getattr(import_module(module), function)(path); "
    "numpy.savez(sys.stdout.buffer, **{'_' + name: array for name, array in found.items()})"
)


@contextmanager
def readable(what: str, help_with: str = "") -> Iterator[None]:
    """Turn every exception that a library raises on a damaged file into an InputError, but for those of the system.

    The message names the format, as in "it is not a readable spin log: damaged, cut short or something else".
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # libraries raise what they like
        if isinstance(error, OSError) and error.errno is not None:
            raise
        why = f"damaged, cut short or something else{help_with}"
        raise InputError("unreadable", what=what, why=why) from error


def library(name: str, extra: str) -> Any:
    """Import the library that reads a format; an ImportError names the extra that installs it."""
    try:
        return import_module(name)
    except ImportError as error:
        raise ImportError(f"this format is read by {name}: pip install 'nontwist[{extra}]'", name=name) from error


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

"""Rigid bodies described by directors, non-twisting frames, and integrators that conserve their invariants.

The public names are listed in `__init__.pyi` alone, with the modules that they are imported from on first use.
"""

from importlib import import_module
from typing import Any

_loader: Any = __loader__
_stub = _loader.get_data(f"{__path__[0]}/__init__.pyi").decode().splitlines()
_HOME = {line.split()[3]: f"{__name__}{line.split()[1]}".rstrip(".") for line in _stub if line.startswith("from .")}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("nontwist")
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = vars(import_module(_HOME[name]))
    value = home[name] if name in home else import_module(f"{_HOME[name]}.{name}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]

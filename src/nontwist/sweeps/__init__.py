"""Sweeps: all members of a run file with a table ``[sweep]``, on one machine or on many, into one store."""

from .opening import open_sweep, sweep_member
from .sweeping import sweep

__all__ = ["open_sweep", "sweep", "sweep_member"]

"""Sweeps: all members of a run file with a table ``[sweep]``, on one machine or on many, into one store."""

from .outcome import SweepError, SweepStoreError
from .reading import open_sweep, sweep_member
from .sweeping import sweep

__all__ = ["SweepError", "SweepStoreError", "open_sweep", "sweep", "sweep_member"]

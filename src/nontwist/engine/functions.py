"""Moments of the state as C functions: compiled ones by Numba, those in Python behind a callback."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..geometry.arrays import Array
from ..geometry.elements import Moment
from ..loads import Load
from ..loads.base import state_moment_at
from ..loads.c_functions import address_of
from ..loads.compiled import c_function, is_compilable
from ..loads.terms import REMEDY


class Called:
    """The terms of a load that are called while a run marches, as one C function.

    Attributes
    ----------
    address : int
        Of the function, 0 where there is nothing to call.
    error : exception or None
        What the last call of a function in Python raised.
    """

    def __init__(self, load: Load) -> None:
        self.load, self.address = load.called, 0
        self._function: Any = None
        self.error: BaseException | None = None
        if self.load.terms:
            parts: Any = tuple((term.compiled, term.scale) for term in self.load.terms if term.compiled is not None)
            compiled = self.load.is_compiled and is_compilable(parts)
            self._function = c_function(parts) if compiled else Moment(self._call)
            self.address = self._function.address if compiled else address_of(self._function)

    def _call(self, t: float, directors: Any, angular_velocity: Any, moment: Any) -> None:
        q, w = np.array(directors[:9]).reshape(3, 3), np.array(angular_velocity[:3])
        try:
            moment[0], moment[1], moment[2] = state_moment_at(self.load, t, q, w).tolist()
        except BaseException as error:  # it must not pass through the kernel
            self.error = error
            moment[0] = np.nan

    def reason(self, last: Array) -> str:
        """Return why the function has failed: what Python says at the state that it was called with `last`.

        That is 16 numbers: directors, angular velocity, moment, time.
        """
        if self.error is None:
            try:
                self.load.state_moment(float(last[15]), last[:9].reshape(3, 3), last[9:12])
            except ValueError as error:
                self.error = error
        return str(self.error or f"the load is not finite at t = {last[15]:.12g} s; {REMEDY}")

    def require_no_interrupt(self) -> None:
        """Raise what has interrupted a function in Python, Ctrl-C or `SystemExit`: it could not pass the kernel."""
        if self.error is not None and not isinstance(self.error, Exception):
            raise self.error

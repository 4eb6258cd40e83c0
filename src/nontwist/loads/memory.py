"""Terms with memory: moments that depend on internal states z of their own, which have equations of their own.

    m = g(t, z, Λ, w),        z' = f(t, z, Λ, w),        z = z_0 at the start of a run.

An actuator that lags, liquid in a tank, hysteresis of a magnetic rod are such terms. An integrator that takes them
solves for z in the same step as for the body (`integrators.gauss_memory`).

The C function of a term is ``void (t, state, z, found)``: the state is directors, w, and W; what is found is the
moment in space, the moment along the moving frame, one of which is 0, and z'.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from ..geometry.arrays import Array, as_array
from ..spec import Spec
from .calls import Call, array, checked
from .terms import Frame, Record, Term, factor_in_words

STATE, MOMENTS = 15, 6  # numbers of the state; of the moments


class Memory(Term):
    """Base class of terms with memory.

    A subclass has one text, ``response(t, z, directors, angular_velocity)``: the three components of the moment, then
    z', one number after the other. With `frame` "space" moment and angular velocity are spatial, with "body" they are
    components along the moving directors. `state0` is z at the start of a run, `state_scale` how large z becomes; a
    factor of the term multiplies the moment, and not z.

    Attributes
    ----------
    frame : "space" or "body"
    state0, state_scale : (k,) arrays
    """

    frame: Any
    state0: Array
    state_scale: Array

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("state0", "state_scale"):
            if not isinstance(value := getattr(self, name), np.ndarray):
                self._set(**{name: as_array(value, name, (None,))})

    @property
    def counts(self) -> tuple[int, int]:  # type: ignore[override]
        """Numbers of the state, of z."""
        return STATE, self.state0.size

    @property
    def gives(self) -> tuple[int, ...]:  # type: ignore[override]
        """Numbers of both moments and of z'."""
        return (MOMENTS + self.state0.size,)

    @property
    def varying(self) -> list[str]:
        """None: what such a term says are functions."""
        return []

    def moment_at(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Raise a ValueError: there is no moment without an internal state."""
        raise ValueError("the moment of a load with memory depends on its internal state: run it, and read run.moment")

    def text(self, call: Call, x: Sequence[Any]) -> list[Any]:
        """Return the moment in space, the one along the frame, and z'; `x` is the state, z, and the time."""
        is_along, t, z = self.frame == "body", x[-1], array(x[STATE:-1])
        moment, rate = self.responses(call, t, z, array(x[:9], 3, 3), array(x[12:15] if is_along else x[9:12]))
        return [0.0, 0.0, 0.0, *moment, *rate] if is_along else [*moment, 0.0, 0.0, 0.0, *rate]

    def answers(self, t: float, directors: Array, W: Array, z: Array) -> tuple[Array, Array]:
        """Return the moment in space, N m, and z', at one time and state, in Python; W along the frame."""
        state = [*directors.ravel().tolist(), *(W @ directors).tolist(), *W.tolist(), *z.tolist(), t]
        found = np.array(self.text(checked, state))
        return self.scale * (found[:3] + found[3:MOMENTS] @ directors), found[MOMENTS:][: len(z)]

    def responses(self, call: Call, *given: Any) -> tuple[list[Any], list[Any]]:
        """Return moment and z' by a way to call functions."""
        found = call(self.called, given, (3 + self.state0.size,))
        return found[:3], found[3:]


@dataclass(frozen=True, eq=False)
class MemoryFunction(Memory):
    """A term with memory that is two functions."""

    kind = "memory"
    memory: Callable[..., Any]
    torque: Callable[..., Any]
    state0: Annotated[Array, Spec("z at the start", shape=(None,), is_fixed=True)]
    state_scale: Annotated[Array, Spec("", option="scale", shape=("state0",), rule="positive", is_fixed=True)]
    frame: Frame = "space"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.state0.size:
            raise ValueError("state0 is empty: a load without internal state is moment(function)")

    @property
    def called(self) -> Callable[..., Any]:
        """The function of the moment."""
        return self.torque

    def responses(self, call: Call, *given: Any) -> tuple[list[Any], list[Any]]:
        """Return what both functions give."""
        return call(self.torque, given, (3,)), call(self.memory, given, self.state0.shape)

    @classmethod
    def words(cls, record: Record) -> str:
        """Return factor, names, and how many internal states there are."""
        names, k = f"{record['torque']} with memory {record['memory']}", len(record["state0"])
        return f"{factor_in_words(record)}function {names}, {k} internal state{'s' * (k > 1)}"

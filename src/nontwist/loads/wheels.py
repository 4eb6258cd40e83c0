"""Wheels that a body carries: each turns about an axis of the body, driven by a motor or free.

A wheel is symmetric about its axis n, which passes through its centre of mass, and has the moment of inertia I about
it. J is that of the body with all wheels locked, W its angular velocity, Ω the speed of a wheel relative to the body.
The axial momentum of a wheel in space is

    h = I (Ω + n·W),        h' = τ,

τ the torque of the motor on the wheel. What carries the wheels has J_c = J - Σ I n nᵀ, and with Σ h n in place of a
rotor's momentum it is a gyrostat:

    J_c W' = (J_c W + Σ h n) × W + M - Σ τ n.

So h is known beforehand, whatever the body does, and `h' = τ` is not `I Ω' = τ`: a motor that holds Ω has to turn the
wheel with the body. The total momentum Λ (J_c W + Σ h n) changes by moments from outside alone. As
Σ h n + J_c W = J W + Σ I Ω n, the wheels are, seen from the locked body, rotors of momentum I Ω.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ..geometry.arrays import Array
from ..geometry.values import vector_text
from ..spec import Spec
from .terms import Momentum, Record, smoothness, within

ONE = np.ones(1)


@dataclass(frozen=True, eq=False)
class Wheel(Momentum):
    """A wheel with a motor, whose torque is a number, or a table that is linear between its times and zero outside.

    Attributes
    ----------
    known : (float, float) or None
        A time, s, and h then, kg m² s⁻¹, for wheels of a run that has begun.
    """

    wheel: Annotated[Array, Spec("", option="axis", shape=(3,), rule="direction in the body", is_fixed=True)]
    inertia: Annotated[float, Spec("about its axis", unit="kg m²", rule="positive", is_fixed=True)]
    speed: Annotated[float, Spec("at the start, relative to the body", unit="rad/s")] = 0.0
    torque: Annotated[float, Spec("of the motor", unit="N m")] = 0.0
    times: Annotated[Array, Spec("", unit="s", shape=(None,), is_fixed=True)] = ()  # type: ignore[assignment]
    values: Annotated[Array, Spec("the torque", unit="N m", shape=("times",), is_fixed=True)] = ()  # type: ignore[assignment]
    known: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.times.size:
            self._set(**smoothness(self.times))

    @property
    def direction(self) -> Array:
        """The axis n."""
        return self.wheel

    @property
    def locked(self) -> Array:
        """What the wheel gives to J, I n nᵀ, (3, 3), kg m²."""
        return self.inertia * np.outer(self.wheel, self.wheel)

    @property
    def is_linear(self) -> bool:  # type: ignore[override]
        """Whether h is, between its breakpoints."""
        return not self.times.size

    def impulse(self, times: Array) -> Array:
        """Return the integral of the torque at (n,) times, without the factor; of the table from its beginning."""
        found: Array = self.torque * times
        if not self.times.size:
            return found
        T, y = self.times, self.values
        t = np.clip(times, T[0], T[-1])
        k = np.clip(np.searchsorted(T, t, side="right") - 1, 0, max(len(T) - 2, 0))
        sums = np.append(0.0, np.cumsum(np.diff(T) * (y[1:] + y[:-1]) / 2))
        found = found + sums[k] + (t - T[k]) * (y[k] + np.interp(t, T, y)) / 2
        return found

    def begun(self, time: float, momentum: float) -> Wheel:
        """Return the wheel of a run in which it has the axial momentum h at a time; its factor is 1."""
        c = self.scale
        return self._copy(
            scale=1.0, speed=c * self.speed, torque=c * self.torque, values=c * self.values, known=(time, momentum)
        )

    def history(self, times: Array) -> tuple[Array, Array]:
        """Return h and h' at (n,) times, without the factor; before a run has begun h as of a body at rest."""
        t, h = self.known or (0.0, self.inertia * self.speed)
        h_of_time: Array = h + (self.impulse(times) - self.impulse(np.array([t])))
        return h_of_time, self.torque + (
            within(self.times, self.values[:, None], times)[0] if self.times.size else 0.0 * times
        )

    def slopes_of_momentum(self, name: str, times: Array) -> Array:
        """Return the derivatives of the factor times h at (n,) times after the start by a parameter.

        Raises
        ------
        ValueError
            The parameter is the factor of a table, to which steps of many nodes are not linear.
        """
        if name == "scale" and self.times.size:
            raise ValueError("runs have no derivatives by the factor of a wheel whose torque is a table")
        speed, torque = self.inertia * np.ones(len(times)), times
        found: dict[str, Array] = {"speed": self.scale * speed, "torque": self.scale * torque}
        return found[name] if name in found else self.speed * speed + self.torque * torque

    @classmethod
    def words(cls, record: Record) -> str:
        """Return inertia, axis and speed."""
        about, speed = f"about {vector_text(record['wheel'])}", record["scale"] * record["speed"]
        motor = "a motor" if record["torque"] or len(record["times"]) else "no motor"
        return f"wheel of {record['inertia']:.6g} kg m² {about}, at first {speed:.6g} rad/s, with {motor}"


def momenta_later(wheels: Sequence[Wheel], begin: Array, time: float, times: Array, scale: Array = ONE) -> Array:
    """Return the axial momenta of wheels at (k,) times, (m, k, wheels), given those at one time, (m, wheels)."""
    at = np.append(time, times)
    change = np.stack([one.scale * (one.impulse(at)[1:] - one.impulse(at)[0]) for one in wheels], axis=1)
    found: Array = begin[:, None] + scale[:, None, None] * change
    return found

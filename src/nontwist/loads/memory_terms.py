"""Terms with memory, wheels among them: moments that depend on internal states z with equations of their own.

    m = g(t, z, Λ, w),        z' = f(t, z, Λ, w),        z = z_0 at the start of a run.

An actuator that lags, liquid in a tank, hysteresis of a magnetic rod are such terms. An integrator that takes them
solves for z in the same step as for the body (`integrators.gauss_memory`, `engine.internal`).

The C function of a term is ``void (t, state, z, found)``: the state is directors, w, and W; what is found is the
moment in space, the moment along the moving frame, one of which is 0, and z'.

**Wheels** that a body carries turn about an axis of the body, driven by a motor, with friction, or free. A wheel is
symmetric about its axis n, which passes through its centre of mass, and has the moment of inertia I about it. J is that
of the body with all wheels locked, W its angular velocity, Ω the speed of a wheel relative to the body. The axial
momentum of a wheel in space is

    h = I (Ω + n·W),        h' = τ - f(Ω) - λ,        λ in c Sgn(Ω),

τ the torque of the motor on the wheel, f smooth and c dry friction in its bearing, Sgn(Ω) = {sign Ω}, and [-1, 1] where
the wheel stands in the body, Ω = 0 (`driver.rubbing`). What carries the wheels has J_c = J - Σ I n nᵀ, and
with Σ h n in place of a rotor's momentum it is a gyrostat:

    J_c W' = (J_c W + Σ h n) × W + M - Σ h' n.

`h' = τ` is not `I Ω' = τ`: a motor that holds Ω has to turn the wheel with the body. The total momentum
Λ (J_c W + Σ h n) changes by moments from outside alone. As Σ h n + J_c W = J W + Σ I Ω n, the wheels are, seen from the
locked body, rotors of momentum I Ω.

Without friction, and under torques of time, h is known beforehand, whatever the body does: such a wheel is `Driven`.
Else h is an internal state z of a load with memory, of moment ``h n × W - h' n`` along the moving frame; so
are then the work of the motor and what friction takes, ``A' = τ Ω`` and ``D' = (f + λ) Ω``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated, Any, NamedTuple, Self

import numpy as np

from ..geometry.arrays import Array, as_array
from ..geometry.values import vector_text
from ..kernels.elements import select
from ..kernels.vectors import Vector, cross
from ..spec import Spec
from .functions import MOMENTS, Call, array, checked
from .terms import Frame, Momentum, Record, Term, chord, factor_in_words, smoothness, within

STATE = 15  # numbers of the state


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


SPEEDS = np.logspace(-3, 6, 181)  # rad/s, at which friction is looked at before a run
Function = Callable[..., Any]


def gain_of_energy(friction: Any, speeds: Iterable[float]) -> str | None:
    """Return at which of some speeds friction drives a wheel, None where it does not."""
    for speed in speeds:
        (drag,) = checked(friction, (float(speed),), ())
        if drag * speed < 0:
            return (
                f"friction must slow the wheel down, but at {speed:.6g} rad/s it is {drag:.6g} N m: "
                "return a number of the sign of the speed"
            )
    return None


@dataclass(frozen=True, eq=False)
class Wheel(Memory):
    """A wheel with a motor and friction.

    The torque is a number, or a table that is linear between its times and zero outside, and a function of time and
    speed. Friction is viscous, dry, or a function of the speed.
    """

    kind = "memory"
    frame = "body"
    wheel: Annotated[Array, Spec("", option="axis", shape=(3,), rule="direction in the body", is_fixed=True)]
    inertia: Annotated[float, Spec("about its axis", unit="kg m²", rule="positive", is_fixed=True)]
    speed: Annotated[float, Spec("at the start, relative to the body", unit="rad/s")] = 0.0
    torque: Annotated[float, Spec("of the motor", unit="N m")] = 0.0
    times: Annotated[Array, Spec("", unit="s", shape=(None,), is_fixed=True)] = ()  # type: ignore[assignment]
    values: Annotated[Array, Spec("the torque", unit="N m", shape=("times",), is_fixed=True)] = ()  # type: ignore[assignment]
    viscous: Annotated[float, Spec("friction", unit="N m s", rule="not negative", is_fixed=True)] = 0.0
    coulomb: Annotated[float, Spec("dry friction", unit="N m", rule="not negative", is_fixed=True)] = 0.0
    friction: Function | None = None
    motor: Function | None = None
    mode: int | None = None  # the direction in which it turns under dry friction, 0: it stands; None: it is open
    is_commanded: bool | None = None  # whether its last internal state is a torque beside the others, which stays
    has_motor: bool | None = None  # whether its work is an internal state though its torque may be zero

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.times.size:
            self._set(breakpoints=smoothness(self.times)["breakpoints"])
            if self.torque:
                raise ValueError("torque is a number, or times and values of it, not both")
        is_new = self.friction is not None and self.scale == 1.0
        if is_new and (reason := gain_of_energy(self.friction, (*-SPEEDS, *SPEEDS))):
            raise ValueError(reason)

    @classmethod
    def of_record(cls, record: Record) -> Self:
        """Return the wheel of a record, without its factor."""
        return replace(super().of_record(record), has_motor=record.get("has_motor"))

    @property
    def is_driven(self) -> bool:
        """Whether h is known beforehand."""
        is_free = not (self.viscous or self.coulomb or self.is_commanded)
        return is_free and self.friction is None and self.motor is None

    @property
    def works(self) -> bool:
        """Whether a motor is given by a number or a table."""
        return bool(self.has_motor or self.torque or self.times.size)

    @property
    def is_dry(self) -> bool:
        """Whether its friction jumps with the state, so that a run is taken apart."""
        return self.coulomb > 0 and self.mode is None

    @property
    def direction(self) -> Array:
        """The axis n."""
        return self.wheel

    @property
    def varying(self) -> list[str]:
        """The names of the fields that are parameters of derivatives."""
        return ["speed", "torque", "inertia", "wheel"] + ["viscous"] * (not self.is_driven)

    @property
    def state0(self) -> Array:  # type: ignore[override]
        """The internal states of a body at rest: h, the work of a motor, and where h is not known, the loss."""
        return np.array([self.inertia * self.speed, 0.0, 0.0, 0.0][: self.count])

    @property
    def count(self) -> int:
        """How many they are."""
        return 1 + self.works if self.is_driven else 3 + bool(self.is_commanded)

    @property
    def state_scale(self) -> Array:  # type: ignore[override]
        """How large they become."""
        speed = max(abs(self.speed), 1.0)
        return np.array([self.inertia * speed, *[self.inertia * speed**2] * 3][: self.count])

    @property
    def locked(self) -> Array:
        """What the wheel adds to J_c, I n nᵀ, (3, 3), kg m²; none where it stands, as J includes it."""
        return (0.0 if self.mode == 0 else 1.0) * self.inertia * np.outer(self.wheel, self.wheel)

    @property
    def unscaled(self) -> Wheel:
        """The wheel of the factor 1 whose speed and torques are those of this one times its factor."""
        return self if self.scale == 1 else _unscaled(self)  # what is compiled is kept

    def with_torque(self, torque: float) -> Wheel:
        """Return the wheel of the factor 1 with a torque beside its own; that of a table acts as long as the table."""
        own = self.unscaled
        added = {"values": own.values + torque} if own.times.size else {"torque": own.torque + torque}
        return replace(own, has_motor=True, **added)

    def impulse(self, times: Array) -> Array:
        """Return the integral of the torque at (n,) times, without the factor; of the table from its beginning."""
        found: Array = self.torque * times
        if not self.times.size:
            return found
        T, y = self.times, self.values
        t = np.clip(times, T[0], T[-1])
        k = np.minimum(np.searchsorted(T, t, side="right") - 1, len(T) - 2)
        sums = np.append(0.0, np.cumsum(np.diff(T) * (y[1:] + y[:-1]) / 2))
        found = found + sums[k] + (t - T[k]) * (y[k] + np.interp(t, T, y)) / 2
        return found

    def torque_at(self, times: Array) -> Array:
        """Return the torque at (n,) times, without the factor, but for what depends on the speed."""
        table: Array = within(self.times, self.values[:, None], times)[0] if self.times.size else 0.0 * times
        return self.torque + table

    def history(self, times: Array) -> tuple[Array, Array]:
        """Return impulse and torque at (n,) times, without the factor."""
        return self.impulse(times), self.torque_at(times)

    def slope_of_torque(self, times: Array) -> Array:
        """Return the slope of the table in the middle of the intervals between times, without the factor."""
        middles = (times[1:] + times[:-1]) / 2
        return chord(self.times, self.values, middles) if self.times.size else 0.0 * middles

    def responses(self, call: Call, *given: Any) -> tuple[list[Any], list[Any]]:
        """Return the moment, and h', A', D'; none where it stands, a part of the body, and h follows from W."""
        t, (h, *more), _, W = given
        count = 3 + bool(self.is_commanded)
        if self.mode == 0:
            return [0.0 * h] * 3, [0.0 * h] * count
        n, W = Vector(*self.wheel), Vector(*W)
        speed = h * (1.0 / self.inertia) - n @ W
        torque = (0.0 if self.times.size else self.torque) + 0.0 * speed
        for k in range(len(self.times) - 1):
            (a, b), (y, z) = self.times[k : k + 2].tolist(), self.values[k : k + 2].tolist()
            torque = torque + select((t >= a) & (t < b), self.torque + y + (z - y) / (b - a) * (t - a), 0.0)
        if self.motor is not None:
            torque = torque + call(self.motor, (t, speed), ())[0]
        if self.is_commanded:
            torque = torque + more[-1]
        drag = self.viscous * speed + (self.mode or 0) * self.coulomb
        if self.friction is not None:
            drag = drag + call(self.friction, (speed,), ())[0]
        rate = torque - drag
        return [*(cross(h * n, W) - rate * n)], [rate, torque * speed, drag * speed, 0.0 * h][:count]

    @property
    def called(self) -> Function:
        """The text."""
        return self.responses

    @classmethod
    def words(cls, record: Record) -> str:
        """Return inertia, axis and speed."""
        about, speed = f"about {vector_text(record['wheel'])}", record["scale"] * record["speed"]
        parts = ["a motor"] * (_works(record) or "motor" in record) + ["friction"] * _rubs(record)
        more = f", with {' and '.join(parts)}" if parts else ""
        return f"wheel of {record['inertia']:.6g} kg m² {about}, at first {speed:.6g} rad/s{more}"


@lru_cache(maxsize=64)
def _unscaled(wheel: Wheel) -> Wheel:
    c, motor = wheel.scale, wheel.motor
    driven = None if motor is None else (lambda t, speed: c * motor(t, speed))
    scaled = {name: c * getattr(wheel, name) for name in ("speed", "torque", "values")}
    return replace(wheel, scale=1.0, motor=driven, **scaled)


@dataclass(frozen=True, eq=False)
class OnBodyAtRest(Memory):
    """A wheel on a body that is held at rest, on which it does not act."""

    kind = "memory"
    frame = "body"
    of: Wheel

    @classmethod
    def carried(cls, wheel: Wheel) -> OnBodyAtRest:
        """Return it of a wheel."""
        return cls(wheel, breakpoints=wheel.breakpoints, resolution=wheel.resolution)

    @property
    def state0(self) -> Array:  # type: ignore[override]
        """The internal states of the wheel."""
        return self.of.state0

    @property
    def state_scale(self) -> Array:  # type: ignore[override]
        """How large they become."""
        return self.of.state_scale

    def responses(self, call: Call, *given: Any) -> tuple[list[Any], list[Any]]:
        """Return no moment, and h', A', D', as far as they are states."""
        moment, rates = self.of.responses(call, *given)
        return [0.0 * x for x in moment], rates[: self.state0.size]

    @property
    def called(self) -> Function:
        """The text."""
        return self.responses


@dataclass(frozen=True, eq=False)
class Driven(Momentum):
    """A wheel whose momentum is known beforehand: in the run it is `h` at the time `begin`."""

    of: Wheel
    begin: float
    h: float

    @property
    def is_linear(self) -> bool:  # type: ignore[override]
        """Whether h is, between its breakpoints."""
        return not self.of.times.size

    @property
    def direction(self) -> Array:
        """The axis n."""
        return self.of.wheel

    def history(self, times: Array) -> tuple[Array, Array]:
        """Return h and h' at (n,) times."""
        of = self.of
        momentum: Array = self.h + (of.impulse(times) - of.impulse(np.array([self.begin])))
        return momentum, of.torque_at(times)


class Column(NamedTuple):
    """A wheel in the states of a run."""

    axis: Array  # (3,)
    inertia: float
    place: int  # of h among the internal states
    has_motor: bool  # whether its work is behind it
    has_loss: bool  # whether what friction takes is behind that: h is not known beforehand
    is_dry: bool

    @property
    def size(self) -> int:
        """How many internal states it has."""
        return 1 + self.has_motor + self.has_loss


def recorded_wheels(records: Sequence[Record]) -> list[Column]:
    """Return the wheels of the load of these records, whose internal states come before those of other loads."""
    found, place = list[Column](), 0
    for one in records:
        if "wheel" in one:
            rubs, works = _rubs(one) or "motor" in one, _works(one)
            is_dry = bool(one.get("coulomb"))
            found.append(Column(np.array(one["wheel"]), float(one["inertia"]), place, rubs or works, rubs, is_dry))
            place += found[-1].size
    return found


def carried_on(z: Array, had: Sequence[Column], sizes: Sequence[int]) -> Array:
    """Return internal states, (n, k), of a run with the wheels `had` as those of a load whose wheels have so many.

    Momenta continue, and so do works and losses that both have; the others are 0.
    """
    kept = [a.place + k if k < a.size else -1 for a, size in zip(had, sizes, strict=False) for k in range(size)]
    others = range(sum(one.size for one in had), z.shape[1])
    return np.insert(z, z.shape[1], 0.0, axis=1)[:, [*kept, *others]]


def _works(record: Record) -> bool:
    return bool(record.get("has_motor") or record["torque"] or len(record["times"]))


def _rubs(record: Record) -> bool:
    return bool(record["viscous"] or record.get("coulomb") or "friction" in record)

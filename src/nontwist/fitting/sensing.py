r"""Errors of a gyroscope beside bias, scale and noise: delay, misalignment, scales of single axes.

A gyroscope reads ``y(t) = s E Q W(t - τ) + b + noise`` with the common scale s and the bias b. ``Q = exp(-θ̂)`` takes
components along the axes of the body to those of the gyroscope, which are turned by the rotation vector θ against
them; ``E = diag(e₁, e₂, e₃)`` are the scales of its axes, about 1; τ is the delay behind the clock of the recording.
The axes of the body are those in which attitudes, the centre of mass and the axis of a rotor are given. Derivatives,
with ``δ exp(θ̂) = (T δθ)^ exp(θ̂)``:

    ∂y/∂W = s E Q ,     ∂y/∂θ = s E Q Ŵ T ,     ∂y/∂e_i = s (Q W)_i ,     ∂y/∂τ = -s E Q W' .

Readings of free motion alone tell none of them. θ is another choice of axes: V = Q W is a free motion of the inertia
Q J Qᵀ. τ is another start. And along principal axes V = E W obeys

    V₁' = k₁ e₁/(e₂ e₃) V₂ V₃ ,     k₁ = (J₂ - J₃)/J₁ ,     and so on cyclically,

which is a free motion of another body wherever the three new rates obey ``k₁ + k₂ + k₃ + k₁ k₂ k₃ = 0``, as those of
all bodies do: one condition on three scales, so that a family of two is open. What gives axes or a clock besides,
attitudes, a centre of mass, the axis and the speed of a rotor, tells them, or some of them; where not, they are given
or have priors.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array, as_array, as_positive
from ..geometry.rotations import dexp, exp, hat
from ..geometry.values import shown
from .bodies import Model, of_keys

AXES, SCALES, DELAY = slice(0, 3), slice(3, 6), slice(6, 7)
PLACES = {"misalignment": AXES, "axis_scales": SCALES, "delay": DELAY}
UNITS = {"misalignment": "rad", "axis_scales": "", "delay": "s"}
NONE = np.array([0.0, 0, 0, 1, 1, 1, 0])
WIDE = {"misalignment": 0.2, "axis_scales": 0.05, "delay": 0.05}  # standard deviations before anything is known
TURN = 0.5  # rad: a delay that turns the body by more is none of a sensor


class Sensor(NamedTuple):
    """Errors of a gyroscope, θ, rad, e and τ, s, and their standard deviations before a recording; 0: given."""

    mean: Array = NONE
    deviation: Array = np.zeros(7)

    @property
    def free(self) -> NDArray[np.intp]:
        """The places of what is fitted."""
        return np.flatnonzero(self.deviation)

    @property
    def is_late(self) -> bool:
        """Whether there is a delay, or may be one."""
        return bool(self.mean[DELAY] != 0 or self.deviation[DELAY] > 0)

    @property
    def is_plain(self) -> bool:
        """Whether there are none of these errors, nor may be."""
        return np.array_equal(self.mean, NONE) and not self.deviation.any()

    def whole(self, errors: Array) -> Array:
        """Return θ, e and τ where those that are fitted have these values."""
        found = self.mean.copy()
        found[self.free] = errors
        return found

    def reads(self, W: Array, rates: Array | None, errors: Array) -> tuple[Array, Array, Array]:
        """Return E Q W, (n, 3), and its derivatives by W, (3, 3), and by what is fitted, (n, 3, k)."""
        if self.is_plain:
            return W, np.eye(3), np.zeros((len(W), 3, 0))
        whole = self.whole(errors)
        theta, e = whole[AXES], whole[SCALES]
        Q = exp(theta).T
        along, by_W, by = W @ Q.T, e[:, None] * Q, np.zeros((len(W), 3, 7))
        by[:, :, AXES] = by_W @ hat(W) @ dexp(theta)
        by[:, range(3), range(3, 6)] = along
        if rates is not None:
            by[:, :, 6] = -rates @ by_W.T
        return e * along, by_W, by[:, :, self.free]

    def undone(self, rates: Array) -> Array:
        """Return readings as those of a sensor without these errors, but for the delay."""
        found: Array = (rates / self.mean[SCALES]) @ exp(self.mean[AXES]).T
        return found


PLAIN = Sensor()


def as_sensor(given: Mapping[str, Any], model: Model, has_gyroscope: bool, has_speeds: bool) -> Sensor:
    """Return the errors of a gyroscope: each is None, given, "fit", or a mapping with `value` and `error`.

    Raises
    ------
    ValueError
        Something else; there is no gyroscope; the recording cannot tell what is to be fitted.
    """
    mean, deviation = NONE.copy(), np.zeros(7)
    for name, place in PLACES.items():
        value = given[name]
        if value is None:
            continue
        if not has_gyroscope:
            raise ValueError(f"{name} is that of a gyroscope, and attitudes alone are fitted: leave it out")
        if isinstance(value, str) and value == "fit":
            _require_told(name, model, has_speeds)
            deviation[place] = WIDE[name]
            continue
        if isinstance(value, str):
            raise ValueError(f"{name} must be numbers, 'fit', or a mapping with value and error; got {shown(value)}")
        shape = (3,) if place.stop - place.start == 3 else ()
        error: Any = 0.0
        if isinstance(value, Mapping):
            value = of_keys(value, ("value", "error"), name)
            if "error" not in value:
                raise ValueError(f"{name} lacks error, its standard deviation; a value without one is given as numbers")
            error = float(as_positive(value["error"], f"{name}: error", (), UNITS[name]))
            value = value.get("value", NONE[place] if shape else 0.0)
        mean[place], deviation[place] = as_array(value, name, shape), error
    if not (mean[SCALES] > 0).all():
        raise ValueError(f"axis_scales must be positive, got {shown(mean[SCALES].tolist())}")
    return Sensor(mean, deviation)


def _require_told(name: str, model: Model, has_speeds: bool) -> None:
    """Raise a ValueError where nothing in a recording tells this error of a gyroscope."""
    how = (
        f"give {name} as numbers, or with its standard deviation: {{'value': ..., 'error': ...}} (value=...,error=...)"
    )
    if name == "delay" and not (model.oriented or has_speeds):
        raise ValueError(
            "angular velocities alone do not determine their delay; use recorded attitudes on the same clock "
            f"(--orientation both, orientation='both') or the recorded speed of a rotor; otherwise {how}"
        )
    if not model.oriented and (model.is_free or (name == "misalignment" and model.has_axis and model.pivot is None)):
        what = "its misalignment" if name == "misalignment" else "the scales of its single axes"
        raise ValueError(
            f"a gyroscope in free motion does not determine {what}: another body would give the same readings; use "
            "recorded attitudes (--orientation both, orientation='both'), gravity about a pivot or a rotor; otherwise "
            f"{how}"
        )


def require_short(sensor: Sensor, rates: Array) -> None:
    """Raise a ValueError where a given delay turns the body too far."""
    turn = abs(float(sensor.mean[6])) * float(np.linalg.norm(rates, axis=1).max())
    if turn > TURN:
        raise ValueError(
            f"delay = {sensor.mean[6]:g} s is a turn of {turn:.2g} rad, more than the {TURN} rad that are taken: "
            "shift the times of the recording"
        )

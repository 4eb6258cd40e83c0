"""The three cases of sec-results: one body, t from 0 to 5 s, h = 0.005 s.

The amplitudes printed for the loads of cases 2 and 3 are 20 times those that give the printed tables: the impulse of
case 2 is fixed by ∫f dt = 1/2, so 2472.5 would end at Π1 = -1236.25, where the table has -61.749731.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..loads import Load, pulse

INERTIA = ((3.0, -1 / 7, 0.0), (-1 / 7, 4.0, 0.0), (0.0, 0.0, 5.0))
T_END, STEP = 5.0, 0.005
MISPRINT = 20.0


@dataclass(frozen=True)
class Case:
    """One case: initial material angular velocity (rad/s) and peak of the triangular load (N m), as printed."""

    title: str
    angular_velocity: tuple[float, float, float]
    printed_peak: tuple[float, float, float]

    def load(self, printed: bool = False) -> Load:
        """Return the load, corrected by the factor 1/20 or as `printed` (eq-loads_time_variation)."""
        if not any(self.printed_peak):
            return Load()
        return (1.0 if printed else 1 / MISPRINT) * pulse(self.printed_peak, 0.0, 1.0, shape="triangle", frame="body")


CASES = {
    1: Case("response to nonzero initial conditions", (6.0, -18.0, 0.0), (0.0, 0.0, 0.0)),
    2: Case("response to a vanishing load", (0.0, 0.0, 0.0), (-2472.5, -1075.0, 0.0)),
    3: Case("response to nonzero initial conditions and a vanishing load", (1.5, 4.5, 0.0), (-1236.25, -537.5, 0.0)),
}

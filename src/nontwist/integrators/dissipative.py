"""Dissipation as an option of the two midpoint schemes: energy falls, momentum stays.

Energy-dissipating, momentum-conserving variants (Armero & Romero, Comput. Methods Appl. Mech. Engrg. 190 (2001) 2603,
6783; Gebhardt, Romero & Rolfes, Comput. Mech. 65 (2020) 405). χ ∈ [0, 1] sets how much: χ = 0 is the conserving scheme.
What is dissipated is the nutation: free motion tends to the rotation about the axis of the largest moment of inertia,
``K ≥ |π|²/(2 J_max)``, and a permanent rotation loses nothing. It is of the scheme, not of the body: at a given time it
vanishes with the step, as h of order 1, as h² of order 2.

A body with a constrained axis cannot lose energy so: of the non-twisting body K is a function of Π_⊥, which free motion
keeps.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..geometry.arrays import as_number
from ..geometry.values import among
from .base import IVP
from .compiled import Compiled

ORDERS = (1, 2)  # with dissipation
REFUSAL = (
    "{} has no dissipation for a body with a constrained axis: the energy of the non-twisting body is a function of "
    "the momenta that it keeps, and cannot fall; leave dissipation out"
)


@dataclass(frozen=True)
class Dissipative(Compiled):
    """A midpoint scheme of order 2 whose energy may be made to fall."""

    order: int = 2
    dissipation: float = 0.0

    def __post_init__(self) -> None:
        chi = as_number(self.dissipation, "dissipation")
        if not 0 <= chi <= 1:
            raise ValueError(f"dissipation must be a number from 0 to 1, got {chi:g}")
        if among(self.order, (1,)) and chi == 0:
            raise ValueError(f"{self.name} has the order 1 with dissipation= alone, the order 2 with it or without")
        if not (chi > 0 and among(self.order, ORDERS)):
            super().__post_init__()

    def refusal(self, problem: IVP) -> str | None:
        """Return why bodies with a constrained axis that are to lose energy are not accepted."""
        return REFUSAL.format(self.name) if self.dissipation and problem.systems.axis is not None else None

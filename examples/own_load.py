"""A load of your own: the moment of a uniform magnetic field on a magnet that is fixed in the body.

The dipole has the components D along the directors, D = Σ D_i d_i in space, so that

    m = D × B,        V = -D·B.

V is linear in the directors, so the dead forces D_i B of a body give the same motion. They are computed by
different code, which checks this load.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from nontwist import DirectorSystem, Load, simulate, standard
from nontwist.geometry.arrays import Array, as_array
from nontwist.geometry.values import vector_text
from nontwist.loads import TERMS, Term
from nontwist.runfile.loads import LOADS, Place, Scaled
from nontwist.runfile.section import Vector


@dataclass(frozen=True, eq=False)
class Magnet(Term):
    """A magnet in a uniform field: the term, whose fields a run records."""

    dipole: Array
    field: Array

    @property
    def function(self) -> Callable[..., Any]:
        """The moment, in a form that can be compiled."""
        D, B = self.dipole, self.field

        def torque(t: float, directors: Any, w: Any) -> tuple[float, float, float]:
            d = D[0] * directors[0] + D[1] * directors[1] + D[2] * directors[2]
            return d[1] * B[2] - d[2] * B[1], d[2] * B[0] - d[0] * B[2], d[0] * B[1] - d[1] * B[0]

        return torque

    @classmethod
    def sample(cls) -> "Magnet":
        """Return the magnet that `nontwist validate` checks."""
        return cls("state", np.array([0.3, 0.0, 1.2]), np.array([0.0, 1.0, -2.0]), compile=True)

    @staticmethod
    def words(record: Mapping[str, Any]) -> str:
        """Return what the viewer says of the record."""
        return f"magnet {vector_text(record['dipole'], record['scale'])} A m² in {vector_text(record['field'])} T"


class MagnetTable(Scaled):
    """The table ``[[load]]`` of a run file with ``kind = "magnet"``."""

    error_key = "dipole"
    kind: Literal["magnet"]
    dipole: Vector = Field(description="3 numbers along the directors, A m²")
    field: Vector = Field(description="3 numbers along fixed axes, T")
    scale: float = Field(default=1.0, description="a number that the moment is multiplied by")

    def unscaled(self, place: Place) -> Load:
        """Return the load for the scale 1."""
        return magnet(self.dipole, self.field)


TERMS["dipole"], LOADS["magnet"] = Magnet, MagnetTable


def magnet(dipole: ArrayLike, field: ArrayLike) -> Load:
    """Return the moment of a uniform field on a magnet.

    Parameters
    ----------
    dipole : (3,) array, A m²
        Components along the directors.
    field : (3,) array, T
        In space.

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        Wrong shapes, not finite.

    Examples
    --------
    >>> magnet((0, 0, 2), (3, 0, 0))
    <Load: magnet (0, 0, 2) A m² in (3, 0, 0) T>
    """
    D, B = as_array(dipole, "dipole", (3,)), as_array(field, "field", (3,))
    return Load((Magnet("state", D, B, compile=True),))


def main() -> None:
    """Let a magnet go in the field: energies, and the same motion by dead forces."""
    body, dipole, field = standard([2e-5, 3e-5, 4e-5]), (0.3, 0.0, 1.2), (2e-5, 0.0, -4e-5)
    load = magnet(dipole, field)
    twin = DirectorSystem(body.euler_inertia, dead_force=np.outer(dipole, field))
    how: dict[str, Any] = {"t_end": 20, "step": 0.02, "material_angular_velocity": (0.5, 0, 2)}
    for integrator in ("lie-midpoint", "energy-momentum", "split"):
        run = simulate(body, load=load, integrator=integrator, **how)
        other = simulate(twin, integrator=integrator, **how)
        K, V = run.kinetic_energy.values, -np.einsum("i,tix,x->t", dipole, run.directors.values, field)
        work = K - K[0] - np.append(0, np.cumsum(run.load_work))
        print(
            f"{integrator:15} K - work to {abs(work).max() / K.max():.0e}, "
            f"K + V to {np.ptp(K + V) / K.max():.0e}; "
            f"from the motion by dead forces {abs(run.directors - other.directors).max().item():.0e}"
        )


if __name__ == "__main__":
    main()

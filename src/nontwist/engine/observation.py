"""What is observed of bodies on their way, at whole steps.

Least and greatest value of the quantities K, V, K + V - A (A: work of the load), π, Π, ψ', e·π (e vertical) and, as
means over a step, of the reaction moment -μ; their integrals over time are those of the trapezoidal rule over each step
or, with `gauss` and `split`, sums over their stages and substeps, of the order of the scheme. All in the units of the
body.
"""

from __future__ import annotations

from typing import Any

from ..kernels.control import loop
from ..kernels.elements import larger, smaller
from ..kernels.kernel import part
from ..kernels.memory import View, fields
from ..kernels.vectors import Matrix, Symmetric, Vector, attitude, first_moment
from .records import NODAL, QUANTITIES, Observed, Work

NOW = fields(Work)["now"].place
OF_OBSERVED = fields(Work)["observed"].place
LEAST, MOST, INTEGRAL = (OF_OBSERVED + fields(Observed)[name].place for name in ("least", "most", "integral"))


@part
def observe(x: View, has_normal: bool) -> None:
    """Set the quantities at the node whose state the workspace holds."""
    observe_at(x, has_normal, attitude(x.state.p))


def observe_at(x: View, has_normal: bool, R: Matrix) -> None:
    """Set the quantities at the attitude R and the velocity in the workspace.

    With ``V_i = W × e_i + N_i`` it is K = ½ Σ E_ij V_i·V_j and Π = Σ e_i × Σ_j E_ij V_j.
    """
    body, W = x.body, x.velocity
    (e0, e1, e2), (b0, b1) = body.E, body.off
    Pi = Vector((e1 + e2) * W[0] + b0 * W[2], (e2 + e0) * W[1] + b1 * W[2], b0 * W[0] + b1 * W[1] + (e0 + e1) * W[2])
    K = 0.5 * (W @ Pi)
    if has_normal:
        N = Symmetric(*x.state.auxiliary[:6]).matrix
        EN = body.read().euler_inertia @ N
        z = first_moment(EN)
        K = K + 0.5 * (EN[0] @ N[0] + EN[1] @ N[1] + EN[2] @ N[2]) + W @ z
        Pi = Pi + z
    f, q, pi = body.dead, R.T, R @ Pi
    V = -(f[0] @ q[0] + f[1] @ q[1] + f[2] @ q[2])
    ends = body.axis @ W, body.vertical @ pi, x.now[NODAL]
    x.now = (K, V, K + V - x.observed.work, *pi, *(body.basis @ Pi), *ends)


@part
def integrate(x: View, h: Any) -> None:
    """Add h times the quantities at the node to their integrals."""
    for i in loop(NODAL):
        x.set_number(i + INTEGRAL, x.number(i + INTEGRAL) + h * x.number(i + NOW))


@part
def extend(x: View, h: Any) -> None:
    """Take the quantities of a whole step into the least and the greatest, and the reaction into its integral."""
    for i in loop(QUANTITIES):
        now = x.number(i + NOW)
        x.set_number(i + LEAST, smaller(now, x.number(i + LEAST)))
        x.set_number(i + MOST, larger(now, x.number(i + MOST)))
    x.set_number(INTEGRAL + NODAL, x.number(INTEGRAL + NODAL) + h * x.number(NOW + NODAL))
    x.set_number(NOW + NODAL, 0.0 * h)


@part
def begin_observing(x: View) -> None:
    """Begin all least, greatest and integrals at the first node."""
    now, nan, infinite = x.now[:NODAL], float("nan"), float("inf")
    x.observed.first, x.observed.least, x.observed.most = (*now, nan), (*now, infinite), (*now, -infinite)
    x.observed.integral = (0.0,) * QUANTITIES

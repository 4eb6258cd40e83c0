"""What is observed of bodies on their way, at whole steps.

Least and greatest value of the quantities K, V, K + V - A (A: work of the load), π, Π, ψ', e·π (e vertical) and, as
means over a step, of the reaction moment -μ; their integrals over time are those of the trapezoidal rule over each step
or, with `gauss` and `split`, sums over their stages and substeps, of the order of the scheme. All in the units of the
body.
"""

from ..geometry.compiled import shared
from ..geometry.elements import lanes, load, store
from ..geometry.tuples import NAN, add, attitude, dot, first_moment, times, transposed
from .lane import matrix, put_vector, quaternion_at, vector
from .layout import BODY, NODAL, OBSERVATION, QUANTITIES, STATE, WORK

INFINITE = float("inf")


@shared
def observe(x, one, normal):
    """Set the quantities at the node whose state the workspace holds; `normal` as in `observe_at`."""
    observe_at(x, one, normal, attitude(quaternion_at(x, WORK.state, one)))


@shared
def observe_at(x, one, normal, R):
    """Set the quantities at the attitude R and the velocity in the workspace.

    N, the symmetric part of the director velocities, counts where there is one.

    With ``V_i = W × e_i + N_i`` it is K = ½ Σ E_ij V_i·V_j and Π = Σ e_i × Σ_j E_ij V_j.
    """
    n, W = lanes(one), vector(x, WORK.velocity, one)
    e0, e1, e2 = vector(x, WORK.body + BODY.E, one)
    b0, b1 = load(x, (WORK.body + BODY.off) * n, one), load(x, (WORK.body + BODY.off + 1) * n, one)
    Pi = ((e1 + e2) * W[0] + b0 * W[2], (e2 + e0) * W[1] + b1 * W[2], b0 * W[0] + b1 * W[1] + (e0 + e1) * W[2])
    kinetic = 0.5 * dot(W, Pi)
    if normal is not None:
        n00, n11, n22 = vector(x, WORK.state + STATE.extra, one)
        n12, n02, n01 = vector(x, WORK.state + STATE.extra + 3, one)
        N, zero = ((n00, n01, n02), (n01, n11, n12), (n02, n12, n22)), 0.0 * e0
        EN = (times(N, (e0, zero, -b0)), times(N, (zero, e1, -b1)), times(N, (-b0, -b1, e2)))
        z = first_moment(EN)
        kinetic = kinetic + 0.5 * (dot(EN[0], N[0]) + dot(EN[1], N[1]) + dot(EN[2], N[2])) + dot(W, z)
        Pi = add(Pi, z)
    f = matrix(x, WORK.body + BODY.dead, one)
    q = transposed(R)
    V = -(dot(f[0], q[0]) + dot(f[1], q[1]) + dot(f[2], q[2]))
    pi = times(R, Pi)
    store(x, WORK.now * n, kinetic)
    store(x, (WORK.now + 1) * n, V)
    store(x, (WORK.now + 2) * n, kinetic + V - load(x, (WORK.observed + OBSERVATION.work) * n, one))
    put_vector(x, WORK.now + 3, pi)
    put_vector(x, WORK.now + 6, times(matrix(x, WORK.body + BODY.basis, one), Pi))
    store(x, (WORK.now + 9) * n, dot(vector(x, WORK.body + BODY.axis, one), W))
    store(x, (WORK.now + 10) * n, dot(vector(x, WORK.body + BODY.vertical, one), pi))


@shared
def integrate(x, one, h):
    """Add h times the quantities at the node to their integrals."""
    n = lanes(one)
    for i in range(NODAL * n):
        x[(WORK.observed + OBSERVATION.integral) * n + i] += h * x[WORK.now * n + i]


@shared
def extend(x, one, h):
    """Take the quantities of a whole step into the least and the greatest, and the reaction into its integral."""
    n = lanes(one)
    for i in range(QUANTITIES * n):
        now = x[WORK.now * n + i]
        x[(WORK.observed + OBSERVATION.least) * n + i] = min(x[(WORK.observed + OBSERVATION.least) * n + i], now)
        x[(WORK.observed + OBSERVATION.most) * n + i] = max(x[(WORK.observed + OBSERVATION.most) * n + i], now)
    for i in range(NODAL * n, QUANTITIES * n):
        x[(WORK.observed + OBSERVATION.integral) * n + i] += h * x[WORK.now * n + i]
        x[WORK.now * n + i] = 0.0


@shared
def begin_observing(x, n):
    """Begin all least, greatest and integrals at the first node."""
    for i in range(QUANTITIES * n):
        nodal, now = i < NODAL * n, x[WORK.now * n + i]
        x[(WORK.observed + OBSERVATION.first) * n + i] = now if nodal else NAN
        x[(WORK.observed + OBSERVATION.least) * n + i] = now if nodal else INFINITE
        x[(WORK.observed + OBSERVATION.most) * n + i] = now if nodal else -INFINITE
        x[(WORK.observed + OBSERVATION.integral) * n + i] = 0.0

"""What is watched of 16 bodies in lanes on their way, at whole steps.

Least and greatest value of the quantities K, V, K + V - A (A: work of the load), π, Π, ψ', e·π (e vertical) and, as
means over a step, of the reaction moment -μ; their integrals over time are sums over the substeps, by the trapezoidal
rule, and so have the order of the composition.
"""

from ..geometry.compiled import inlined, kernel
from .lane_arrays import (
    AXIS,
    BASIS,
    DEAD,
    FIRST,
    INTEGRAL,
    LANES,
    LEAST,
    MOST,
    NODAL,
    NOW,
    OFF,
    PULL,
    QUANTITIES,
    SPARE,
    VERTICAL,
    WORK,
    J,
    P,
    W,
    euler_at,
    get,
    lanes,
    matrix_at,
    normal_at,
    product_of,
    put,
    put_vector,
    quaternion_at,
    vector,
)
from .midpoint_kernel import NAN, add, attitude, dot, first_moment, times

INFINITE = float("inf")


@inlined
def with_normal(x, l, w, Pi):
    """Return K = ½ Σ E_ij V_i·V_j and Π = Σ e_i × Σ_j E_ij V_j of V_i = W × e_i + N_i, from Π = J W."""
    N, E = normal_at(x, l), euler_at(x, l)[0]
    EN = product_of(E, N)
    z = first_moment(EN)
    own = dot(EN[0], N[0]) + dot(EN[1], N[1]) + dot(EN[2], N[2])
    return 0.5 * (dot(w, Pi) + own) + dot(w, z), add(Pi, z)


@kernel
def observe(x, normals):
    """Set the quantities at the node; N counts where there are `normals`."""
    for l in range(lanes(x)):
        w, (b0, b1), n = vector(x, W, l), (get(x, OFF, l), get(x, OFF + LANES, l)), vector(x, AXIS, l)
        j0, j1, j2 = vector(x, J, l)
        Pi = (j0 * w[0] + b0 * w[2], j1 * w[1] + b1 * w[2], b0 * w[0] + b1 * w[1] + j2 * w[2])
        R, f = attitude(quaternion_at(x, P, l)), matrix_at(x, DEAD, l)
        V = -(dot(f[0], (R[0][0], R[1][0], R[2][0])) + dot(f[1], (R[0][1], R[1][1], R[2][1])))
        V -= dot(f[2], (R[0][2], R[1][2], R[2][2]))
        kinetic = 0.5 * dot(w, Pi)
        if normals is not None:
            kinetic, Pi = with_normal(x, l, w, Pi)
        pi = times(R, Pi)
        put(x, NOW, l, kinetic)
        put(x, NOW + LANES, l, V)
        put(x, NOW + 2 * LANES, l, kinetic + V - get(x, WORK, l))
        put_vector(x, NOW + 3 * LANES, l, pi)
        put_vector(x, NOW + 6 * LANES, l, times(matrix_at(x, BASIS, l), Pi))
        put(x, NOW + 9 * LANES, l, dot(n, w))
        put(x, NOW + 10 * LANES, l, dot(vector(x, VERTICAL, l), pi))


@kernel
def integrate(x, h):
    """Add h times the quantities at the node to their integrals."""
    for i in range(NODAL * lanes(x)):
        put(x, INTEGRAL, i, get(x, INTEGRAL, i) + h * get(x, NOW, i))


@kernel
def widen(x, h):
    """Take the quantities of a whole step into the least and the greatest, and the reaction into its integral."""
    for l in range(lanes(x)):
        put(x, NOW + NODAL * LANES, l, get(x, PULL, l))
        put(x, INTEGRAL + NODAL * LANES, l, get(x, INTEGRAL + NODAL * LANES, l) + h * get(x, PULL, l))
        put(x, PULL, l, 0.0)
    # Over a spare place: a number that is stored where it has been read makes a masked store, slow on some processors.
    for i in range(QUANTITIES * lanes(x)):
        now, least = get(x, NOW, i), get(x, LEAST, i)
        put(x, SPARE, i, now if now < least else least)
    for i in range(QUANTITIES * lanes(x)):
        now, most = get(x, NOW, i), get(x, MOST, i)
        put(x, LEAST, i, get(x, SPARE, i))
        put(x, SPARE, i, now if now > most else most)
    for i in range(QUANTITIES * lanes(x)):
        put(x, MOST, i, get(x, SPARE, i))


@kernel
def start_watching(x, normals):
    """Begin all least, greatest and integrals at the first node."""
    observe(x, normals)
    for i in range(NODAL * LANES):
        x[FIRST + i] = x[LEAST + i] = x[MOST + i] = x[NOW + i]
    for i in range(NODAL * LANES, QUANTITIES * LANES):
        x[FIRST + i], x[LEAST + i], x[MOST + i] = NAN, INFINITE, -INFINITE
    for i in range(QUANTITIES * LANES):
        put(x, INTEGRAL, i, 0.0)

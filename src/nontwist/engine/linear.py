"""Runs linearised: how changes of a state and of what acts on a step go on through the steps, and back.

Of each step a scheme gives two matrices (`LINEAR`): M of the change of the state at its end by that at its beginning,
N by the inputs of the step. What a parameter p does to the inputs u of a step is a list of entries, ``du_c = v dp``:
those that are the same in all steps, and those of each step by itself. From there on the schemes are alike,

    forward:  X_{n+1} = M_n X_n + N_n V_n,        X = dx/dp,  V_n = du_n/dp,
    back:     λ_n = M_nᵀ λ_{n+1} + (∂f/∂x_n)ᵀ,    df/dp += V_nᵀ N_nᵀ λ_{n+1},

two sums of the same products, so ``λ·X`` at the end is ``df/dp`` to the round-off of the sums. Nothing is approximated:
these are the derivatives of the discrete run. Forward the entries that are the same in all steps are laid out as the
matrix V, so that a step is one product ``(M N)(X; V)`` in vectors of eight parameters; those of each step by itself are
added one by one.
"""

from ..geometry.compiled import inlined, kernel
from ..geometry.elements import doubles, eight, fused, integers, load, splat, store
from ..geometry.tuples import axpy, scaled
from ..kernels.memory import fields
from .layout import layout
from .linearised import Steps

LANES = 8
LINEAR = layout("Linear", **{name: field.size for name, field in fields(Steps).items()})
# A body in body components: J; what an inverse of J becomes under the constraint; the axis, 0 where there is none;
# damping; dead forces, rows; the direction of dead forces that have one.
FIXED = layout("Fixed", J=9, S=9, n=3, D=9, dead=9, vertical=3)
# What depends on the state, linearised at a node (`called_loads`): its moment, ``moment + velocity W + Σ rows_k c_k``,
# changes by `attitude` times the turn of the body at the beginning of the step. Matrices lie by columns.
CALLED = layout("Called", moment=3, velocity=9, attitude=9, rows=27)
# What goes through the steps: their number, rows of the state, columns of the inputs and of both, doubles between the
# entries of a matrix; parameters, rounded up to a multiple of 8; entries of all steps; how many states are kept.
CARRIED = layout(
    "Carried",
    steps=1,
    rows=1,
    width=1,
    stride=1,
    count=1,
    fixed=1,
    matrices=1,
    columns=1,  # back: of the fixed entries, and their parameters, values
    parameters=1,
    values=1,
    inputs=1,  # forward: the columns that have fixed entries, and these as rows (inputs, count)
    acting=1,
    changes=1,
    begins=1,  # (steps + 1,) where the entries of each step begin, parameter by parameter, 0: there are none
    own_columns=1,
    own_parameters=1,
    own_values=1,
    state=1,  # X (rows, count), or λ (rows,)
    kept=1,  # (steps,) 1: the state at the end of the step is kept
    states=1,  # forward (kept, 6, count); back (kept, 6), derivatives of f by attitude and velocity
    found=1,  # back: (count,) df/dp
    room=1,
)


@inlined
def multiplied(matrices, n, width, stride, x, acting, changes, inputs, y, count, rows, one):
    """Set y to M x and what the inputs add; the number of rows is known when this is compiled."""
    for k in range(0, count, LANES):
        for i in range(rows):
            s = splat(0.0, one)
            for c in range(inputs):
                s = fused(matrices[(i * width + acting[c]) * stride + n], load(changes, c * count + k, one), s)
            for j in range(rows):
                s = fused(matrices[(i * width + j) * stride + n], load(x, j * count + k, one), s)
            store(y, i * count + k, s)


@kernel
def forward(address):
    """Carry X through the steps, and write its first six rows where states are kept."""
    b = integers(address)
    one, rows, width, stride, count = eight(), b[CARRIED.rows], b[CARRIED.width], b[CARRIED.stride], b[CARRIED.count]
    matrices, x, y = doubles(b[CARRIED.matrices]), doubles(b[CARRIED.state]), doubles(b[CARRIED.room])
    inputs, acting, changes = b[CARRIED.inputs], integers(b[CARRIED.acting]), doubles(b[CARRIED.changes])
    begins, kept, states = integers(b[CARRIED.begins]), integers(b[CARRIED.kept]), doubles(b[CARRIED.states])
    own_columns, own_parameters = integers(b[CARRIED.own_columns]), integers(b[CARRIED.own_parameters])
    own_values, done = doubles(b[CARRIED.own_values]), 0
    for n in range(b[CARRIED.steps]):
        if rows == 6:
            multiplied(matrices, n, width, stride, x, acting, changes, inputs, y, count, 6, one)
        else:
            multiplied(matrices, n, width, stride, x, acting, changes, inputs, y, count, 12, one)
        first = begins[n] if b[CARRIED.begins] != 0 else 0
        end = begins[n + 1] if b[CARRIED.begins] != 0 else 0
        while first < end:
            k, last = own_parameters[first], first + 1
            while last < end and own_parameters[last] == k:
                last += 1
            for i in range(rows):
                s = y[i * count + k]
                for e in range(first, last):
                    s += own_values[e] * matrices[(i * width + own_columns[e]) * stride + n]
                y[i * count + k] = s
            first = last
        x, y = y, x
        if kept[n] != 0:
            for i in range(0, 6 * count, LANES):
                store(states, done * 6 * count + i, load(x, i, one))
            done += 1
    if b[CARRIED.steps] % 2 == 1:  # the state is where it was
        for i in range(0, rows * count, LANES):
            store(y, i, load(x, i, one))


@kernel
def back(address):
    """Carry λ back through the steps, and add what the parameters do to f."""
    b = integers(address)
    rows, width, stride = b[CARRIED.rows], b[CARRIED.width], b[CARRIED.stride]
    matrices, x, y = doubles(b[CARRIED.matrices]), doubles(b[CARRIED.state]), doubles(b[CARRIED.room])
    columns, parameters, values = (
        integers(b[CARRIED.columns]),
        integers(b[CARRIED.parameters]),
        doubles(b[CARRIED.values]),
    )
    begins, kept, states = integers(b[CARRIED.begins]), integers(b[CARRIED.kept]), doubles(b[CARRIED.states])
    own_columns, own_parameters = integers(b[CARRIED.own_columns]), integers(b[CARRIED.own_parameters])
    own_values, found, left = doubles(b[CARRIED.own_values]), doubles(b[CARRIED.found]), 0
    for n in range(b[CARRIED.steps]):
        left += kept[n]
    for k in range(b[CARRIED.steps]):
        n = b[CARRIED.steps] - 1 - k
        if kept[n] != 0:
            left -= 1
            for i in range(6):
                x[i] += states[6 * left + i]
        for j in range(width):
            s = 0.0
            for i in range(rows):
                s += matrices[(i * width + j) * stride + n] * x[i]
            y[j] = s
        for e in range(b[CARRIED.fixed]):
            found[parameters[e]] += values[e] * y[columns[e]]
        if b[CARRIED.begins] != 0:
            for e in range(begins[n], begins[n + 1]):
                found[own_parameters[e]] += own_values[e] * y[own_columns[e]]
        for i in range(rows):
            x[i] = y[i]


@inlined
def fixed_vector(c, place):
    return (c[place], c[place + 1], c[place + 2])


@inlined
def fixed_matrix(c, place):
    return (fixed_vector(c, place), fixed_vector(c, place + 3), fixed_vector(c, place + 6))


@inlined
def tall(v, one):
    """Return a vector of elements."""
    zero = splat(0.0, one)
    return (zero + v[0], zero + v[1], zero + v[2])


@inlined
def applied(A, v):
    """Return the matrix of the columns A times v."""
    return axpy(v[0], A[0], axpy(v[1], A[1], scaled(v[2], A[2])))


@inlined
def emit(b, out, first, column, rows):
    """Write a column of the matrices of some steps: the entries `rows`, elements."""
    width, stride = b[LINEAR.width], b[LINEAR.stride]
    for i in range(len(rows)):
        store(out, (i * width + column) * stride + first, rows[i])


@inlined
def inertia_times(e, x):
    """Return dJ x, where dJ is 1 in the entry e of 11, 22, 33, 23, 13, 12."""
    a = 1.0 if e == 0 else 0.0
    b, c = 1.0 if e == 1 else 0.0, 1.0 if e == 2 else 0.0
    d, f, g = 1.0 if e == 3 else 0.0, 1.0 if e == 4 else 0.0, 1.0 if e == 5 else 0.0
    return (
        a * x[0] + g * x[1] + f * x[2],
        g * x[0] + b * x[1] + d * x[2],
        f * x[0] + d * x[1] + c * x[2],
    )

"""How much changes of a state grow along a run: its linearised steps, with orthonormal changes in between.

X, the changes, goes through the matrices of the steps (`linear`), and every so many steps is replaced by the Q of X =
QR, by Gram and Schmidt (modified): ``Σ log R_kk`` is the logarithm of how much the k-th of them has grown, and the
first k together of the volume that they span. A change of W counts in units of a velocity; what is orthonormal is the
change over these units.

Of a body that may not turn about an axis n, changes of W are across n. Their round-off is not, and where it is not
removed each time, it grows over changes that shrink, until the last ones are nothing else.
"""

from ..geometry.compiled import inlined, kernel
from ..geometry.elements import doubles, eight, integers, load, root, shifted, store
from .layout import layout
from .linear import LANES, multiplied

# Steps, rows of the state, columns of the matrices and doubles between their entries; changes, at most `LANES`; steps
# between two times at which they are made orthonormal, which they are after the last one as well; addresses.
GROWTH = layout(
    "Growth",
    steps=1,
    rows=1,
    width=1,
    stride=1,
    count=1,
    every=1,
    matrices=1,
    weights=1,  # (rows,) 1 over the squares of the units
    normal=1,  # (rows,) a change that the body may not have, of length 1; 0 if there is none
    state=1,  # X (rows, LANES)
    room=1,
    lengths=1,  # (times, count) R_kk
)


@inlined
def orthonormalised(x, weights, normal, lengths, rows, count):
    """Replace the changes by orthonormal ones that span the same, across `normal`, and write how long they were."""
    for k in range(count):
        away = 0.0
        for i in range(rows):
            away += weights[i] * normal[i] * x[i * LANES + k]
        for i in range(rows):
            x[i * LANES + k] -= away * normal[i]
        for j in range(k):
            along = 0.0
            for i in range(rows):
                along += weights[i] * x[i * LANES + j] * x[i * LANES + k]
            for i in range(rows):
                x[i * LANES + k] -= along * x[i * LANES + j]
        square = 0.0
        for i in range(rows):
            square += weights[i] * x[i * LANES + k] * x[i * LANES + k]
        lengths[k] = root(square)
        for i in range(rows):
            x[i * LANES + k] /= lengths[k]


@kernel
def grow(address):
    """Carry X through the steps, and write its growth."""
    b = integers(address)
    one, rows, width, stride, count = eight(), b[GROWTH.rows], b[GROWTH.width], b[GROWTH.stride], b[GROWTH.count]
    matrices, x, y = doubles(b[GROWTH.matrices]), doubles(b[GROWTH.state]), doubles(b[GROWTH.room])
    weights, normal = doubles(b[GROWTH.weights]), doubles(b[GROWTH.normal])
    lengths, since = doubles(b[GROWTH.lengths]), 0
    for n in range(b[GROWTH.steps]):
        if rows == 6:
            multiplied(matrices, n, width, stride, x, b, x, 0, y, LANES, 6, one)
        else:
            multiplied(matrices, n, width, stride, x, b, x, 0, y, LANES, 12, one)
        x, y, since = y, x, since + 1
        if since == b[GROWTH.every] or n + 1 == b[GROWTH.steps]:
            orthonormalised(x, weights, normal, lengths, rows, count)
            lengths, since = shifted(lengths, count), 0
    if b[GROWTH.steps] % 2 == 1:  # the state is where it was
        for i in range(0, rows * LANES, LANES):
            store(y, i, load(x, i, one))

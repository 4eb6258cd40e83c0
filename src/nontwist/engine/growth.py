"""How much changes of a state grow along a run: its linearised steps, with orthonormal changes in between.

X, the changes, goes through the matrices of the steps (`linearised`), and every so many steps is replaced by the Q of
X = QR, by Gram and Schmidt (modified): ``Σ log R_kk`` is the logarithm of how much the k-th of them has grown, and the
first k together of the volume that they span. A change of W counts in units of a velocity; what is orthonormal is the
change over these units.

Of a body that may not turn about an axis n, changes of W are across n. Their round-off is not, and where it is not
removed each time, it grows over changes that shrink, until the last ones are nothing else.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

from ..kernels.control import Variables, loop, when
from ..kernels.elements import sqrt
from ..kernels.kernel import Kernel
from ..kernels.memory import Doubles, View, doubles
from .chained import LANES, multiply


class Growth(NamedTuple):
    """What goes through the steps: addresses and counts."""

    steps: int
    width: int  # columns of the matrices
    stride: int  # doubles between their entries
    changes: int  # at most `LANES`
    every: int  # steps between two times at which they are made orthonormal, which they are after the last one as well
    matrices: Doubles
    weights: Doubles  # (rows,) 1 over the squares of the units
    normal: Doubles  # (rows,) a change that the body may not have, of length 1; 0 if there is none
    state: Doubles  # X (rows, LANES)
    lengths: Doubles  # (times, count) R_kk


@lru_cache
def grow(rows: int) -> Kernel:
    """Return what carries X, of so many rows, through the steps, and writes its growth."""

    def orthonormalise(b: View, lengths: Any) -> None:
        """Replace the changes by orthonormal ones that span the same, across `normal`, and write how long they were."""
        x, weights, normal = b.state, [b.weights[i] for i in range(rows)], [b.normal[i] for i in range(rows)]
        for k in loop(b.changes):
            y = [x[i * LANES + k] for i in range(rows)]
            away = product(weights, normal, y)
            v = Variables(y=tuple(y[i] - away * normal[i] for i in range(rows)))
            for j in loop(k):
                before = [x[i * LANES + j] for i in range(rows)]
                along = product(weights, before, v.y)
                v.y = tuple(v.y[i] - along * before[i] for i in range(rows))
            length = sqrt(product(weights, v.y, v.y))
            lengths[k] = length
            for i in range(rows):
                x[i * LANES + k] = v.y[i] / length

    def text(address: Any) -> None:
        b = View(Growth, doubles(address))
        v = Variables(since=0, done=0)
        for n in loop(b.steps):
            multiply(b, n, rows, LANES)
            v.since = v.since + 1
            for _ in when((v.since == b.every) | (n + 1 == b.steps)):
                orthonormalise(b, b.lengths.shifted(v.done * b.changes))
                v.since, v.done = 0, v.done + 1

    return Kernel(text, "i8", 0)


def product(weights: Any, a: Any, b: Any) -> Any:
    """Return the scalar product with these weights."""
    total = weights[0] * a[0] * b[0]
    for w, x, y in zip(weights[1:], a[1:], b[1:], strict=True):
        total = total + w * x * y
    return total

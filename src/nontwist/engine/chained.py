"""Runs linearised: how changes of a state and of what acts on a step go on through the steps, and back.

Of each step a scheme gives two matrices (`linearised`): M of the change of the state at its end by that at its
beginning, N by the inputs of the step. What a parameter p does to the inputs u of a step is a list of entries, ``du_c =
v dp``: those that are the same in all steps, and those of each step by itself. From there on the schemes are alike,

    forward:  X_{n+1} = M_n X_n + N_n V_n,        X = dx/dp,  V_n = du_n/dp,
    back:     λ_n = M_nᵀ λ_{n+1} + (∂f/∂x_n)ᵀ,    df/dp += V_nᵀ N_nᵀ λ_{n+1},

two sums of the same products, so ``λ·X`` at the end is ``df/dp`` to the round-off of the sums. Nothing is approximated:
these are the derivatives of the discrete run. Forward the entries that are the same in all steps are laid out as the
matrix V, so that a step is one product ``(M N)(X; V)`` in vectors of parameters; those of each step by itself are added
one by one.

Growth. How much changes of a state grow along a run: its linearised steps, with orthonormal changes in between.

X, the changes, goes through the matrices of the steps (`linearised`), and every so many steps is replaced by the Q of
X = QR, by Gram and Schmidt (modified): ``Σ log R_kk`` is the logarithm of how much the k-th of them has grown, and the
first k together of the volume that they span. A change of W counts in units of a velocity; what is orthonormal is the
change over these units.

Of a body that may not turn about an axis n, changes of W are across n. Their round-off is not, and where it is not
removed each time, it grows over changes that shrink, until the last ones are nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

from ..kernels.control import Variables, loop, when
from ..kernels.elements import fma, sqrt
from ..kernels.kernel import Kernel, kernel
from ..kernels.memory import Doubles, View, Wholes, doubles, load, store
from ..kernels.tracing import width
from .records import places

LANES = 8


class Chain(NamedTuple):
    """What goes through the steps."""

    steps: int
    rows: int  # of the state
    width: int  # columns of the state and of the inputs
    stride: int  # doubles between the entries of a matrix
    padded: int  # parameters, rounded up to a multiple of `LANES`
    fixed: int  # entries of all steps
    matrices: Doubles
    columns: Wholes  # back: of the fixed entries, and their parameters, values
    parameters: Wholes
    values: Doubles
    inputs: int  # forward: how many columns have fixed entries, which, and these as rows (inputs, count)
    used: Wholes
    changes: Doubles
    begins: Wholes  # (steps + 1,) where the entries of each step begin; 0: there are none
    own_columns: Wholes
    own_parameters: Wholes
    own_values: Doubles
    state: Doubles  # X (rows, count), or λ (rows,)
    kept: Wholes  # (steps,) 1: the state at the end of the step is kept
    states: Doubles  # forward (kept, 6, count); back (kept, 6), derivatives of f by attitude and velocity
    found: Doubles  # back: (count,) df/dp
    scratch: Doubles  # back: (width,)


CHAIN = places(Chain)


def multiply(
    c: Any, n: Any, rows: int, count: Any, add: Callable[[Any, Any, Variables], None] = lambda row, k, y: None
) -> None:
    """Replace X, so many rows of `count` numbers, by M X; `add` adds to `y.y`, the numbers k of a row."""
    entries = c.matrices.shifted(n)
    for k in loop(0, count, width()):
        x = [load(c.state, j * count + k) for j in range(rows)]
        for i in loop(rows):
            row = entries.shifted(i * c.width * c.stride)
            y = Variables(y=row[0] * x[0])
            for j in range(1, rows):
                y.y = fma(row[j * c.stride], x[j], y.y)
            add(row, k, y)
            store(c.state, i * count + k, y.y)


@lru_cache
def forward(rows: int) -> Kernel:
    """Return what carries X, of so many rows, through the steps, and writes six rows of it where states are kept."""

    def text(address: Any) -> None:
        c, lanes = View(Chain, doubles(address)).read(), width()
        x, v = c.state, Variables(done=0)

        def add(row: Any, k: Any, y: Variables) -> None:
            """Add what the fixed entries do."""
            for j in loop(c.inputs):
                y.y = fma(row[c.used[j] * c.stride], load(c.changes, j * c.padded + k), y.y)

        for n in loop(c.steps):
            multiply(c, n, rows, c.padded, add)
            for _ in when(c.begins.address != 0):
                for e in loop(c.begins[n], c.begins[n + 1]):
                    column = c.matrices.shifted(n + c.own_columns[e] * c.stride)
                    to, value = x.shifted(c.own_parameters[e]), c.own_values[e]
                    for i in range(rows):
                        to[i * c.padded] = fma(value, column[i * c.width * c.stride], to[i * c.padded])
            for _ in when(c.kept[n] != 0):
                for k in loop(0, 6 * c.padded, lanes):
                    store(c.states, v.done * 6 * c.padded + k, load(x, k))
                v.done = v.done + 1

    return Kernel(text, "i8", 0)


@kernel("i8")
def back(address: Any) -> None:
    """Carry λ back through the steps, and add what the parameters do to f."""
    c = View(Chain, doubles(address)).read()
    x, y, found, v = c.state, c.scratch, c.found, Variables(left=0)
    for n in loop(c.steps):
        v.left = v.left + c.kept[n]
    for k in loop(c.steps):
        n = c.steps - 1 - k
        for _ in when(c.kept[n] != 0):
            v.left = v.left - 1
            for i in range(6):
                x[i] = x[i] + c.states[6 * v.left + i]
        for j in loop(c.width):
            entries, s = c.matrices.shifted(j * c.stride + n), Variables(s=0.0 * x[0])
            for i in loop(c.rows):
                s.s = fma(entries[i * c.width * c.stride], x[i], s.s)
            y[j] = s.s
        for e in loop(c.fixed):
            p = c.parameters[e]
            found[p] = fma(c.values[e], y[c.columns[e]], found[p])
        for _ in when(c.begins.address != 0):
            for e in loop(c.begins[n], c.begins[n + 1]):
                p = c.own_parameters[e]
                found[p] = fma(c.own_values[e], y[c.own_columns[e]], found[p])
        for i in loop(c.rows):
            x[i] = y[i]


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

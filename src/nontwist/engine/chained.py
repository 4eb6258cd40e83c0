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
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

from ..kernels.control import Variables, loop, when
from ..kernels.elements import fma
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
    acting: Wholes
    changes: Doubles
    begins: Wholes  # (steps + 1,) where the entries of each step begin; 0: there are none
    own_columns: Wholes
    own_parameters: Wholes
    own_values: Doubles
    state: Doubles  # X (rows, count), or λ (rows,)
    kept: Wholes  # (steps,) 1: the state at the end of the step is kept
    states: Doubles  # forward (kept, 6, count); back (kept, 6), derivatives of f by attitude and velocity
    found: Doubles  # back: (count,) df/dp
    scratch: Doubles


CHAIN = places(Chain)


def combine(factors: list[Any], x: Any, to: Any, count: Any) -> None:
    """Put the sum of rows of so many numbers, times these factors, to a row."""
    for k in loop(0, count, width()):
        s = factors[0] * load(x, k)
        for j, factor in enumerate(factors[1:], 1):
            s = fma(factor, load(x, j * count + k), s)
        store(to, k, s)


@lru_cache
def forward(rows: int) -> Kernel:
    """Return what carries X, of so many rows, through the steps, and writes six rows of it where states are kept."""

    def text(address: Any) -> None:
        c, lanes = View(Chain, doubles(address)).read(), width()
        x, y, v = c.state, c.scratch, Variables(done=0)
        for n in loop(c.steps):
            entries = c.matrices.shifted(n)
            for i in loop(rows):
                row, to = entries.shifted(i * c.width * c.stride), y.shifted(i * c.padded)
                combine([row[j * c.stride] for j in range(rows)], x, to, c.padded)
                for j in loop(c.inputs):
                    entry, changes = row[c.acting[j] * c.stride], c.changes.shifted(j * c.padded)
                    for k in loop(0, c.padded, lanes):
                        store(to, k, fma(entry, load(changes, k), load(to, k)))
            for _ in when(c.begins.address != 0):
                for e in loop(c.begins[n], c.begins[n + 1]):
                    column = entries.shifted(c.own_columns[e] * c.stride)
                    to, value = y.shifted(c.own_parameters[e]), c.own_values[e]
                    for i in range(rows):
                        to[i * c.padded] = fma(value, column[i * c.width * c.stride], to[i * c.padded])
            for k in loop(0, rows * c.padded, lanes):
                store(x, k, load(y, k))
            for _ in when(c.kept[n] != 0):
                for k in loop(0, 6 * c.padded, lanes):
                    store(c.states, v.done * 6 * c.padded + k, load(y, k))
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

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
    count: int  # parameters, rounded up to a multiple of `LANES`
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
    room: Doubles


CHAIN = places(Chain)


@lru_cache
def forward(rows: int) -> Kernel:
    """Return what carries X, of so many rows, through the steps, and writes six rows of it where states are kept."""

    def multiply(b: View, n: Any) -> None:
        """Replace X by M X and what the inputs add."""
        x, y, lanes = b.state, b.room, width()
        for k in loop(0, b.count, lanes):
            for i in loop(rows):
                v = Variables(s=0.0 * load(x, k))
                for c in loop(b.inputs):
                    entry = b.matrices[(i * b.width + b.acting[c]) * b.stride + n]
                    v.s = fma(entry, load(b.changes, c * b.count + k), v.s)
                for j in range(rows):
                    v.s = fma(b.matrices[(i * b.width + j) * b.stride + n], load(x, j * b.count + k), v.s)
                store(y, i * b.count + k, v.s)
        for k in loop(0, rows * b.count, lanes):
            store(x, k, load(y, k))

    def text(address: Any) -> None:
        b = View(Chain, doubles(address))
        v = Variables(done=0)
        for n in loop(b.steps):
            multiply(b, n)
            for _ in when(b.begins.address != 0):
                for e in loop(b.begins[n], b.begins[n + 1]):
                    for i in loop(rows):
                        at = i * b.count + b.own_parameters[e]
                        entry = b.matrices[(i * b.width + b.own_columns[e]) * b.stride + n]
                        b.state[at] = b.state[at] + b.own_values[e] * entry
            for _ in when(b.kept[n] != 0):
                for k in loop(0, 6 * b.count, width()):
                    store(b.states, v.done * 6 * b.count + k, load(b.state, k))
                v.done = v.done + 1

    return Kernel(text, "i8", 0)


@kernel("i8")
def back(address: Any) -> None:
    """Carry λ back through the steps, and add what the parameters do to f."""
    b = View(Chain, doubles(address))
    x, y, v = b.state, b.room, Variables(left=0)
    for n in loop(b.steps):
        v.left = v.left + b.kept[n]
    for k in loop(b.steps):
        n = b.steps - 1 - k
        for _ in when(b.kept[n] != 0):
            v.left = v.left - 1
            for i in range(6):
                x[i] = x[i] + b.states[6 * v.left + i]
        for j in loop(b.width):
            s = Variables(s=0.0 * x[0])
            for i in loop(b.rows):
                s.s = s.s + b.matrices[(i * b.width + j) * b.stride + n] * x[i]
            y[j] = s.s
        for e in loop(b.fixed):
            p = b.parameters[e]
            b.found[p] = b.found[p] + b.values[e] * y[b.columns[e]]
        for _ in when(b.begins.address != 0):
            for e in loop(b.begins[n], b.begins[n + 1]):
                p = b.own_parameters[e]
                b.found[p] = b.found[p] + b.own_values[e] * y[b.own_columns[e]]
        for i in loop(b.rows):
            x[i] = y[i]

"""The iteration for three unknowns that the implicit schemes share: when a body is done, and when it is lost.

Increments of a chord iteration (the Jacobian of the first guess is kept) shrink by one factor each, so the one after
d is d²/d_before; with Newton's iteration by the square of the factor, d³/d_before². A body is done once the increment
is round-off of its velocity, or the next one a small part of that (what is left in each step has one direction, and
would add up to a drift); or when increments have stopped falling and either are small or what is left of the equations
is round-off of their terms, as for needles. Among the terms are those that cancel within a moment, of springs and drag
at an equilibrium: their size is that of the change by a turn of one radian, however small the moment is. The body then
keeps its value, whatever its neighbours do, so the result depends on that body alone.
"""

from ..geometry.compiled import inlined
from ..geometry.elements import both, either, without
from ..geometry.tuples import EPS, add, chosen, size, times

ITERATIONS, CHORDS = 40, 3
ROUND_OFF = 16.0 * EPS
FALLING, SMALL, LOST, REST = 0.5, 1e-9, 1e300, 1e-4


@inlined
def cancelling(f, Om, D, S):
    """Return the size of what may cancel in f m, f = h/2: drag, and the change of m by a turn, S = dm/dΩ = f dm/da."""
    return abs(f) * size(times(D, Om)) + size(S[0]) + size(S[1]) + size(S[2])


@inlined
def advance(count, is_open, lost, x, d, now, before, level, left_over, terms):
    """Return the unknown after the increment d, and the masks of bodies that remain open and are lost.

    `now` and `before` are the sizes of this increment and of the last one, `level` that of the velocity. In the first
    iterations nothing but `is_open` decides on the sum: it does not wait for a comparison.
    """
    finite = now <= LOST
    lost = either(lost, without(is_open, finite))
    done = either(without(is_open, finite), now <= level)
    if count > 0:
        done = either(done, now * now <= REST * level * before)
    if count >= CHORDS:
        done = either(done, now * now * now <= REST * level * before * before)
        stuck = now > FALLING * before
        done = either(done, both(stuck, EPS * now <= SMALL * level))
        rests = without(both(stuck, left_over <= ROUND_OFF * terms), done)
        return chosen(without(is_open, rests), add(x, d), x), without(is_open, either(done, rests)), lost
    return chosen(is_open, add(x, d), x), without(is_open, done), lost

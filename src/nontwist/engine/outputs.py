"""States between the nodes of a march: substeps of the same scheme from the last node.

A run goes from node to node of its grid, whatever output is asked for. A state at t between the nodes t_n and t_{n+1}
is that of one more step of the scheme, from the state at t_n over t - t_n, which is then left aside. So it depends on
t and the run alone, not on the other outputs; it has the order of the scheme, as its own error is that of one step;
whatever the scheme keeps at any length of a step is kept there too; and it crosses no kink of the load that is a node.

Means over an interval between outputs follow from integrals over time, which are exact as well: with T the integral
from the last output o to the node t_n, S that over the step, E(o) that over the substep to the output o,

    from o to o' in the same step: E(o') - E(o);    from o to the node t_{n+1}: S - E(o);    onwards: T + E(o').

So T becomes -E(o) once o is written, and T + S at the next node. An impulse or a work of the load that balances over
each step balances between any two outputs.

A march with outputs is a list of calls of its kernel, in order, made beforehand (`integrators.output_calls`), which is
carried out here for a few members at a time.

The substeps of a Gauss step are guessed from its own stages, which are known by then: let q be the polynomial through
their derivatives, and those of the step before, if there is one on the same grid. The stages of a substep of the length
θ h have the increments ``θ h b_k q(θ c_k)``. As the kernel extrapolates what it is given by one step, it is given

    L_j = θ h b_j Σ_k l_k(c_j - 1) q(θ c_k),

which it takes there. `within` holds c and b, the numbers l_k(c_j - 1) column by column, each padded to eight, and the
matrices that make the coefficients of q, lowest first, of s increments and of 2s.
"""

from ..geometry.compiled import inlined, kernel, shared
from ..geometry.elements import call_kernel, doubles, eight, integers, load, shifted, splat, store
from .lane import write
from .layout import BLOCK, CALL, CALLS, STATE, SUMS, WORK

GO, LEG, OUTPUT, NODE = range(4)
COMPONENTS, EIGHT = 6, 8  # of the increments that a member carries; stages that there is room for


@inlined
def copy(source, target, count):
    """Copy so many numbers."""
    for k in range(count):
        target[k] = source[k]


@shared
def collected(b, into, order, first, last):
    """Take the sums of the members out, and put them to `into`."""
    sums = doubles(b[BLOCK.sums])
    for l in range(last - first):
        for k in range(SUMS.size):
            into[l * SUMS.size + k] = sums[order[first + l] * SUMS.size + k]
            sums[order[first + l] * SUMS.size + k] = 0.0


@inlined
def joined(a, c, l, k):
    """Return the sum of two integrals; of iterations the larger number."""
    return max(a[k], c[l * SUMS.size + k]) if k == SUMS.iterations else a[k] + c[l * SUMS.size + k]


@shared
def back_from_leg(after, leg, states, totals, order, first, count, size):
    """Put the members back to the end of the leg, and add what it gave to their sums."""
    for l in range(count):
        i = order[first + l]
        copy(shifted(after, l * size), shifted(states, i * size), size)
        T = shifted(totals, i * SUMS.size)
        for k in range(SUMS.size):
            T[k] = joined(T, leg, l, k)


@shared
def fitted(before, after, within, s, knows, into):
    """Put the coefficients of the polynomials through the derivatives of a step to `into`, from its increments `after`.

    Where it `knows` those of the step before, they are fitted as well.
    """
    count = 2 * s if knows else s
    matrix = 2 * EIGHT + EIGHT * s + (s * s if knows else 0)
    for c in range(COMPONENTS):
        for k in range(count):
            a = 0.0
            for j in range(s):
                a += within[matrix + (j + count - s) * count + k] * after[c * s + j]
                if knows:
                    a += within[matrix + j * count + k] * before[c * s + j]
            into[c * count + k] = a


@shared
def guessed(increments, within, s, theta, knows, polynomials):
    """Set the increments of the last step so that those of a substep follow; behind the polynomials there is room."""
    count, like = 2 * s if knows else s, eight()
    at, scale, room = theta * load(within, 0, like), theta * load(within, EIGHT, like), 2 * COMPONENTS * s
    for c in range(COMPONENTS):
        value = splat(0.0, like)
        for k in range(count - 1, -1, -1):
            value = value * at + polynomials[c * count + k]
        store(polynomials, room, value)
        value = splat(0.0, like)
        for k in range(s):
            value = value + load(within, (2 + k) * EIGHT, like) * polynomials[room + k]
        store(polynomials, room, scale * value)
        for i in range(s):
            increments[c * s + i] = polynomials[room + i]


@kernel
def carry_out(address):
    """Carry out the list of calls of the block for the members `begin` to `end` of its order."""
    b = integers(address)
    head = integers(b[BLOCK.calls])
    order, begin, end, n = integers(b[BLOCK.order]), b[BLOCK.begin], b[BLOCK.end], head[CALLS.width]
    for first in range(begin, end, n):
        b[BLOCK.begin], b[BLOCK.end] = first, min(first + n, end)
        for_some(address, b, head, order, n, first, b[BLOCK.end])
    b[BLOCK.begin], b[BLOCK.end] = begin, end


@shared
def for_some(address, b, head, order, n, first, last):
    """Carry out a list of calls for the members `first` to `last` of the order, as many as the kernel takes at once."""
    x, states, size = doubles(b[BLOCK.workspace]), doubles(b[BLOCK.states]), b[BLOCK.state_size]
    failures, totals = doubles(b[BLOCK.failures]), doubles(head[CALLS.totals])
    base = doubles(head[CALLS.room])  # states at the beginning of a leg, those at its end, and two sets of sums
    after = shifted(base, n * size)
    leg = shifted(after, n * size)
    own = shifted(leg, n * SUMS.size)
    fits, within = shifted(own, n * SUMS.size), doubles(head[CALLS.within])
    reports, observed = b[BLOCK.intervals] != 0, b[BLOCK.observed]
    s, inside, count, knows = head[CALLS.stages], False, last - first, False
    fit = 2 * COMPONENTS * s + EIGHT
    for number in range(head[CALLS.count]):
        row = integers(head[CALLS.rows] + 8 * CALL.size * number)
        reals = doubles(head[CALLS.reals] + 16 * number)
        op = row[CALL.op]
        if inside and op != OUTPUT:
            inside = False
            back_from_leg(after, leg, states, totals, order, first, count, size)
        b[BLOCK.first], b[BLOCK.steps], b[BLOCK.step] = row[CALL.first], row[CALL.steps], row[CALL.step]
        b[BLOCK.times], b[BLOCK.moving], b[BLOCK.space] = row[CALL.times], row[CALL.moving], row[CALL.space]
        b[BLOCK.rotor], b[BLOCK.spin] = row[CALL.rotor], row[CALL.spin]
        b[BLOCK.forces] = row[CALL.forces]
        b[BLOCK.resumed] = row[CALL.first] + row[CALL.steps]
        b[BLOCK.ceased] = row[CALL.first] if row[CALL.coasts] != 0 else b[BLOCK.resumed]
        b[BLOCK.observed] = observed
        if op >= OUTPUT:
            b[BLOCK.observed] = 0
        if op == OUTPUT:
            for l in range(count):
                state = shifted(states, order[first + l] * size)
                copy(shifted(base, l * size), state, size)
                if s > 0:
                    guessed(shifted(state, STATE.size), within, s, reals[1], knows, shifted(fits, l * fit))
        elif row[CALL.begins] != 0:  # a stretch: nothing is known of the step before
            for l in range(count):
                state = shifted(states, order[first + l] * size)
                for k in range(head[CALLS.guesses], size):
                    state[k] = 0.0
        if op == LEG:
            for l in range(count):
                copy(shifted(states, order[first + l] * size), shifted(base, l * size), size)
        call_kernel(head[CALLS.kernel], address)
        if op == LEG:
            inside, knows = True, row[CALL.first] > 0 and row[CALL.begins] == 0
            for l in range(count):
                state = shifted(states, order[first + l] * size)
                copy(state, shifted(after, l * size), size)
                if s > 0:
                    before = shifted(base, l * size + STATE.size)
                    fitted(before, shifted(state, STATE.size), within, s, knows, shifted(fits, l * fit))
        if reports:
            collected(b, leg if op == LEG else own, order, first, last)
            for l in range(count):
                T = shifted(totals, order[first + l] * SUMS.size)
                for k in range(SUMS.size):
                    if op == GO:
                        T[k] = joined(T, own, l, k)
                    elif op != LEG:
                        whole = k >= SUMS.work
                        x[(WORK.sums + k) * n + l] = joined(T, own, l, k) * (1.0 if whole else reals[0])
                        T[k] = 0.0 if k == SUMS.iterations else -own[l * SUMS.size + k]
        if op >= OUTPUT:
            write(b, x, n, row[CALL.place], first, last)
        alive = False
        for l in range(count):
            alive = alive or failures[4 * order[first + l]] == 0.0
        if not alive:
            break
    if inside:
        back_from_leg(after, leg, states, totals, order, first, count, size)
    b[BLOCK.observed] = observed

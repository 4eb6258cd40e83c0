"""The numbers of member i, a function of the table ``[sweep]`` and i alone, so that blocks are independent.

Member i is at the point ``i // samples`` of the product of grids and lists. Its random numbers come from a point of the
unit cube. Random: every key has a Philox generator of its own (Salmon et al. 2011), whose key is hashed from the seed
and the name, and member i takes the numbers at the counter ``c i``, with c the blocks of four that a value needs.
Its raw integers are used, ``u = (n + 1/2) 2^-53``: they never change, unlike NumPy's distributions.
Quasi-random: all drawn keys share one scrambled sequence, and member i takes its i-th point.
"""

from __future__ import annotations

import hashlib
import threading
from typing import Any

import numpy as np

from ..geometry.arrays import Array
from ..runfile.sweep_table import Drawn, Sweep

Values = dict[str, Array]
LEAST, MOST = 2.0**-54, 1 - 2.0**-53
_sequences = threading.local()


def values(sweep: Sweep, first: int, last: int) -> Values:
    """Return the numbers of members `first` to ``last - 1``: for each key an array, the member axis first."""
    i = np.arange(first, last)
    found: Values = {}
    if sweep.axes:
        at = np.unravel_index(i // sweep.samples, sweep.shape)
        places = at * len(sweep.axes) if sweep.combine == "together" else at
        for one, place in zip(sweep.axes, places, strict=True):
            found[one.key] = one.points()[place]
    if sweep.drawn:
        columns = [np.ascontiguousarray(part) for part in _cube(sweep, first, last)]
        for drawn, u in zip(sweep.drawn, columns, strict=True):
            found[drawn.key] = drawn.values(u)
    return {one.key: found[one.key] for one in sweep.over}


def spread(sweep: Sweep, count: int, runs: int = 16) -> Values:
    """Return the numbers of about `count` members, taken in `runs` runs of neighbours all over the sweep."""
    members = sweep.members
    length = max(1, min(count, members) // runs)
    starts = np.unique(np.linspace(0, members - length, min(runs, members)).astype(np.int64)).tolist()
    parts = [values(sweep, first, first + length) for first in starts]
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}


def _cube(sweep: Sweep, first: int, last: int) -> list[Array]:
    """Return points inside of the unit cube, (m, dimension), one array for each drawn key."""
    drawn = sweep.drawn
    if sweep.sampling == "random":
        return [_random(sweep.seed, one, first, last) for one in drawn]
    ends = np.cumsum([one.dimension for one in drawn])
    points: Array = np.clip(_quasi_random(sweep.sampling, sweep.seed, int(ends[-1]), first, last), LEAST, MOST)
    return list(np.split(points, ends[:-1], axis=1))


def _random(seed: int, one: Drawn, first: int, last: int) -> Array:
    name = int.from_bytes(hashlib.sha256(one.key.encode()).digest()[:16], "little")
    stream, blocks = np.random.Philox(np.random.SeedSequence((seed, name))), -(-one.dimension // 4)
    raw = stream.advance(first * blocks).random_raw(4 * blocks * (last - first))
    u: Array = ((raw >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53
    return u.reshape(last - first, -1)[:, : one.dimension]


def _quasi_random(name: str, seed: int, dimension: int, first: int, last: int) -> Array:
    """Return points of the sequence; each thread has an engine, which advances from block to block."""
    key = (name, seed, dimension)
    if getattr(_sequences, "key", None) != key:
        _sequences.key, _sequences.engine = key, _engine(*key)
    engine = _sequences.engine
    if engine.num_generated > first:
        engine.reset()
    if first > engine.num_generated:
        engine.fast_forward(first - engine.num_generated)
    if first == 0:  # by itself: Sobol warns of a first block whose length is not a power of 2
        points: Array = np.concatenate([engine.random(1), engine.random(last - 1)])
        return points
    points = engine.random(last - first)
    return points


def _engine(name: str, seed: int, dimension: int) -> Any:
    from scipy.stats import qmc

    generator = np.random.default_rng(seed)
    return qmc.Sobol(dimension, seed=generator, bits=32) if name == "sobol" else qmc.Halton(dimension, seed=generator)

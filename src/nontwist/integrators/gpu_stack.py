"""A stack of problems marched on a GPU (`kernels.gpu`): the same texts, one member a thread.

A thread has a block and a workspace of its own on its stack, and carries out the whole list of calls for its member.
What a block points to is copied to the GPU for each list, with the addresses of the copies in place of its own, and
what the march writes is copied back.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..engine.generalised import generalised
from ..engine.marching import Text, marching_text
from ..engine.records import BLOCK, Block, Parts, pack
from ..engine.workspace import CALL, IN_BLOCK, begin_call, for_some
from ..errors import InputError
from ..kernels import gpu
from ..kernels.control import loop, when
from ..kernels.elements import logical_not
from ..kernels.kernel import part
from ..kernels.memory import Doubles, View, Wholes, doubles, fields, scratch, size_of
from ..loads import Load
from ..loads.friction import DryFriction
from ..loads.functions import MachineFunction
from ..loads.memory_terms import Wheel
from .integrator import Integrator
from .stack_march import Listed, StackMarch

SCHEMES = ("gauss", "lie-midpoint", "energy-momentum")
POINTERS = [getattr(BLOCK, name) for name, field in fields(Block).items() if field.kind in (Doubles, Wholes)]
POINTERS += [BLOCK.forces, BLOCK.terms]
IN_CALL = [getattr(CALL, name) for name in IN_BLOCK[IN_BLOCK.index("step") :]]
ARRAYS = "bodies", "scales", "table", "stored", "lengths", "sizes", "sequence", "about", "internal_scales"


def require(scheme: Integrator, load: Load) -> None:
    """Raise an InputError: not-on-gpu, where an integrator or a part of a load does not run there; no-gpu."""
    if scheme.name not in SCHEMES:
        raise InputError("not-on-gpu", what=f"the integrator {scheme.name}", but=f", but {', '.join(SCHEMES)} do")
    for term in (*load.called.terms, *load.functions, *load.remembering, *load.frictions):
        is_stopped = isinstance(term, Wheel | DryFriction)
        if is_stopped or not isinstance(term.c_function, MachineFunction):
            but = "" if is_stopped else ", but functions of Python do with compiled=True"
            raise InputError("not-on-gpu", what=f"the load {term.words(term.description)}", but=but)
    gpu.gpu()


class GpuMarch(StackMarch):
    """A march of a stack on a GPU."""

    def _tasks(self, threads: int) -> list[tuple[Parts, int, tuple[int, int], int]]:
        ends = np.cumsum([0, *np.bincount(self.group).tolist()]).tolist()
        return [(parts, 1, span, len(self.stack)) for parts, span in zip(self.groups, pairwise(ends), strict=True)]

    def _run(self, todo: Listed, width: int, first: int, last: int) -> None:
        """Carry out a list of calls for some members."""
        text, parts = self.made_for(todo.parts, 1)
        run = member(text, parts, todo.values["rates"] is not None, self.workspace_size(1), self.shapes["states"][1])
        code = gpu.code_of(
            run, {(1, self.functions.generalised): generalised.text} | texts_of(self.functions.keepalive)
        )
        block, rows = self.block.copy(), todo.values["rows"].copy()
        results = self.arrays["quaternions"].base  # in which all arrays of the march are
        assert results is not None
        device = gpu.gpu()
        device.use()
        with Copies(device) as copies:
            own = [getattr(self, name) for name in ARRAYS], todo.values["rates"], todo.keepalive
            copies.add(results, *arrays_in((own, self.functions.keepalive, self.loads, self.stages[todo.parts][0])))
            rows[:, IN_CALL] = copies.of(rows[:, IN_CALL])
            copies.add(rows)
            pack(block, BLOCK, **todo.values | {"rows": rows}, begin=first)
            block[POINTERS] = copies.of(block[POINTERS])
            device.run(code, copies.add(block), last - first)
            device.take(int(copies.of(np.array([results.ctypes.data]))[0]), results)


def texts_of(functions: Any) -> dict[tuple[int, int], Any]:
    """Return the texts of functions that were traced."""
    return {(4, one.address): one.text for one in functions if isinstance(one, MachineFunction)}


def arrays_in(found: Any) -> Iterator[Any]:
    """Yield the arrays in tuples and lists of them."""
    if isinstance(found, np.ndarray):
        yield found
    elif isinstance(found, (tuple, list)):
        for one in found:
            yield from arrays_in(one)


class Copies:
    """Copies of arrays on a GPU, until they are left."""

    def __init__(self, device: gpu.Gpu) -> None:
        self._device, self._places = device, list[tuple[int, int, int]]()  # address here, bytes, address there

    def __enter__(self) -> Copies:
        return self

    def __exit__(self, *_: object) -> None:
        for _here, _size, there in self._places:
            self._device.free(there)

    def add(self, *arrays: NDArray[Any]) -> int:
        """Copy arrays; return where the last one is."""
        for array in arrays:
            self._places.append((array.ctypes.data, array.nbytes, self._device.copy(array)))
        return self._places[-1][2]

    def of(self, addresses: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return where the copies have what lies at addresses; 0 for 0."""
        here, size, there = np.array(sorted(self._places)).T
        k = np.searchsorted(here, addresses, side="right") - 1
        within = addresses - here[k]
        assert ((addresses == 0) | (within <= size[k])).all()
        return np.where(addresses == 0, 0, there[k] + within)


def copied(record: Any, memory: Any) -> View:
    """Return a view of a copy of a record on the stack."""
    own = scratch(size_of(record))
    for k in range(size_of(record)):
        own.shifted(k, True)[0] = memory.shifted(k, True)[0]
    return View(record, own)


def member(
    text: Text, parts: Parts, has_outputs: bool, workspace_size: int, state_size: int
) -> Callable[[Any, Any], None]:
    """Return the text that carries out a list of calls for one member, given the block and which of its members it is.

    The workspace has room for so many numbers; a member carries `state_size` from step to step.
    """
    onwards, to_output = part(marching_text(text, parts)), part(marching_text(text, parts._replace(observes=False)))

    def run(address: Any, number: Any) -> None:
        b = copied(Block, doubles(address))
        i = b.begin + number
        b.begin, b.end, b.workspace, b.scratch = i, i + 1, scratch(workspace_size), scratch(state_size)

        def marched(is_output: Any) -> None:
            for _ in when(is_output) if parts.observes else ():
                to_output(b.address)
            for _ in when(logical_not(is_output) if parts.observes else True):
                onwards(b.address)

        if has_outputs:
            for_some(parts, b, marched)
            return
        for k in loop(b.calls):
            begin_call(b, k, i, i + 1)
            onwards(b.address)

    return run

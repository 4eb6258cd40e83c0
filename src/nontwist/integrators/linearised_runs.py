"""The steps of a run, linearised: from a problem and its states at all nodes to the matrices of its steps.

`tangents` chains them. What acts is laid out some steps at a time, so that what is in use is little, whatever the
length of the run; matrices are made within the kernels that multiply by them, `LANES` steps at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..engine.called_functions import DifferentiableFunctions
from ..engine.generalised import OF_TABLE, OF_TERMS, STATE, TERM, sloped
from ..engine.known_steps import INPUTS, LANES, STEPS, KnownStep, column_offsets, offsets_of_directions
from ..engine.linearised import forward_run, linearised, tangent_size
from ..engine.records import BODY, pack
from ..geometry.arrays import Array, aligned
from ..geometry.attitudes import BASIS, ENTRIES, States
from ..kernels import machine_code
from ..kernels.kernel import Kernel, address_of
from ..kernels.memory import size_of
from ..loads import Load
from ..loads.load import is_called
from ..loads.potentials import ForceTable, Potential
from ..loads.terms import Term
from .compiled import Compiled
from .gauss_derivatives import scratch_size
from .integrator import Integrator, SimulationError, Status
from .ivp import IVP
from .load_samples import WIDTHS, as_marched, as_scaled_gyrostat, march_parts, orbit_of, sampled


class InputDerivatives(NamedTuple):
    """What parameters do to an input of steps: dinput[component] = value · dparameter, at a step, or at all of them."""

    name: str  # of the input
    component: NDArray[np.int64]
    parameter: NDArray[np.int64]
    value: Array
    step: NDArray[np.int64] | None = None  # None: at every step

    def transformed(self, T: Array) -> InputDerivatives:
        """Return what they do to the input times a matrix, node by node, without zeros."""
        columns = self.component % len(T)
        values = T[:, columns] * self.value
        rows, which = np.nonzero(values)
        step = None if self.step is None else self.step[which]
        component = self.component[which] - columns[which] + rows
        return InputDerivatives(self.name, component, self.parameter[which], values[rows, which], step)


EntriesOf = Callable[["StepNodes"], Iterable[InputDerivatives]]
StepMask = NDArray[np.int64]
Workspace = dict[str, Array]  # memory of one thread


class StepNodes(NamedTuple):
    """Some steps and the nodes of the load in them."""

    first: int
    last: int
    begin: Array  # (steps,) times
    end: Array
    sizes: Array
    middles: Array  # (s,) fractions
    times: Array  # (steps · s,) of the nodes

    @property
    def of_nodes(self) -> NDArray[np.int64]:
        """The number of the step of each node."""
        return np.repeat(np.arange(self.first, self.last), len(self.middles))


LONGEST, ONE = 2048, np.eye(1)  # steps that are laid out at a time


def scheme_of(integrator: Integrator, load: Load, with_memory: bool = False) -> Compiled:
    """Return an integrator that has derivatives; a ValueError where it has none, or its runs under a load.

    `with_memory`: whether loads may have memory (`memory_tangents`).
    """
    from . import INTEGRATORS

    own = (load.frictions, "under dry_friction", "a body begins to stick")
    for is_there, what, where in (own, (load.is_dry, "with coulomb= of a wheel", "a wheel begins to stand")):
        if is_there:
            raise ValueError(
                f"runs {what} have no derivatives: they jump where {where}; leave it out, or difference two runs"
            )
    if not (isinstance(integrator, Compiled) and integrator.has_derivatives):
        known = [name for name, one in INTEGRATORS.items() if one.has_derivatives]
        raise ValueError(f"{integrator.name} has no derivatives; those that have them are {', '.join(known)}")
    if load.memories and not with_memory:
        raise ValueError(
            "with loads with memory, friction of wheels among them, only sensitivities, gradient and propagators have "
            "derivatives; take differences of runs, or a load without memory"
        )
    if load.memories and integrator.is_director_scheme:
        raise ValueError(f"{integrator.name} has no derivatives under loads with memory; use gauss, or lie-midpoint")
    return integrator


class Linearised:
    """The steps of a problem of one body.

    Parameters
    ----------
    problem : IVP
    integrator : Integrator
    wanted : names of the inputs whose matrices are made
    changes : for each number of the input "terms", terms that depend on the state, and what their numbers change by

    Attributes
    ----------
    see_attitude : bool
        Whether what acts on the steps depends on the attitude.

    Raises
    ------
    ValueError
        The integrator has no derivatives; the load has memory.
    """

    def __init__(
        self, problem: IVP, integrator: Integrator, wanted: Iterable[str], changes: Sequence[Changes] = ()
    ) -> None:
        scheme = scheme_of(integrator, problem.load)
        problem = as_scaled_gyrostat(problem) if problem.load.wheels else problem
        self.problem = problem
        systems, self.load = as_marched(problem, scheme.is_director_scheme)
        self.axis = np.zeros(3) if systems.axis is None else systems.axis[0]
        wanted = set(wanted)
        sizes = tuple((name, size or len(changes)) for name, size in INPUTS.items() if name in wanted)
        about = orbit_of(systems, self.load, 1.0, scheme)
        called = [term for term in self.load.terms if is_called(term)]
        has_potential = [isinstance(term, Potential) for term in called]
        is_parted = scheme.linear is not None
        known = {"function": not all(has_potential) if is_parted else bool(called)}
        known |= {"generalised": is_parted and any(has_potential), "orbit": about is not None}
        (body,), (found,), _ = march_parts(systems, self.load, 1.0, problem.load_scale, scheme, **known)
        _, self.middles = scheme.stages(found)
        s, more = len(self.middles), wanted & {"moving", "space", "damping", "dead", "spin"}
        more_parts: dict[str, Any] = dict.fromkeys(more, True)
        parts = found._replace(lanes=machine_code.lanes(), nodes=s, forces=False, **more_parts)
        self.see_attitude = parts.space or parts.dead or parts.calls or parts.orbit
        self.rows, self.input_maps = tangent_size(parts), input_maps_of(body)
        self.frame = self.input_maps["axis"].T if np.any(self.input_maps["axis"] != np.eye(3)) else None
        self.offsets = column_offsets(self.rows, sizes, s)
        self.width, text = self.offsets[""], scheme.text(parts.motion)
        seeds = seeds_of(dict(sizes), called, changes) if called else np.zeros((0, 0))
        self.forward_run: Any = None  # of the places of inputs: the kernel that takes steps and linearises at once
        if is_parted:
            make = scheme.linear(parts, sizes)
            self._scratch = LANES * scratch_size(s, self.width, 6 * seeds.shape[1])
        else:
            make = linearised(text, parts, sizes, tuple(self.middles.tolist()))
            self._scratch = LANES * s * (size_of(KnownStep) + 3 * seeds.shape[1])
            if not called:
                self.forward_run = partial(forward_run, text, parts._replace(lanes=1), sizes)
        self._given: dict[str, Any] = {"rows": self.rows, "width": self.width, "make": make.address, "body": body}
        self._given |= {"factor": problem.load_scale[:1].copy(), "table": scheme.needs.table, "orbit": about}
        self._varied = None
        if called:
            functions = [term for term in called if not isinstance(term, ForceTable)]
            has_time = not wanted.isdisjoint(("time", "step"))
            self._varied = varied = DifferentiableFunctions(functions, scheme.needs.action, has_time)
            self._given |= {name: getattr(varied, name) for name in ("generalised", "action", "terms")}
            self._given |= {"sloped": sloped.address, "seeds": seeds}

    def in_frame(self, x: Array, back: bool = False) -> Array:
        """Return changes of states, (..., rows, count), in the frame of the matrices, or `back` from there."""
        if self.frame is None:
            return x
        found, B = x.copy(), self.frame if back else self.frame.T
        found[..., :3, :], found[..., 3:6, :] = B @ x[..., :3, :], B @ x[..., 3:6, :]
        return found

    def nodes(self, first: int, last: int) -> StepNodes:
        """Return the nodes of some steps."""
        k, problem = np.arange(first, last), self.problem
        times, middles = (problem.times(k), problem.times(k + 1)), self.middles
        if self._given["orbit"] is not None:  # seen from there, no time passes in a step
            middles = np.zeros(len(middles))
        return StepNodes(first, last, *times, problem.step_at(k), middles, problem.nodes(k, middles))

    def sampled_loads(self, nodes: StepNodes) -> dict[str, Any]:
        """Return what acts on the steps of these nodes, without the factor of the load."""
        systems, ends = self.problem.systems, (nodes.begin, nodes.end, nodes.sizes)
        arrays = sampled(systems, self.load, 1.0, lambda: nodes.times, lambda: ends, nodes.middles)
        found = dict(zip(WIDTHS, arrays, strict=True)) | {"sizes": nodes.sizes}
        if (spin := found["spin"]) is not None and systems.spin_factor is not None:
            found["spin"] = systems.spin_factor[0] * spin
        return found

    @property
    def is_called(self) -> bool:
        """Whether something depends on the state that no kernel knows, so that what acts depends on the states."""
        return self._varied is not None

    def require_no_error(self) -> None:
        """Raise what a function in Python has raised."""
        if self._varied is not None:
            self._varied.require_no_error()

    def chunks(
        self,
        count: int = 0,
        entries: EntriesOf = lambda nodes: (),
        is_stored: StepMask | None = None,
        back: bool = False,
    ) -> Iterator[Chunk]:
        """Yield all steps, some at a time: what acts on them, and what so many parameters do to them.

        `is_stored`: 1 for each step at whose end the state is stored, else 0.
        """
        for ends in ranged(self.problem.steps, LONGEST, back):
            nodes = self.nodes(*ends)
            yield chunk_of(self, nodes, count, entries(nodes), is_stored, back)

    def workspace(self) -> Workspace:
        """Return memory for matrices."""
        entries = self.width * self.rows * LANES
        return {"out": aligned(entries, empty=True), "workspace": aligned(self._scratch, empty=True)}

    def block(self, own: Workspace, chunk: Chunk, nodes: States | None = None, **arrays: Any) -> NDArray[np.int64]:
        """Return what kernels are called with for the steps of a chunk, given the states at all nodes, and arrays."""
        block, states = np.zeros(STEPS.size, dtype=np.int64), {} if nodes is None else chunk.states(nodes)
        pack(block, STEPS, **self._given | own | chunk.arrays | states | arrays)
        return block

    def run(self, kernel: Kernel, own: Workspace, chunk: Chunk, nodes: States, **arrays: Any) -> None:
        """Let changes go through the steps of a chunk, given the states at all nodes.

        Raises
        ------
        SimulationError
            The equations of a step are not solved again.
        """
        block = self.block(own, chunk, nodes, **arrays)
        kernel(address_of(block))
        self.require_no_error()
        if block[STEPS.failed]:
            raise unsolved_step(self.problem, chunk.first + int(block[STEPS.first]))


def unsolved_step(problem: IVP, k: int) -> SimulationError:
    """Return the error of a run whose step k has another solution than the one that is known."""
    t, h = float(problem.times(k)), problem.step_at(k)
    message = f"a step after t = {t:.12g} s has equations that are not solved again; try a smaller step"
    return SimulationError(message, int(Status.STALLED), t, h, np.nan)


Changes = list[tuple[Term, Array]]


def seeds_of(wanted: dict[str, int], called: Sequence[Term], changes: Sequence[Changes]) -> Array:
    """Return the directions in which functions of the state are differentiated, (numbers, directions)."""
    terms, offsets = [term for term in called if not isinstance(term, ForceTable)], offsets_of_directions(wanted)
    found = aligned(OF_TERMS + TERM.size * len(terms), offsets[""])
    found[STATE, range(len(STATE))] = 1.0
    if "forces" in wanted:
        found[OF_TABLE:OF_TERMS, offsets["forces"] : offsets["terms"]] = np.eye(OF_TERMS - OF_TABLE)
    for k, parts in enumerate(changes):
        for term, change in parts:
            first = OF_TERMS + TERM.size * terms.index(term)
            found[first : first + TERM.size, offsets["terms"] + k] += change
    return found


def input_maps_of(body: Array) -> dict[str, Array]:
    """Return what makes inputs in the frame of the body, and in its units, of inputs in body components."""
    B, force = body[BODY.basis : BODY.frame].reshape(3, 3), 1 / body[BODY.unit]
    dJ = np.stack([np.array([(B.T @ dJ @ B)[e] for e in ENTRIES]) for dJ in BASIS], axis=1)
    vectors = dict.fromkeys(("rate", "moving", "rotor"), force * B.T) | {"axis": B.T, "space": force * np.eye(3)}
    tensors = {"dead": force * np.kron(B.T, np.eye(3)), "damping": force * np.kron(B.T, B.T), "inertia": force * dJ}
    return vectors | tensors | {"factor": force * np.eye(1)}


def ranged(count: int, size: int, back: bool = False) -> list[tuple[int, int]]:
    """Return the borders of ranges of this size, from the last one `back`."""
    found = [(k, min(k + size, count)) for k in range(0, count, size)]
    return found[::-1] if back else found


class Chunk(NamedTuple):
    """Some steps, and what `Steps` has of what acts on them and of what parameters do to them."""

    first: int
    last: int
    arrays: dict[str, Any]
    first_stored: int  # how many states are stored before

    def states(self, nodes: States) -> dict[str, Any]:
        """Return the states at the ends of these steps, and their scale, given those at all nodes."""
        states = nodes.part(slice(self.first, self.last + 1))
        speed = float(abs(states.velocity).max()) or 1 / float(abs(self.arrays["sizes"]).min())
        ends = {"quaternions": states.quaternion, "velocities": states.velocity, "normals": states.normal}
        return ends | {"speed": np.float64(speed).view(np.int64)}


def chunk_of(
    steps: Linearised,
    nodes: StepNodes,
    count: int,
    entries: Iterable[InputDerivatives],
    is_stored: StepMask | None,
    back: bool,
) -> Chunk:
    """Lay out steps, and what so many parameters do to them, by their entries, for changes that go on, or `back`."""
    first, last, none, before = nodes.first, nodes.last, np.zeros(0, dtype=np.int64), 0
    every = [(none, none, np.zeros(0), none)]
    for entry in entries:
        one = entry.transformed(steps.input_maps.get(entry.name, ONE))
        step = np.full(len(one.value), -1) if one.step is None else one.step - first
        every.append((one.component + steps.offsets[one.name], one.parameter, one.value, step))
    listed = [np.concatenate(each) for each in zip(*every, strict=True)]
    order = np.argsort(listed[3], kind="stable") if back else np.lexsort((listed[1], listed[3]))
    columns, parameters, values, step = (each[order] for each in listed)
    begins, padded = np.searchsorted(step, np.arange(last - first + 1)), -(-count // LANES) * LANES
    arrays = {"steps": last - first, "batches": -(-(last - first) // LANES)} | steps.sampled_loads(nodes)
    arrays |= {"begins": begins, "columns": columns, "parameters": parameters, "values": values}
    if not back:
        fixed = slice(begins[0])
        used, rows = np.unique(columns[fixed], return_inverse=True)
        changes = aligned(len(used), padded)
        np.add.at(changes, (rows, parameters[fixed]), values[fixed])
        arrays |= {"padded": padded, "inputs": len(used), "used": used, "changes": changes}
    if is_stored is not None:
        arrays["is_stored"], before = is_stored[first:last], int(is_stored[:first].sum())
    return Chunk(first, last, arrays, before)

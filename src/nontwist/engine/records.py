"""What a march reads and writes, declared once: kernels take these records by name, Python packs them.

All numbers of a body are in its frame b and in its units (`body_frames`).

Beside them: the offsets of fields in a row, what is written there, and arrays in one piece of memory.
"""

from __future__ import annotations

from itertools import accumulate, pairwise
from math import prod
from types import SimpleNamespace
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..kernels.kernel import address_of
from ..kernels.memory import Doubles, Wholes, fields
from ..kernels.vectors import Matrix, Quaternion, Symmetric, Vector

SlabLayout = dict[str, tuple[slice, tuple[int, ...]]]


def layout(**sizes: int) -> Any:
    """Return the offsets, an attribute each, of so many numbers one after the other, and their `size`."""
    return SimpleNamespace(**dict(zip([*sizes, "size"], accumulate(sizes.values(), initial=0), strict=True)))


def pack(row: NDArray[np.int64], where: Any, **values: Any) -> None:
    """Write numbers, and addresses of arrays, at the offsets of these names; 0 for None."""
    for name, x in values.items():
        row[getattr(where, name)] = address_of(x) if x is None or isinstance(x, np.ndarray) else x


def side_by_side(**shapes: tuple[int, ...]) -> tuple[dict[str, Array], dict[str, int]]:
    """Return arrays of zeros that lie in one piece of memory, and their addresses; 0 for one without entries."""
    parts = slab_layout(shapes)
    memory = np.zeros(max(part.stop for part, _ in parts.values()))
    base = address_of(memory)
    found = {name: base + 8 * part.start if part.stop > part.start else 0 for name, (part, _) in parts.items()}
    return views(memory, parts), found


def separate_arrays(**shapes: tuple[int, ...]) -> tuple[dict[str, Array], dict[str, int]]:
    """Return arrays of zeros, so that each is freed where it is no longer used, and their addresses."""
    arrays = {name: np.zeros(shape) for name, shape in shapes.items()}
    return arrays, {name: address_of(array) if array.size else 0 for name, array in arrays.items()}


def slab_layout(shapes: dict[str, tuple[int, ...]]) -> SlabLayout:
    """Return where arrays of these shapes lie in a slab."""
    ends = pairwise([0, *accumulate(map(prod, shapes.values()))])
    return {name: (slice(*end), shape) for (name, shape), end in zip(shapes.items(), ends, strict=True)}


def views(memory: Array, parts: SlabLayout) -> dict[str, Array]:
    """Return the arrays of a slab in its memory, or in a copy of it."""
    return {name: memory[part].reshape(shape) for name, (part, shape) in parts.items()}


QUANTITIES = 12  # K, V, K + V - A, π (3), Π (3), ψ', e·π at nodes; -μ over steps
NODAL = QUANTITIES - 1
FORCES = 18  # numbers of director forces at a node: in space, along the directors
Quantities = Annotated[tuple[Any, ...], QUANTITIES]


def offsets_of(record: Any) -> Any:
    """Return the offsets of the fields of a record, an attribute each, and its `size`."""
    return layout(**{name: field.size for name, field in fields(record).items()})


class Body(NamedTuple):
    """A body in its frame b and in its units."""

    k: Vector  # 1/J_i, 0 in a constrained direction
    off: Annotated[tuple[Any, ...], 2]  # J31, J32
    free: float  # 1 or, where the third direction is constrained, 0
    E: Vector  # E_ii
    basis: Matrix  # the frame as columns in body components, one after the other
    frame: Quaternion
    dead: Matrix  # dead forces, rows
    damping: Matrix
    axis: Vector  # n, E3 where there is none
    vertical: Vector  # e
    dissipation: Annotated[tuple[Any, ...], 2]  # of the orders 1 and 2
    spin: float  # factor of a prescribed one
    unit: float  # what moments are multiplied by at the end

    @property
    def moments(self) -> Vector:
        """J_ii."""
        e0, e1, e2 = self.E
        return Vector(e1 + e2, e2 + e0, e0 + e1)

    @property
    def inertia(self) -> Matrix:
        """J."""
        (j0, j1, j2), (b0, b1), c = self.moments, self.off, self.coupling
        j01 = 0.0 if c is None else c
        return Matrix((j0, j01, b0), (j01, j1, b1), (b0, b1, j2))

    @property
    def euler_inertia(self) -> Matrix:
        """E."""
        (e0, e1, e2), (b0, b1), c = self.E, self.off, self.coupling
        e01 = 0.0 if c is None else -c
        return Matrix((e0, e01, -b0), (e01, e1, -b1), (-b0, -b1, e2))

    @property
    def coupling(self) -> Any:
        """J12, which is 0 and may have derivatives; None where it has none (`linearised`)."""
        return None

    def momentum_of(self, W: Vector) -> Vector:
        """Return the momentum of a velocity; in a constrained direction without what the others give."""
        return self.moments * W

    def velocity_of(self, P: Vector) -> Vector:
        """Return the velocity of a momentum."""
        return self.k * P


class State(NamedTuple):
    """What a march carries from step to step."""

    p: Quaternion  # attitude
    s: Vector  # momentum, or W
    compensation: Vector  # what s was rounded by
    c: Quaternion  # what p was rounded by
    auxiliary: Annotated[tuple[Any, ...], 9]  # N and zeros; rates for first guesses; or of the scheme


class Sums(NamedTuple):
    """Running sums over the present interval between stored states."""

    lam: Symmetric
    mu: float
    moment: Vector  # in space
    dead: Vector  # moment of dead forces on constrained bodies, in space
    work: float
    velocity_integral: Vector  # ∫ W dt
    velocity_moment: Vector  # ∫ t W dt, t the time of the caller
    twist: float
    iterations: float


class Observed(NamedTuple):
    """The quantities observed at the first node, least, greatest, integrals; the work of the load since the start."""

    first: Quantities
    least: Quantities
    most: Quantities
    integral: Quantities
    work: float


class MemberFailure(NamedTuple):
    """Why a member cannot go on, 0: it can; at which step; what is left of its equations; how far it turns."""

    status: float
    step: float
    residual: float
    turn: float


class Called(NamedTuple):
    """One of the functions whose sum acts, each times a factor."""

    function: int
    factor: float
    states: int  # how many internal states it has


class StateCall(NamedTuple):
    """What functions of the state are called with, and what they give (`generalised`)."""

    directors: Matrix
    w: Vector
    c_moment: Vector  # moment of a C function
    t: float
    half: Vector  # half turn of the step in the body
    action: int
    terms: int
    node: int  # address of the forces of the node
    load: Vector  # moments of the load and of potentials
    of_potentials: Vector
    rest: Symmetric  # σ
    scratch: Annotated[tuple[Any, ...], 48]


class Found(NamedTuple):
    """What the functions of the state gave for a body: all moments, those of the load, those of potentials; σ."""

    total: Vector
    load: Vector
    of_potentials: Vector
    rest: Symmetric


class Work(NamedTuple):
    """The workspace of a member, or of members in lanes."""

    body: Body
    state: State
    sums: Sums
    observed: Observed
    now: Quantities
    velocity: Vector
    scale: float
    failure: MemberFailure
    found: Found
    state_call: StateCall
    spare: float  # so that what lies behind it begins with a line of the cache


class Block(NamedTuple):
    """What a kernel is called with: addresses, counts and flags."""

    members: int
    director: int  # 1: they carry W and N, else the momentum
    is_constrained: int  # 1: they have a constrained axis
    order: Wholes  # numbers of the members
    begin: int  # first and last of them
    end: int
    bodies: Doubles
    body_stride: int  # 0: one body for all
    scales: Doubles  # of the loads, in units of the body
    scale_stride: int
    states: Doubles
    state_size: int  # numbers of a member: `State`, what a scheme carries beside them, z and what it was rounded by
    failures: Doubles
    sums: Doubles
    totals: Doubles  # sums since the last output
    observed: Doubles
    quaternions: Doubles  # (m, k, 4) scalar last
    velocities: Doubles  # (m, k, 3)
    internals: Doubles  # (m, k, z) internal states of loads with memory, z numbers
    normals: Doubles  # (m, k, 6)
    intervals: Doubles  # (m, k - 1, `Sums`)
    output_count: int  # k, how many states are stored
    stored: Wholes  # nodes at which states are stored
    done: int  # how many are
    first: int  # number of the first step
    steps: int
    unloaded_from: int  # the step from which on no moment but that of dead forces acts; none of this call: its last
    loaded_from: int  # the step from which on one acts again, or the march ends
    writes_end: int  # 1: write the state at the end as that of the node `done` + 1, though it is not one
    fractions: Doubles  # of a step, one for each substep
    table: Doubles  # coefficients of the scheme
    times: Doubles  # of the nodes
    moving: Doubles  # (nodes, 3) moments along the frame
    space: Doubles  # (nodes, 3) in space
    rotor: Doubles  # (nodes, 6) momentum of the rotors and its rate
    spin: Doubles  # (nodes,) change of the prescribed spin in the step
    functions: Doubles  # how many moments of the state there are, and each as `Called`
    responses: Doubles  # the same of what loads with memory give
    internal: int  # how many internal states they have
    internal_scales: Doubles  # of these
    forces: int  # address of (nodes, 18) on the directors: in space, along them; 0: none
    generalised: int  # address of what makes moments of director forces and potentials
    terms: int  # address of two numbers and the potentials
    action: int  # what it makes (`generalised`)
    orbit: Doubles  # rate and axis of a frame that `gauss` sees the body from
    step: Doubles  # the step and the time unit
    lengths: Doubles  # (k - 1,) of the stored intervals
    workspace: int
    # A list of calls (`workspace`).
    kernel: int  # addresses of what marches and of what marches to an output, unobserved
    side: int
    calls: int  # how many
    rows: Doubles  # (calls,) of `Call`
    rates: Doubles  # (calls,) 1 over the length of the interval that ends there
    scratch: Doubles  # for the states of members at the beginning of a step
    guesses: int  # where the numbers that first guesses are made of begin


# Where their fields lie, for what is packed in Python.
BODY, STATE, SUMS, OBSERVED, FAILURE, WORK, BLOCK, CALLED = map(
    offsets_of, (Body, State, Sums, Observed, MemberFailure, Work, Block, Called)
)


class Parts(NamedTuple):
    """What a march is made for: what is not there is not in the code."""

    lanes: int = 1
    nodes: int = 1  # of the load in a step
    motion: str = ""  # the equations that a scheme takes, where it has several
    is_director_scheme: bool = False  # carries W and N, else the momentum
    is_constrained: bool = False
    dissipates: bool = False
    moving: bool = False  # moments along the frame
    space: bool = False  # moments in space
    damping: bool = False
    dead: bool = False
    rotor: bool = False
    integrates_velocity: bool = False  # whether W and t W are: motors of wheels do work
    spin: bool = False  # one that changes
    function: bool = False
    memory: int = 0  # internal states of loads with memory
    generalised: bool = False
    forces: bool = False  # tables of director forces
    is_exact: bool = False
    orbit: bool = False  # `gauss` sees the body from there
    skips_unloaded: bool = False  # moves exactly over steps without moments
    reports: bool = False  # means and sums over intervals
    observes: bool = False

    def velocity(self, body: Body, s: Vector) -> Vector:
        """Return W of a state of the march."""
        return s if self.is_director_scheme else body.velocity_of(s)

    @property
    def is_along_frame(self) -> bool:
        """Whether nothing but dead forces and moments along the frame acts."""
        return not (self.space or self.damping or self.rotor or self.forces or self.calls)

    @property
    def is_explicit(self) -> bool:
        """Whether nothing is to be solved."""
        return self.motion == "explicit"

    @property
    def acts(self) -> bool:
        """Whether anything acts, or the body is moved by steps all the same."""
        return not self.skips_unloaded or self.moving or self.space or self.damping or self.dead or self.calls

    @property
    def calls(self) -> bool:
        """Whether functions of the state are called."""
        return self.function or self.generalised or self.memory > 0

    @property
    def is_timed(self) -> bool:
        """Whether times of nodes are taken."""
        return self.calls or self.integrates_velocity

    @property
    def memory_size(self) -> int:
        """Numbers behind the workspace: z, what it was rounded by, its change in a step; lines of the cache."""
        return -(-3 * self.memory // 8) * 8

    @property
    def needs_means(self) -> bool:
        """Whether a step returns its means, for sums over intervals or for what is observed."""
        return self.reports or self.observes

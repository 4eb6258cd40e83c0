"""The variables of runs and ensembles: dimensions, units, names, and how they follow from the states.

One code for one body and for many, in plain sums over components: a variable of a member of an ensemble has the bits of
the same variable of a single run. With R = Λ and ``d_i' = R (W × e_i + N e_i)``, N the symmetric part of the director
velocities in the body that the energy-momentum scheme alone has (zero elsewhere), and E the Euler inertia:

    w = R W,    Π = J W + z,    π = R Π,    z = Σ e_i × (E N)_i,
    K = ½ W·J W + W·z + ½ Σ (E N)_i·N_i,    V = -Σ f^i·d_i + potentials of the load,    ψ' = n·W,

and π + R Σ h a with the rotors of the load.

Other modules add variables of their own to `OBSERVABLES`.

They are (eq-dir-momenta, eq-director-K) for ``π^i = Σ_j E_ij d_j'``, as ``Σ_ij E_ij (W × e_i)·(W × e_j) = W·J W``.

Observables of directors and their velocities, as the paper defines them: what validation and tests compare with.

Those of runs follow from Λ, W and N in `variables`. Arrays may have leading axes. Definitions (eq-dir-momenta,
eq-director-K): ``π^i = Σ_j E_ij d_j'``, ``π = Σ d_i × π^i``, ``Π_i = d_i·π`` (eq-pi-convected),
``K = 1/2 Σ d_i'·π^i``, and ``w = 1/2 Σ d_i × d_i'``. They hold for every velocity; on tangent ones (eq-tq),
``d_i' = w × d_i`` (eq-omegas), they are Λ J W (eq-momenta), J W and W·JW/2 (eq-kinetic-density). The energy-momentum
scheme leaves the tangent space under load.
"""

from __future__ import annotations

from collections import UserDict
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array, Dataset, axial, dot
from ..geometry.attitudes import PLACES, States, director_velocities, entries
from ..geometry.values import among, as_list, nearest, require_among, short_repr
from ..loads import Load
from ..loads.friction import ROUND_OFF
from ..loads.memory_terms import recorded_wheels
from ..models.stack import SystemStack, stacked
from ..models.system import DirectorSystem

PAIRS = [(i, j) for i in range(3) for j in range(i + 1)]


def angular_velocity(q: Array, v: Array) -> Array:
    """Return the spatial angular velocity w, (..., 3), rad/s."""
    return _moment(q, v) / 2


def spatial_momentum(q: Array, v: Array, E: Array) -> Array:
    """Return the spatial angular momentum π, (..., 3), kg m² s⁻¹."""
    return _moment(q, E @ v)


def material(q: Array, a: Array) -> Array:
    """Return the components ``d_i·a`` of a spatial vector in the body, (..., 3)."""
    return (q @ a[..., None])[..., 0]


def kinetic_energy(v: Array, E: Array) -> Array:
    """Return the kinetic energy K = 1/2 <v, E v> (eq-director-K), (...), J."""
    return np.sum(v * (E @ v), axis=(-2, -1)) / 2


def potential_energy(q: Array, system: DirectorSystem) -> Array:
    """Return the potential V = -Σ f^i·d_i of the dead forces, (...), J."""
    return -np.sum(q * system.dead_force, axis=(-2, -1))


def orthonormality_defect(q: Array) -> Array:
    """Return the largest entry of ``|q qᵀ - I|``, (...)."""
    x, y, z = np.moveaxis(q, (-1, -2), (0, 1))
    products = ((i, j, x[i] * x[j] + y[i] * y[j] + z[i] * z[j]) for i, j in PAIRS)
    return np.maximum.reduce([abs(product - (i == j)) for i, j, product in products])


def _moment(q: Array, p: Array) -> Array:
    """Return Σ d_i × p_i, (..., 3), from the skew part of qᵀ p: much faster than cross products."""
    return axial((np.swapaxes(q, -1, -2) @ p).mT)


ONE = np.ones(1)
About = tuple[tuple[str, ...], str, str, str]  # the dims of a variable, its units, its name in words, its symbol
_NODE, _VECTOR, _BODY, _MID = ("time",), ("time", "axis"), ("time", "director"), ("midtime",)
VARIABLES: dict[str, About] = {
    "directors": (("time", "director", "axis"), "1", "directors", "d_i"),
    "director_velocities": (("time", "director", "axis"), "s-1", "director velocities", "d_i'"),
    "quaternion": (("time", "quat"), "1", "unit quaternion of Λ, scalar last", "p"),
    "angular_velocity": (_VECTOR, "rad s-1", "spatial angular velocity", "w"),
    "spatial_momentum": (_VECTOR, "kg m2 s-1", "spatial angular momentum", "π"),
    "material_angular_velocity": (_BODY, "rad s-1", "material angular velocity", "W"),
    "material_momentum": (_BODY, "kg m2 s-1", "material angular momentum", "Π"),
    "kinetic_energy": (_NODE, "J", "kinetic energy", "K"),
    "potential_energy": (_NODE, "J", "potential energy of dead forces and potentials", "V"),
    "twist_rate": (_NODE, "rad s-1", "twist rate about the body axis", "ψ'"),
    "orthonormality_defect": (_NODE, "1", "largest entry of |q qᵀ - I|", "δ"),
    "moment": (("midtime", "axis"), "N m", "mean moment of the load", "m"),
    "multipliers": (("midtime", "constraint"), "N m", "mean Lagrange multipliers", "λ, μ"),
    "reaction_moment": (_MID, "N m", "mean moment of the constraint on the body about its axis", "-μ"),
    "spatial_reaction_moment": (("midtime", "axis"), "N m", "mean moment of the constraint on the body", "-μ Λn"),
    "mean_twist_rate": (_MID, "rad s-1", "twist over the interval by its length", "Δψ/Δt"),
    "load_work": (_MID, "J", "work of the load over the interval", "A"),
    "newton_iterations": (_MID, "1", "largest number of Newton iterations of a step", "n"),
    "t_events": (("event",), "s", "time of the event", "t_e"),
    "event_quaternion": (("event", "quat"), "1", "unit quaternion of Λ at the event, scalar last", "p_e"),
    "event_material_angular_velocity": (("event", "director"), "rad s-1", "W at the event", "W_e"),
}
ROTORS: dict[str, About] = {  # of runs whose loads have rotors; elsewhere 0, and π
    "rotor_momentum": (_BODY, "kg m2 s-1", "momentum of the rotors relative to the body, material", "Σ h a"),
    "total_momentum": (_VECTOR, "kg m2 s-1", "spatial angular momentum of body and rotors", "π + Λ Σ h a"),
}
DERIVATIVES: dict[str, About] = {  # of `sensitivities`
    "d_rotation": (
        ("time", "axis", "parameter"),
        "rad",
        "change of the attitude, as a rotation vector in the body, per unit of the parameter",
        "δ",
    ),
    "d_material_angular_velocity": (
        ("time", "director", "parameter"),
        "rad s-1",
        "change of the material angular velocity per unit of the parameter",
        "dW",
    ),
}
NODES = tuple(name for name, (dims, *_) in VARIABLES.items() if dims[0] == "time")
WHEELS: dict[str, About] = {  # of runs whose loads have wheels
    "wheel_momentum": (("time", "wheel"), "kg m2 s-1", "axial momentum of the wheel in space", "h"),
    "wheel_speed": (("time", "wheel"), "rad s-1", "speed of the wheel relative to the body", "Ω"),
    "wheel_work": (("time", "wheel"), "J", "work of the motor since the start", "A"),
    "wheel_loss": (("time", "wheel"), "J", "energy that friction has taken since the start", "D"),
    "total_kinetic_energy": (_NODE, "J", "kinetic energy of body and wheels", "T"),
}
LOADED: dict[str, About] = {  # of runs under dry friction, and of those whose loads have memory
    "sticking": (_NODE, "1", "number of dry frictions whose rates are zero", "s"),
    "dissipated_energy": (_MID, "J", "energy that dry friction takes over the interval", "D"),
    "internal_state": (("time", "internal"), "1", "internal states of the loads with memory", "z"),
}
MEMBERS: dict[str, About] = {  # of ensembles whose members differ in them
    "euler_inertia": (("row", "column"), "kg m2", "Euler inertia", "E"),
    "constrained_axis": (("director",), "1", "constrained body axis", "n"),
    "dead_force": (("director", "axis"), "N m", "dead forces on the directors", "f^i"),
    "spin": ((), "rad s-1", "factor of the prescribed spin", "c"),
    "load_scale": ((), "1", "factor of the load", "c"),
    "wheel_torque": (("wheel",), "N m", "torque of the motor beside that of the load", "τ"),
}
VARIABLES |= ROTORS | WHEELS | LOADED | DERIVATIVES | MEMBERS


@dataclass(frozen=True)
class Observable:
    """A variable of states that another module adds: a function of the variables of the package.

    Attributes
    ----------
    function : callable
        Of an object whose attributes are the variables of states by name, such as ``state.directors``, with any leading
        axes; returns an array with these axes, and behind them those of `dims`.
    units, long_name, symbol : str
        In CF conventions, as ``"rad s-1"``; in words; as in formulas.
    dims : tuple of "axis", "director", "quat"
        Of the value; none for a number.
    """

    function: Callable[[Any], Any]
    units: str
    long_name: str
    symbol: str
    dims: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for dim in self.dims:
            require_among(dim, "each of the dims of an observable", tuple(SIZES))

    def values(self, name: str, state: Any, axes: tuple[int, ...]) -> Array:
        """Return the values for states with these leading axes."""
        found: Array = np.asarray(self.function(state), dtype=np.float64)
        if found.shape != (shape := (*axes, *(SIZES[dim] for dim in self.dims))):
            raise ValueError(
                f"the observable {name!r} returns an array of shape {found.shape} for states that need {shape}: index "
                "from the end, as state.directors[..., 2, 2], or give its dims"
            )
        return found


class Observables(UserDict[str, Observable]):
    """Observables by name: ``OBSERVABLES[name] = Observable(...)``; ValueError for a name that the package uses."""

    def __setitem__(self, name: str, observable: Observable) -> None:
        if name in VARIABLES or not name.isidentifier():
            what = "is a variable of the package" if name in VARIABLES else "is not a name of Python"
            raise ValueError(f"{name!r} {what}: give the observable another name")
        super().__setitem__(name, observable)


OBSERVABLES = Observables()
"""The observables that other modules have added."""


def about(name: str) -> About:
    """Return the dims of a variable, its units, its name in words and its symbol."""
    if name in VARIABLES:
        return VARIABLES[name]
    own = OBSERVABLES[name]
    return ("time", *own.dims), own.units, own.long_name, own.symbol


def nodal() -> tuple[str, ...]:
    """Return the names of the variables of states that every run has."""
    return (*NODES, *OBSERVABLES)


def require_no_wheels(names: Iterable[str]) -> None:
    """Raise a ValueError where one of the variables is that of wheels."""
    if absent := [name for name in names if WHEELS.get(name, ((),))[0][1:] == ("wheel",)]:
        raise ValueError(f"there is no variable {absent[0]!r}, as the load has no wheels")


EVENTS = tuple(name for name, (dims, *_) in VARIABLES.items() if dims[:1] == ("event",))
Described = tuple[tuple[str, ...], Any, dict[str, Any]]  # the dims of a variable, its array, its attributes
STATE = ("quaternion", "material_angular_velocity")
COORDINATES: dict[str, list[Any]] = {"director": [1, 2, 3], "axis": ["x", "y", "z"], "quat": ["x", "y", "z", "w"]}
SIZES = {name: len(labels) for name, labels in COORDINATES.items()}
TIMES = {
    "time": {"units": "s", "long_name": "time", "symbol": "t"},
    "midtime": {"units": "s", "long_name": "middle of the interval", "symbol": "t_m"},
}
BESIDE = {"event_name", "parameter_unit", "line"}  # coordinates that are no dims


def described(variables: dict[str, Array], first: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return named arrays as variables of a dataset, with the dims `first` in front of their own."""
    found = {}
    for name, array in variables.items():
        dims, units, long_name, symbol = about(name)
        found[name] = ((*first, *dims), array, {"units": units, "long_name": long_name, "symbol": symbol})
    return found


def labelled(variables: Mapping[str, Described], **labels: Any) -> dict[str, Described]:
    """Return variables of a dataset, and those of the labels of their dims; times are in s.

    Labels of dims that no variable has are left out, those that all runs share are added.
    """
    used = {dim for dims, *_ in variables.values() for dim in dims}
    along = {**labels, **COORDINATES}
    return {**variables, **{dim: ((dim,), along[dim], TIMES.get(dim, {})) for dim in along if dim in used}}


def assembled(variables: Mapping[str, Described], record: dict[str, Any], beside: Set[str] = BESIDE) -> Dataset:
    """Return a dataset of variables; those of the labels of a dim, and those `beside` them, are its coordinates.

    They are taken as they are: xarray would copy and compare them one by one, find out their indexes, and import Dask,
    in a third of a second, to ask whether it made an array.
    """
    import xarray

    own, along, indexes = dict[str, Any](), dict[str, Any](), dict[str, Any]()
    for name, (dims, array, attributes) in variables.items():
        if dims == (name,):
            indexes[name], variable = _words(name, *array) if isinstance(array, list) else _indexed(name, array)
            along[name] = variable.copy(deep=False)
            along[name].attrs = attributes
        else:
            (along if name in beside else own)[name] = xarray.Variable(dims, array, attributes, fastpath=True)
    return xarray.Dataset._construct_direct(own | along, set(along), attrs=record, indexes=indexes)


@lru_cache(maxsize=32)  # parameters may be thousands
def _words(name: str, *labels: Any) -> tuple[Any, Any]:
    return _indexed(name, labels)


def _indexed(name: str, labels: Any) -> tuple[Any, Any]:
    """Return the index of a coordinate and its variable."""
    import pandas
    from xarray.indexes import PandasIndex

    index = PandasIndex(pandas.Index(np.asarray(labels)), name, coord_dtype=getattr(labels, "dtype", None))
    return index, index.create_variables()[name]


def names_of(variables: str | Iterable[str], whose: str, hint: str = "") -> tuple[str, ...]:
    """Return the names of variables of states in the order of a run; ValueError where one is unknown.

    `hint` is added for variables of intervals.
    """
    known = (*NODES, *ROTORS, *WHEELS, *OBSERVABLES)
    if isinstance(variables, str):
        names: Iterable[str] = nodal() if variables == "all" else (variables,)
    else:
        names = as_list(variables, "variables")
    for name in names:
        if not among(name, known):
            more = hint if among(name, VARIABLES) else ""
            raise ValueError(f"{whose} has no variable {short_repr(name)}{more}; available: 'all', {', '.join(known)}")
    return tuple(name for name in known if name in names)


class Wheels(NamedTuple):
    """The wheels of a load (`loads.memory_terms`): what gives their states."""

    axes: Array  # (k, 3)
    inertia: Array  # (k,)
    columns: NDArray[np.int64]  # (k,) of h among the internal states
    have_motors: NDArray[np.bool_]  # (k,) whether their works are internal states
    have_losses: NDArray[np.bool_]  # (k,) whether what friction takes is
    are_dry: NDArray[np.bool_]  # (k,) whether they may stand, at a speed of round-off

    @classmethod
    def of(cls, records: Sequence[Mapping[str, Any]]) -> Wheels | None:
        """Return the wheels of the load of these records, None where there are none."""
        found = recorded_wheels(records)
        return cls(*map(np.array, zip(*found, strict=True))) if found else None

    @property
    def euler_inertia(self) -> Array:
        """What the wheels, locked, give to E, (3, 3), kg m²."""
        J = np.einsum("k,ki,kj->ij", self.inertia, self.axes, self.axes)
        return np.trace(J) / 2 * np.eye(3) - J

    def states(self, velocity: Array, internal: Array) -> tuple[dict[str, Array], Array, Array]:
        """Return their variables, Σ I Ω n, (m, k, 3), and ``Σ I Ω (n·W + Ω/2)``, (m, k)."""
        h, axial = internal[..., self.columns], dot(velocity[..., None, :], self.axes)
        turning = h / self.inertia
        speed = turning - axial
        speed = np.where(self.are_dry & (abs(speed) <= ROUND_OFF * (abs(turning) + abs(axial))), 0.0, speed)
        work, loss = (
            np.where(have, internal[..., self.columns + k * have], 0.0)
            for k, have in ((1, self.have_motors), (2, self.have_losses))
        )
        energy = (self.inertia * speed * (axial + speed / 2)).sum(axis=-1)
        found = {"wheel_momentum": h, "wheel_speed": speed, "wheel_work": work, "wheel_loss": loss}
        return found, ((self.inertia * speed)[..., None] * self.axes).sum(axis=-2), energy


class Acting(NamedTuple):
    """What acts on states at some times: loads with its potentials and its rotors, its wheels, its factor by member."""

    potentials: Load
    rotors: Load
    wheels: Wheels | None
    times: Array  # (k,)
    scale: Array = ONE  # (m,) or (1,)

    @classmethod
    def of(cls, load: Load, times: Array, scale: Array = ONE) -> Acting:
        """Return what of a load acts at these times."""
        return cls(load, load, Wheels.of(load.description), times, scale)


def observables(names: Iterable[str], systems: SystemStack, states: States, acting: Acting) -> dict[str, Array]:
    """Return variables of stored states, (m, k, ...); directors of the integrator itself where it has them."""
    names, (p, W, N, own_directors), wheels = tuple(names), states[:4], acting.wheels
    made: dict[str, Callable[[], Array]] = {"quaternion": lambda: p, "material_angular_velocity": lambda: W}
    if set(names) <= set(made):
        return {name: made[name]() for name in names}
    E, J, dead = systems.euler_inertia, systems.convected_inertia, systems.dead_force
    R, w = entries(p), W.transpose(2, 0, 1).copy()
    q = R.transpose(2, 3, 1, 0)
    own = q if own_directors is None else own_directors[:, :, 0]
    Pi = _times(J.transpose(1, 2, 0)[..., None], w)
    K = _dot(w, Pi) / 2
    if wheels is not None:  # which do not change their shape
        E = E - wheels.euler_inertia
    if N is not None:
        z, normal_energy = _of_normal(E, w, N)
        Pi, K = Pi + np.array(z), K + normal_energy
    n = np.array([[0.0, 0.0, 1.0]]) if systems.axis is None else systems.axis
    h = np.zeros(W.shape)
    if acting.rotors.rotors:
        h += acting.scale[:, None, None] * acting.rotors.rotor_momentum(acting.times)
    of_wheels, T = dict[str, Array](), K
    if wheels is not None and states.internal is not None:
        of_wheels, momentum, energy = wheels.states(W, states.internal)
        h, T = h + momentum, K + energy
    else:
        require_no_wheels(names)

    def potential_energy() -> Array:
        x, y, z = _dot(dead.transpose(2, 1, 0)[..., None], R)
        V = -(x + y + z)
        if held := acting.potentials.potentials:
            V = V + acting.scale[:, None] * sum(term.energy(q, acting.times) for term in held)
        return V

    made |= {
        "directors": lambda: np.ascontiguousarray(own),
        "director_velocities": lambda: (
            director_velocities(q, W, N) if own_directors is None else own_directors[:, :, 1]
        ),
        "angular_velocity": lambda: _last(_times(R, w)),
        "spatial_momentum": lambda: _last(_times(R, Pi)),
        "material_momentum": lambda: _last(Pi),
        "kinetic_energy": lambda: K,
        "potential_energy": potential_energy,
        "twist_rate": lambda: _dot(n.T[:, :, None], w),
        "orthonormality_defect": lambda: orthonormality_defect(own),
        "rotor_momentum": lambda: h,
        "total_momentum": lambda: _last(_times(R, Pi + h.transpose(2, 0, 1))),
        "total_kinetic_energy": lambda: T,
    }
    made |= {name: partial(lambda array: array, array) for name, array in of_wheels.items()}
    state = _ByName(made)
    made |= {name: partial(one.values, name, state, p.shape[:2]) for name, one in OBSERVABLES.items()}
    return {name: made[name]() for name in names}


class _ByName:
    """Variables as attributes, computed where they are used."""

    def __init__(self, made: Mapping[str, Callable[[], Array]]) -> None:
        self._made = made

    def __getattr__(self, name: str) -> Array:
        if name not in self._made:
            raise AttributeError(f"there is no variable {short_repr(name)}; {nearest(name, [*self._made])}")
        return self._made[name]()


def observables_of_one(
    names: Iterable[str], system: DirectorSystem, states: States, acting: Acting
) -> dict[str, Array]:
    """Return variables of stored states of one body, (k, ...)."""
    found = observables(names, stacked(system), states.part(None), acting)
    return {name: array[0] for name, array in found.items()}


def _dot(a: Any, b: Any) -> Array:
    """Return the scalar product of vectors (3, ...)."""
    found: Array = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return found


def _times(A: Array, x: Array) -> Array:
    """Return the product of matrices (3, 3, ...) and vectors (3, ...)."""
    return A[:, 0] * x[0] + A[:, 1] * x[1] + A[:, 2] * x[2]


def _last(x: Array) -> Array:
    """Return vectors (m, k, 3) whose components were along the first axis."""
    return np.ascontiguousarray(x.transpose(1, 2, 0))


def _of_normal(E: Array, w: Array, N: Array) -> tuple[list[Array], Array]:
    """Return z and W·z + ½ Σ (E N)_i·N_i."""
    A = [[N[..., PLACES[i][j]] for j in range(3)] for i in range(3)]
    EN = [[_dot([E[:, i, k, None] for k in range(3)], [A[k][j] for k in range(3)]) for j in range(3)] for i in range(3)]
    z = [EN[1][2] - EN[2][1], EN[2][0] - EN[0][2], EN[0][1] - EN[1][0]]
    return z, _dot(w, z) + (_dot(EN[0], A[0]) + _dot(EN[1], A[1]) + _dot(EN[2], A[2])) / 2

"""The visible list of the kinds of terms, and from the record of a load in a run to words, and back to the load."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from ..geometry.arrays import as_array
from ..geometry.values import Registry, as_list, short_repr
from .friction import DryFriction
from .memory_terms import MemoryFunction, Wheel
from .potentials import ForceFunction, ForceTable, GravityGradient, PotentialFunction, Quadratic, Spring
from .terms import Damping, Function, Pulse, Record, Rotor, Sine, Table, Term, own_fields

if TYPE_CHECKING:
    from .load import Load

MADE = ("constant", "csv", "dipole")  # kinds of run files that are made of others


def unregistrable(name: str, cls: type[Term]) -> str | None:
    """Return why a class cannot be the entry `name`, and what to do; None if it can."""
    if not (isinstance(cls, type) and issubclass(cls, Term)):
        return f"LOADS[{name!r}] must be a subclass of Term, got {short_repr(cls)}"
    if not own_fields(cls):
        return f"{cls.__name__} has no field of its own: add one, and @dataclass(frozen=True, eq=False) above the class"
    if name in MADE:
        return f"LOADS[{name!r}] is a kind of run files: give the load another kind"
    first = own_fields(cls)[0]
    for other, known in LOADS.items():
        if other != name and own_fields(known)[0] == first:
            return f"{cls.__name__} and {known.__name__} both begin with the field {first!r}: rename that of your class"
    return None


LOADS: Registry[type[Term]] = Registry({}, unregistrable, "give the load another kind")
LOADS.update(
    {
        "pulse": Pulse,
        "sine": Sine,
        "table": Table,
        "function": Function,
        "damping": Damping,
        "rotor": Rotor,
        "dry_friction": DryFriction,
        "wheel": Wheel,
        "memory": MemoryFunction,
        "director_forces": ForceTable,
        "function of director forces": ForceFunction,
        "potential": Quadratic,
        "spring": Spring,
        "gravity_gradient": GravityGradient,
        "function of a potential": PotentialFunction,
    }
)
# Fields of a record that name a function.
FUNCTIONS = ("function", "director_forces", "potential", "memory", "friction", "motor")


def class_of(record: Record) -> type[Term] | str:
    """Return the class whose first field a record begins with; the name of this field where there is none."""
    name = next(key for key in [*record, ""] if key not in ("kind", "scale"))
    return next((cls for cls in LOADS.values() if own_fields(cls)[0] == name), name)


def load_in_words(records: Iterable[Record]) -> str:
    """Return the terms of a load in words, from their records; of a kind that another package adds, its name."""
    found = [(class_of(record), record) for record in records]
    words = [f"{cls} (its module is not imported)" if isinstance(cls, str) else cls.words(one) for cls, one in found]
    return "; ".join(words) or "none"


def load_of(records: Iterable[Record]) -> Load:
    """Return the load that `Load.description` has recorded.

    Raises
    ------
    ValueError
        A term is a function, which a record names and does not hold; or the record is damaged, or of a class whose
        module is not imported.
    """
    from .load import Load

    found = list[Term]()
    for record in records:
        if function := next((record[key] for key in FUNCTIONS if key in record), None):
            raise ValueError(
                f"the load of the run holds the function {function}, which is not stored in the dataset; pass load="
            )
        if isinstance(cls := class_of(record), str):
            raise ValueError(f"the load of the run holds {cls}, whose module is not imported; import it, or pass load=")
        try:
            found.append(cls.of_record(record).scaled(float(record["scale"])))
        except (KeyError, TypeError) as error:
            raise ValueError(f"the record of the load is damaged: {error}") from error
    return Load(tuple(found))


def is_rotor(record: Record) -> bool:
    """Whether a term of this record is a rotor or a wheel, which move momentum within the body alone."""
    return "rotor" in record or "wheel" in record


def rotors_of(records: Iterable[Record]) -> Load:
    """Return the rotors of the load that `Load.description` has recorded."""
    return load_of(record for record in records if "rotor" in record)


def made(cls: Callable[..., Term], *given: Any, **more: Any) -> Load:
    """Return a term as a load; its fields check what a caller has given."""
    return cls(*given, **more).load


def of_function(
    cls: Callable[..., Term], *given: Any, breakpoints: Iterable[float] = (), compiled: bool = False
) -> Load:
    """Return a term that is a function as a load, compiled now where that is asked for: it raises if that fails."""
    times = tuple(as_array(as_list(breakpoints, "breakpoints"), "breakpoints", (None,)).tolist())
    term = cls(*given, breakpoints=times, compiled=compiled)
    if compiled:
        _ = term.c_function
    return term.load

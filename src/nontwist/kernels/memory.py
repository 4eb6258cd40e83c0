"""Memory that texts read and write: arrays, addresses, and records declared once.

A record is a `NamedTuple` whose fields are numbers: ``float``, ``int`` (64 bits), an address of either (`Doubles`,
`Wholes`), `Vector`, `Matrix`, `Quaternion`, `Symmetric`, ``Annotated[tuple, n]``, or records. Its places follow from
that, each number in 8 bytes. A `View` reads and writes its fields by name, for one body or for bodies in lanes.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from functools import lru_cache, reduce
from operator import mul
from typing import Annotated, Any, NamedTuple, get_args, get_origin, get_type_hints

import numpy as np

from .control import loop
from .elements import Element, Traced, Whole, llvm_type
from .machine_code import TraceError, tracer, width, writer
from .vectors import Matrix, Vector


class Pointer:
    """Memory of a traced text, where it has a shape an array: ``a[i, j]``, ``a[i]`` what lies under the first index."""

    def __init__(self, name: Any, is_whole: bool = False, shape: tuple[Any, ...] = ()) -> None:
        self.name, self.is_whole, self.shape = name, is_whole, shape
        self._kind: type[Traced] = Whole if is_whole else Element

    def __len__(self) -> int:
        raise TraceError("the length of an array is not known yet: use a.shape[0]")

    def __iter__(self) -> Iterator[Any]:
        raise TraceError("the length of an array is not known yet: use a[0], a[1] or `for i in loop(a.shape[0])`")

    def __getitem__(self, indices: Any) -> Any:
        place, left = self._place(indices)
        return Pointer(self.at(place), self.is_whole, left) if left else self.load(place)

    def __setitem__(self, indices: Any, x: Any) -> None:
        self.store(self._place(indices)[0], x)

    def _place(self, indices: Any) -> tuple[Any, tuple[Any, ...]]:
        """Return where a number lies, or the first one under some indices, and the shape of what lies there."""
        place, *others = indices if isinstance(indices, tuple) else (indices,)
        for index, n in zip(others, self.shape[1:], strict=False):
            place = place * n + index
        left = self.shape[1 + len(others) :]
        return reduce(mul, left, place), left

    def at(self, i: Any = 0) -> str:
        """Return the name of the place i."""
        name: str = self.name if isinstance(self.name, str) else self.name.used()
        if type(i) is int and i == 0:
            return name
        return writer().value(f"getelementptr double, ptr {name}, i64 {Whole.named(i)}")

    def shifted(self, i: Any, is_whole: bool = False) -> Pointer:
        """Return the memory that lies i numbers further, also of doubles as one of whole numbers."""
        return Pointer(self.at(i), is_whole or self.is_whole)

    def load(self, i: Any, n: int = 1) -> Any:
        """Return n numbers side by side, in lanes."""
        line = f"load {llvm_type(self._kind.scalar, n)}, ptr {self.at(i)}, align 8"
        return self._kind(writer().value(line, is_pure=False), n)

    def store(self, i: Any, x: Any, n: int = 1) -> None:
        """Write n numbers side by side."""
        value = f"{llvm_type(self._kind.scalar, n)} {self._kind.named(x, n)}"
        writer().line(f"store {value}, ptr {self.at(i)}, align 8")

    @property
    def address(self) -> Whole:
        """The address as a whole number."""
        return Whole(writer().value(f"ptrtoint ptr {self.at()} to i64"))


class Plain:
    """Memory of a text that computes."""

    def __init__(self, address: int, is_whole: bool = False, owner: Any = None) -> None:
        self.address, self.is_whole, self.owner = int(address), is_whole, owner
        kind = ctypes.c_int64 if is_whole else ctypes.c_double
        self._numbers = ctypes.cast(self.address, ctypes.POINTER(kind))

    def shifted(self, i: int, is_whole: bool = False) -> Plain:
        """Return the memory that lies i numbers further, also of doubles as one of whole numbers."""
        return Plain(self.address + 8 * int(i), is_whole or self.is_whole, self.owner)

    def load(self, i: int, n: int = 1) -> Any:
        """Return the number at a place."""
        found: Any = self._numbers[i]
        return found if self.is_whole else np.float64(found)

    def store(self, i: int, x: Any, n: int = 1) -> None:
        """Write a number."""
        self._numbers[i] = x

    __getitem__, __setitem__ = load, store


def memory_at(address: Any, is_whole: bool = False, shape: tuple[Any, ...] = ()) -> Any:
    """Return the doubles at an address, or the whole numbers."""
    if tracer() is None:
        return Plain(address, is_whole)
    return Pointer(writer().value(f"inttoptr i64 {Whole.named(address)} to ptr"), is_whole, shape)


doubles = memory_at


def scratch(count: int) -> Any:
    """Return memory on the stack for so many doubles, the same at each passage."""
    if tracer() is not None:
        return Pointer(writer().slot("double", count))
    memory = np.empty(count)
    return Plain(memory.ctypes.data, owner=memory)


def call(function: Any, *arguments: Any) -> None:
    """Call the C function at an address, which returns nothing, with numbers and memory."""
    if tracer() is not None:
        if not writer().traces(function, arguments):
            address = doubles(function).name
            given = ", ".join(f"{kind} {name}" for kind, name in map(passed, arguments))
            writer().line(f"call void {address}({given})")
        return
    values = [a.ctypes.data if isinstance(a, np.ndarray) else getattr(a, "address", a) for a in arguments]
    kinds = [ctypes.c_double if isinstance(a, float) else ctypes.c_int64 for a in values]
    ctypes.CFUNCTYPE(None, *kinds)(int(function))(*values)


def passed(a: Any) -> tuple[str, str]:
    """Return the type and the name of what is given to a function."""
    if isinstance(a, Pointer):
        return "ptr", a.at()
    if isinstance(a, Traced):
        return a.kind, a.used(a.n)
    kind = Element if isinstance(a, float) else Whole
    return kind.scalar, kind.named(a)


def load_lanes(row: Any, i: Any) -> Any:
    """Return as many numbers of a row as the kernel has lanes."""
    return row[i] if tracer() is None else row.load(i, width())


def store_lanes(row: Any, i: Any, x: Any) -> None:
    """Write as many numbers to a row as the kernel has lanes."""
    if tracer() is None:
        row[i] = x
    else:
        row.store(i, x, width())


def vector_at(row: Any, place: Any = 0) -> Vector:
    """Return three numbers that lie side by side in an array or in memory."""
    return Vector(row[place], row[place + 1], row[place + 2])


def matrix_at(rows: Any) -> Matrix:
    """Return the 3 × 3 numbers of an array."""
    return Matrix(*(tuple(rows[i, j] for j in range(3)) for i in range(3)))


def put(row: Any, numbers: Any, place: Any = 0) -> None:
    """Write numbers side by side into an array or into memory; those of tuples one after the other."""
    for k, x in enumerate(flat(numbers)):
        row[place + k] = x


def flat(x: Any) -> list[Any]:
    """Return the numbers of tuples of tuples in a row."""
    return [z for y in x for z in flat(y)] if isinstance(x, tuple) else [x]


class Doubles:
    """A field that holds the address of doubles."""


class Wholes:
    """A field that holds the address of whole numbers."""


WHOLE = (int, Doubles, Wholes)


class Field(NamedTuple):
    """Where the numbers of a field lie, and what they are."""

    offset: int
    kind: Any
    size: int


@lru_cache
def fields(record: Any) -> dict[str, Field]:
    """Return the fields of a record."""
    found, offset = {}, 0
    for name, kind in get_type_hints(record, include_extras=True).items():
        found[name] = Field(offset, kind, size_of(kind))
        offset += found[name].size
    return found


@lru_cache
def size_of(kind: Any) -> int:
    """Return how many numbers a field or a record has."""
    if get_origin(kind) is Annotated:
        return int(get_args(kind)[1])
    return sum(field.size for field in fields(kind).values()) if _is_record(kind) else int(getattr(kind, "size", 1))


def _is_record(kind: Any) -> bool:
    return hasattr(kind, "_fields")


def _composed(kind: Any, numbers: list[Any]) -> Any:
    """Return a field made of its numbers."""
    if kind is float or get_origin(kind) is Annotated:
        return numbers[0] if kind is float else tuple(numbers)
    return kind._make(zip(*[iter(numbers)] * 3, strict=True) if kind is Matrix else numbers)


class View:
    """A record in memory: ``view.field`` reads, ``view.field = ...`` writes, a field that is a record is a view.

    Number k of the record lies at ``k * stride``; `lanes` of them side by side belong to as many bodies. So a row of an
    array of records is a view with stride 1, a workspace of n bodies one with stride and lanes n.
    """

    def __init__(self, record: Any, memory: Any, lanes: int = 1, stride: int | None = None) -> None:
        stride = lanes if stride is None else stride
        self.__dict__.update(_record=record, _memory=memory, _lanes=lanes, _stride=stride, _references={})

    def _field(self, name: str) -> Field:
        if name not in fields(self._record):
            raise AttributeError(f"{self._record.__name__} has no field {name!r}")
        return fields(self._record)[name]

    def __getattr__(self, name: str) -> Any:
        field = self._field(name)
        if _is_record(field.kind):
            return View(field.kind, self._memory.shifted(field.offset * self._stride), self._lanes, self._stride)
        if field.kind in WHOLE:
            found = self._memory.shifted(field.offset * self._stride, True)[0]
            return found if field.kind is int else memory_at(found, field.kind is Wholes)
        return _composed(field.kind, [self.number(field.offset + k) for k in range(field.size)])

    def __setattr__(self, name: str, value: Any) -> None:
        field = self._field(name)
        if _is_record(field.kind):
            getattr(self, name).write(value)
        elif field.kind in WHOLE:
            if isinstance(value, np.ndarray):
                self._references[name] = value  # as long as the view lives, so does what it points to
                value = value.ctypes.data
            self._memory.shifted(field.offset * self._stride, True)[0] = getattr(value, "address", value)
        else:
            numbers = flat(value)
            if len(numbers) != field.size:
                raise TraceError(f"{name} takes {field.size} numbers, not {len(numbers)}")
            for k, x in enumerate(numbers):
                self.set_number(field.offset + k, x)

    @property
    def address(self) -> Any:
        """Where it lies."""
        return self._memory.address

    def number(self, k: Any) -> Any:
        """Return number k of the record, as it counts doubles."""
        return self._memory.load(k * self._stride, self._lanes)

    def set_number(self, k: Any, x: Any) -> None:
        """Write number k of the record."""
        self._memory.store(k * self._stride, x, self._lanes)

    def lane(self, l: Any) -> View:
        """Return the record of one of the bodies in lanes."""
        return View(self._record, self._memory.shifted(l), 1, self._stride)

    def read(self) -> Any:
        """Return the record with its numbers."""
        values = (getattr(self, name) for name in fields(self._record))
        return self._record(*(x.read() if isinstance(x, View) else x for x in values))

    def write(self, record: Any) -> None:
        """Write all fields."""
        for name, value in zip(fields(self._record), record, strict=True):
            setattr(self, name, value)

    def copy_from(self, other: View) -> None:
        """Copy all numbers of a record of the same kind, in a loop of the machine."""
        for k in loop(size_of(self._record)):
            self.set_number(k, other.number(k))


def view_in(record: Any, row: Any) -> View:
    """Return a view of the record whose numbers are a contiguous array."""
    return View(record, row if isinstance(row, Pointer) else Plain(row.ctypes.data, owner=row))


def view_of(record: Any) -> View:
    """Return a view of new memory, filled with zeros, for a record that is filled in Python."""
    memory = np.zeros(size_of(record))
    return View(record, Plain(memory.ctypes.data, owner=memory))

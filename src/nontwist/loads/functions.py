"""Functions that a user wrote: called with floats or with numbers that have derivatives, and compiled.

A text of a load calls them by `checked`, `plainly` or `differentiated`, or, while it is compiled, by
`kernels.user_functions.traced`, so that it is written once. Each takes a function, its arguments and the shape of what
it gives, and returns the numbers row by row.

Compiled functions of the state are traced, as C functions of one signature, so that no kernel is compiled again, nor
they for another factor. A C function is ``void (t, directors, angular_velocity, found)``, of a moment, of forces on the
directors or, of γ in place of the directors, of a potential and its gradient. What a function finds beside its
arguments is fixed.

C functions that a caller brings, through ctypes, SciPy or Numba, are called as they are; here their signature is
checked, as far as their maker declares it.
"""

from __future__ import annotations

import ctypes
import inspect
import pickle
from collections.abc import Callable, Sequence
from math import isfinite
from typing import TYPE_CHECKING, Any, NoReturn
from weakref import WeakValueDictionary

import numpy as np

from ..geometry.arrays import Array, as_floats
from ..kernels import machine_code
from ..kernels.dual import plain, seeded, tangent
from ..kernels.elements import Element
from ..kernels.machine_code import tracing
from ..kernels.memory import Pointer, put
from ..kernels.numpy_texts import numbers
from ..kernels.user_functions import UserTracer, traced

if TYPE_CHECKING:
    from .terms import Term

MOMENTS = 6  # numbers of the moments of a term with memory: in space, along the moving frame
Call = Callable[[Callable[..., Any], tuple[Any, ...], tuple[int, ...]], list[Any]]
REMEDY = "let it return 3 finite numbers (N m) at every time and state"
SMALLER = ", or try a smaller step"
OF_POTENTIALS = "let function return a finite number (J) and gradient its derivatives by γ (N m) for every γ"
FINITE = {(): "a finite number (N m)", (3,): "3 finite numbers (N m)", (3, 3): "3 rows of 3 finite numbers (N m)"}
GIVEN = {
    1: "the time",
    2: "the time and the speed",
    3: "the time, the directors and the angular velocity",
    4: "the time, the internal states, the directors and the angular velocity",
}


def array(x: Sequence[Any], *shape: int) -> Any:
    """Return a new array of numbers, of floats or of traced ones and those with derivatives."""
    return numbers(np.array(x)).reshape(shape or len(x))


def state(x: Sequence[Any]) -> tuple[Any, ...]:
    """Return time, directors and angular velocity from 13 numbers, the time behind the others."""
    return x[12], array(x[:9], 3, 3), array(x[9:12])


def plainly(function: Callable[..., Any], arguments: tuple[Any, ...], shape: tuple[int, ...]) -> list[Any]:
    """Call a function with numbers that have derivatives; an exception of any kind where it does not take them."""
    found = np.array(getattr(function, "py_func", function)(*arguments), dtype=object)
    if found.shape != shape:
        raise ValueError(f"it returned the shape {found.shape}")
    return found.ravel().tolist()


def differentiated(function: Callable[..., Any], arguments: tuple[Any, ...], shape: tuple[int, ...]) -> list[Any]:
    """Do as `plainly`; a ValueError where the function does not take numbers with derivatives."""
    try:
        return plainly(function, arguments, shape)
    except Exception as error:
        raise ValueError(
            f"{name_of(function)} cannot be differentiated: {error}; functions of NumPy take numbers with derivatives"
        ) from error


def checked(function: Callable[..., Any], arguments: tuple[Any, ...], shape: tuple[int, ...]) -> list[Any]:
    """Call a function with floats, and check what it returns.

    Raises
    ------
    ValueError
        It raised, or returned something else than finite numbers of the shape: where, and what to do.
    """
    function = getattr(function, "py_func", function)
    try:
        value = as_floats(function(*arguments), "what it returns")
    except Exception as error:
        raise _unsound(function, arguments, shape, error) from error
    if value.shape == shape and all(map(isfinite, found := value.ravel().tolist())):
        return found
    raise _unsound(function, arguments, shape, value)


def _unsound(
    function: Callable[..., Any], arguments: tuple[Any, ...], shape: tuple[int, ...], got: Array | Exception
) -> ValueError:
    """Return the error for a function that raised, or returned what is not asked for."""
    is_of_time, place = isinstance(arguments[0], float), _arguments_in_words(arguments, shape)
    name = "load" if is_of_time else "gradient" if shape else "potential"
    name = f"the {name} {getattr(function, '__name__', None) or repr(function)}"
    wanted = FINITE.get(shape) or f"as many finite numbers as state0, {shape[0]},"
    remedy, smaller = (REMEDY.replace(FINITE[3,], wanted), SMALLER) if is_of_time else (OF_POTENTIALS, "")
    if isinstance(got, Exception):
        if isinstance(got, TypeError) and not _takes(function, *arguments):
            remedy, smaller = f"it is called with {_given(arguments, shape)}", ""
        return ValueError(f"{name} raised {type(got).__name__} at {place}: {got}; {remedy}{smaller}")
    if got.shape != shape:
        counted = {(): "a number", (3, 3): "3 rows of 3 numbers"}.get(shape) or f"{shape[0]} numbers"
        return ValueError(f"{name} must return {counted}, at {place} it returned shape {got.shape}; {remedy}")
    return ValueError(f"{name} is not finite at {place}: {got.tolist()}; {remedy}{smaller}")


def _given(arguments: tuple[Any, ...], shape: tuple[int, ...]) -> str:
    """Return what a function is called with: one that gives a number for one number is friction, of the speed."""
    if np.ndim(arguments[0]):
        return "γ"
    return GIVEN[len(arguments)] if shape or len(arguments) > 1 else "the speed"


def _arguments_in_words(arguments: tuple[Any, ...], shape: tuple[int, ...]) -> str:
    given, first = _given(arguments, shape), arguments[0]
    if given == "γ":
        return f"γ = {first.tolist()}"
    return f"a speed of {first:.6g} rad/s" if given == "the speed" else f"t = {first:.12g} s"


def _takes(function: Callable[..., Any], *arguments: Any) -> bool:
    """Return whether a function can be called with these arguments, as far as its signature says."""
    try:
        inspect.signature(function).bind(*arguments)
    except TypeError:
        return False
    except ValueError:  # without a signature
        pass
    return True


def name_of(function: Callable[..., Any]) -> str:
    """Return what a function is called, its module first."""
    return f"{getattr(function, '__module__', '?')}.{getattr(function, '__qualname__', repr(function))}"


SIGNATURE = "void (double t, const double *directors, const double *angular_velocity, double *moment)"
TYPES = "void (double, double *, double *, double *)"
Doubles = ctypes.POINTER(ctypes.c_double)
Moment = ctypes.CFUNCTYPE(None, ctypes.c_double, Doubles, Doubles, Doubles)
FunctionPointer = Moment.__bases__[0]  # of all those of ctypes


class CFunction:
    """A C function of the `SIGNATURE`: equal to one of the same address and name, called with arrays from Python.

    Attributes
    ----------
    address : int
    """

    def __init__(self, address: int, name: str, owner: Any) -> None:
        self.address, self._owner = address, owner  # as long as the owner lives, the address holds
        self.__module__, self.__name__, self.__qualname__ = "C", name, name

    def __call__(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return the moment, (3,); the arrays are contiguous."""
        moment = np.full(3, np.nan)
        arrays = (directors, angular_velocity, moment)
        Moment(self.address)(t, *(array.ctypes.data_as(Doubles) for array in arrays))
        return moment

    def __eq__(self, other: object) -> bool:
        return isinstance(other, CFunction) and (self.address, self.__name__) == (other.address, other.__name__)

    def __hash__(self) -> int:
        return hash((self.address, self.__name__))

    def __reduce__(self) -> NoReturn:
        raise pickle.PicklingError(
            f"the load {self.__name__} is a C function, whose address is valid in this process only; load the library "
            "and call moment(...) in each process"
        )


def is_c_function(value: Any) -> bool:
    """Whether `value` is a function pointer of ctypes, a LowLevelCallable of SciPy, or a @cfunc of Numba."""
    from scipy import LowLevelCallable

    return isinstance(value, (FunctionPointer, LowLevelCallable)) or hasattr(type(value), "native_name")


def as_c_function(value: Any) -> CFunction:
    """Return what `is_c_function` accepts as a C function.

    Raises
    ------
    ValueError
        Another signature than `SIGNATURE`, user data, or a null pointer.
    """
    from scipy import LowLevelCallable

    if isinstance(value, LowLevelCallable):
        if value.user_data is not None:
            raise ValueError("function is a LowLevelCallable with user_data, which loads do not pass on; leave it out")
        source, declared = value.function, value.signature
    else:
        try:
            source = value if isinstance(value, FunctionPointer) else value.ctypes
            declared = _declared(source)
        except TypeError as error:  # Numba: a type that C lacks
            source, declared = value, f"none of C: {error}"
    if "".join(declared.replace("const", "").split()) != TYPES.replace(" ", ""):
        raise ValueError(f"function must have the C signature {SIGNATURE}; its signature is {declared}")
    address = _in_capsule(value) if isinstance(value, LowLevelCallable) else machine_code.pointer_address(source)
    if not address:
        raise ValueError("function is a null pointer; give the address of a function")
    return CFunction(address, getattr(value, "__name__", getattr(source, "__name__", "function")), value)


def _declared(pointer: Any) -> str:
    """Return the signature of a function pointer of ctypes as C writes it."""
    if pointer.argtypes is None:
        return f"{_words(pointer.restype)} (...), as its argtypes are not set"
    return f"{_words(pointer.restype)} ({', '.join(map(_words, pointer.argtypes))})"


def _words(kind: Any) -> str:
    if kind is None:
        return "void"
    target = getattr(kind, "_type_", None)
    return f"{_words(target)} *" if isinstance(target, type) else kind.__name__.removeprefix("c_")


def _in_capsule(callback: Any) -> int:
    """Return the address in a LowLevelCallable, whose first entry is a capsule for SciPy's C code."""
    capsule, api = tuple.__getitem__(callback, 0), ctypes.pythonapi
    name = ctypes.PYFUNCTYPE(ctypes.c_char_p, ctypes.py_object)(("PyCapsule_GetName", api))(capsule)
    pointer = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.py_object, ctypes.c_char_p)(("PyCapsule_GetPointer", api))
    return pointer(capsule, name) or 0


ENTRY, ARGUMENTS = "load", "double %t, ptr %directors, ptr %velocity, ptr %found"
_known: WeakValueDictionary[str, MachineFunction] = WeakValueDictionary()


class MachineFunction:
    """A C function that was traced.

    Attributes
    ----------
    address : int
    text : function
        What it was traced from: of time, two addresses, and where what is found goes.
    owners : list
        What lives as long.
    """

    def __init__(self, code: str, text: Callable[..., None], owners: list[Any]) -> None:
        self._function = machine_code.function_of(code, ENTRY, kind=Moment)
        self.address, self.text, self.owners = machine_code.pointer_address(self._function), text, owners


def term_function(term: Term) -> Any:
    """Return the C function that writes what a term gives; a ValueError where its text cannot be traced."""
    own = term.called
    return own if isinstance(own, CFunction) else _made(lambda *given: _traced(term, _numbers(term, *given)))


def slopes_function(term: Term) -> MachineFunction | None:
    """Return what writes these with their derivatives, by each argument and number of the term; of C functions None."""

    def text(*given: Any) -> list[Any]:
        x = seeded((*_numbers(term, *given), *term.numbers))
        return [y for z in _traced(term, x) for y in (plain(z), *(tangent(z, j) for j in range(len(x))))]

    return None if isinstance(term.called, CFunction) else _made(text)


def _traced(term: Term, x: tuple[Any, ...]) -> list[Any]:
    def called(function: Any, given: tuple[Any, ...], shape: tuple[int, ...]) -> list[Any]:
        if not _takes(getattr(function, "py_func", function), *given):
            what = _given(given, shape)
            raise ValueError(f"the load {_name(function)} cannot be compiled: it is called with {what}")
        return traced(function, given, shape, _name(function))

    return term.text(called, x)


def _numbers(term: Term, t: Any, first: Pointer, second: Pointer) -> tuple[Any, ...]:
    """Return all arguments: the time is the last one of a function of the state."""
    n, m = term.counts
    return (*(first[k] for k in range(n)), *(second[k] for k in range(m)), *[t][: bool(m)])


def _name(function: Any) -> str:
    """Return what a message calls a function: a text of a term by its class."""
    owner = getattr(function, "__self__", None)
    return type(owner).__name__ if hasattr(type(owner), "c_function") else getattr(function, "__name__", repr(function))


def _made(text: Callable[..., list[Any]]) -> MachineFunction:
    """Return the C function that writes the numbers that a text gives; the same code is compiled once."""
    t = UserTracer(1, machine_code.is_fused())

    def write_all(t: Any, first: Pointer, second: Pointer, found: Pointer) -> None:
        put(found, tuple(text(t, first, second)))

    with tracing(t):
        t.open(ENTRY, ARGUMENTS)
        write_all(Element("%t"), Pointer("%directors"), Pointer("%velocity"), Pointer("%found"))
        t.line("ret void")
        t.close()
    with machine_code.LOCK:
        made = _known.get(t.text)
        if made is None:
            made = _known[t.text] = MachineFunction(t.text, write_all, t.keepalive)
    return made

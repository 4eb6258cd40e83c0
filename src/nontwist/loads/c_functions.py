"""C functions that a caller brings as moments of the state, through ctypes, SciPy or Numba, as values.

A kernel calls every moment of the state by the address of a C function of the one `SIGNATURE`, the directors flat by
rows. One that is brought is called as it is; here its signature is checked, as far as its maker declares it.
"""

from __future__ import annotations

import ctypes
import pickle
from typing import Any, NoReturn

import numpy as np

from ..geometry.arrays import Array

SIGNATURE = "void (double t, const double *directors, const double *angular_velocity, double *moment)"
TYPES = "void (double, double *, double *, double *)"
Doubles = ctypes.POINTER(ctypes.c_double)
Moment = ctypes.CFUNCTYPE(None, ctypes.c_double, Doubles, Doubles, Doubles)
Pointer = Moment.__bases__[0]  # of all function pointers of ctypes


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

    return isinstance(value, (Pointer, LowLevelCallable)) or hasattr(type(value), "native_name")


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
            source = value if isinstance(value, Pointer) else value.ctypes
            declared = _declared(source)
        except TypeError as error:  # Numba: a type that C lacks
            source, declared = value, f"none of C: {error}"
    if "".join(declared.replace("const", "").split()) != TYPES.replace(" ", ""):
        raise ValueError(f"function must have the C signature {SIGNATURE}; its signature is {declared}")
    address = _in_capsule(value) if isinstance(value, LowLevelCallable) else address_of(source)
    if not address:
        raise ValueError("function is a null pointer; give the address of a function")
    return CFunction(address, getattr(value, "__name__", getattr(source, "__name__", "function")), value)


def address_of(pointer: Any) -> int:
    """Return the address that a function pointer of ctypes holds, 0 for null."""
    return ctypes.cast(pointer, ctypes.c_void_p).value or 0


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

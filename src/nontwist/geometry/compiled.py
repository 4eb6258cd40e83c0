"""The one way in which this package compiles a kernel.

A kernel consists of plain loops, scalars and tuples; it allocates nothing and returns a status where others would
raise. It declares what it is called with (`kernels.signatures`), which is how it gets on the list of kernels that are
compiled when the package is built. A run takes this machine code (`machine_code`). Where it is missing, damaged or
older than the text, Numba compiles the kernel, and keeps that on disk until the text of its module changes, or that of
a module whose kernels it calls.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cached_property, lru_cache, partial, update_wrapper
from threading import RLock, Timer
from typing import Any, TypeVar, cast, overload

from ..kernels.signatures import Signature
from . import elements, machine_code, texts

Function = TypeVar("Function", bound=Callable[..., object])
INSTALL = "pip install 'nontwist[compile]'"


class Kernel:
    """A function that is compiled, called from Python or by another kernel.

    Numba is imported where it compiles, so that kernels run without it.

    Attributes
    ----------
    signature : Signature or None
        What it is called with; None where it is told by the first call, and so compiled by Numba.
    is_kernel : bool
        Whether it is called from Python, and not just a part of others.
    unroll : bool
        Whether loops are unrolled when the package is built.
    vectorize : bool
        Whether loops are made to use vector instructions then.
    """

    def __init__(
        self,
        function: Callable[..., object],
        is_kernel: bool,
        signature: str | None = None,
        unroll: bool = True,
        vectorize: bool = False,
        **options: bool,
    ) -> None:
        update_wrapper(self, function)
        self.unroll, self.vectorize = unroll, vectorize
        self.py_func, self.is_kernel, self._options, self._lock = function, is_kernel, options, RLock()
        self.signature = None if signature is None else Signature(signature)
        self._made: Any = None
        self._part: Any = None

    @property
    def name(self) -> str:
        """The module and the name."""
        return f"{self.__module__}.{self.py_func.__name__}"

    @cached_property
    def ready(self) -> Callable[..., Any]:
        """The compiled function: machine code that was made beforehand, or by Numba now.

        Raises
        ------
        ImportError
            There is none, and Numba is not installed.
        """
        with self._lock:
            if self.signature is None or not self.is_kernel or _is_uncompiled():
                return cast(Callable[..., Any], self.compiled)
            try:
                with announced("loading compiled code", once=True):
                    function = machine_code.function(self.__module__, self.py_func.__name__)
                return function if self.signature.is_address else partial(self.signature.call, function)
            except machine_code.UnusableError as unusable:
                return self._by_numba(self.signature, str(unusable))

    def _by_numba(self, signature: Signature, reason: str) -> Callable[..., Any]:
        with announced(f"compiling the kernel {self.name}"):
            if numba_or_none() is None:
                raise ImportError(f"the machine code of {self.name} {reason}; Numba would compile it: {INSTALL}")
            _say_once("Numba", f"the machine code of {self.name} {reason}: Numba compiles what is needed")
            self.compiled.compile(signature.of_numba(numba().types))
        return cast(Callable[..., Any], self.compiled)

    def bound(self, *arguments: Any) -> Callable[[], Any]:
        """Return the compiled function with its arguments laid out once: contiguous arrays, which it keeps alive."""
        ready = self.ready
        if isinstance(ready, partial) and self.signature is not None:
            return self.signature.bound(ready.args[0], *arguments)
        return partial(ready, *arguments)

    @cached_property
    def address(self) -> int:
        """The address of the function as a C function of one address, ``void (int64_t)``.

        Raises
        ------
        ImportError
            As `ready`.
        """
        function: Any = self.ready
        if function is not self._made:
            return int(ctypes.cast(function, ctypes.c_void_p).value or 0)
        types = numba().types
        made = function.get_compile_result(types.none(types.int64))
        return int(made.library.get_pointer_to_function(made.fndesc.llvm_cfunc_wrapper_name))

    @property
    def compiled(self) -> Any:
        """The function as Numba has it."""
        with self._lock:
            if self._made is None:
                made = numba().njit(nogil=True, error_model="numpy", **self._options)(self.py_func)
                if self.is_kernel:
                    with suppress(RuntimeError, OSError, TypeError):  # no directory that Numba may write to, or no text
                        made._cache = _cache_class()(self.py_func)
                self._made = made
        return self._made

    @property
    def _numba_type_(self) -> Any:
        """What Numba sees where another kernel calls this one: a part of that kernel, see `nested`."""
        with self._lock:
            if self._part is None:
                self._part = part(self.py_func, **self._options)
        return self._part._numba_type_

    def __call__(self, *args: Any) -> Any:
        """Call the compiled function."""
        return self.ready(*args)


@overload
def kernel(
    declared: str | None = None, *, unroll: bool = True, vectorize: bool = False
) -> Callable[[Function], Function]: ...
@overload
def kernel(declared: Function) -> Function: ...
def kernel(declared: Any = None, *, unroll: bool = True, vectorize: bool = False) -> Any:
    """Compile a function that is called from Python: ``@kernel("f8[:], i8 -> f8")``, or ``@kernel`` of one address.

    Division by zero gives infinities as in NumPy. The interpreter lock is released while it runs. Without `unroll`
    loops whose lengths are known at run time alone stay as they are, which makes half as much code. With
    `vectorize` loops use vector instructions where LLVM finds that they can.
    """
    if declared is None or isinstance(declared, str):
        return partial(_declared, signature=declared, unroll=unroll, vectorize=vectorize)
    return _declared(declared, None, unroll, vectorize)


def _declared(function: Callable[..., object], signature: str | None, unroll: bool, vectorize: bool) -> Kernel:
    code = function.__code__
    if signature is None and code.co_varnames[: code.co_argcount] == ("address",):
        signature = "i8"
    return Kernel(function, is_kernel=True, signature=signature, unroll=unroll, vectorize=vectorize)


def _is_uncompiled() -> bool:
    return os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")


PATIENCE = 1.0  # s


@contextmanager
def announced(what: str, once: bool = False) -> Iterator[None]:
    """Say on stderr what is done, if it takes longer than `PATIENCE`; with `once`, only the first time."""
    timer = Timer(PATIENCE, partial(_say_once, what) if once else _say, (f"{what} ...",))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


_said = set[str]()


def _say_once(subject: str, text: str) -> None:
    if subject not in _said:
        _said.add(subject)
        _say(text)


def _say(text: str) -> None:
    with suppress(OSError, AttributeError, ValueError):  # no stderr, or one that is closed
        sys.stderr.write(f"nontwist: {text}\n")
        sys.stderr.flush()


@lru_cache
def numba_or_none() -> Any:
    """Return Numba, told how wide vectors should be, which it heeds until it has made its first function.

    SVML is off, so that transcendental functions are those of the C library everywhere.
    """
    if "numba" not in sys.modules:
        os.environ.setdefault("NUMBA_DISABLE_INTEL_SVML", "1")
    try:
        import numba
    except ImportError:
        return None
    config: Any = numba.core.config
    if config.CPU_NAME is None and config.CPU_FEATURES is None and config.ENABLE_AVX:
        config.CPU_FEATURES = machine_code.tuned(*machine_code.processor())
    elements.register()
    return numba


def numba() -> Any:
    """Return Numba.

    Raises
    ------
    ImportError
        It is not installed.
    """
    found = numba_or_none()
    if found is None:
        raise ImportError(f"Numba, which compiles, is not installed: {INSTALL}")
    return found


def part(function: Callable[..., object], **options: bool) -> Any:
    """Return a function of Numba that other compiled functions call, and Python does not; see `nested`."""
    alone = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": nested()}
    return numba().njit(nogil=True, error_model="numpy", **alone, **options)(function)


@lru_cache
def nested() -> type[Any]:
    """Return the way in which Numba compiles what kernels call: as a part of theirs.

    Left alone it optimises each function and makes machine code of it, and does so again for each that calls it. So the
    text of a kernel would be optimised as many times as its calls are deep. A part stays as it was lowered until the
    kernel is whole.
    """
    from numba.core.codegen import JITCodeLibrary
    from numba.core.compiler import Compiler

    whole: Any = JITCodeLibrary
    compiler: Any = Compiler

    class WithoutEnvironment:
        """Numba's generator of code, as a part sees it: a part holds no Python object, so it has no environment."""

        def __init__(self, codegen: Any) -> None:
            self._codegen = codegen

        def __getattr__(self, name: str) -> Any:
            return getattr(self._codegen, name)

        def set_env(self, name: str, environment: Any) -> None:
            pass

    class Part(whole):  # type: ignore[misc]
        """A module of LLVM that is optimised, and becomes machine code, within another."""

        @property
        def codegen(self) -> Any:
            return WithoutEnvironment(self._codegen)

        def _optimize_functions(self, module: Any) -> None:
            module.data_layout = self._codegen._data_layout  # else as it is, so that it knows no processor

        def finalize(self) -> None:
            self._raise_if_finalized()
            for library in dict.fromkeys(self._linking_libraries):
                self._final_module.link_in(library._get_module_for_linking(), preserve=True)
            self._finalized = True

        def get_pointer_to_function(self, name: str) -> int:
            return 0

    class Nested(compiler):  # type: ignore[misc]
        """Numba's compiler, into a part."""

        def __init__(self, typing: Any, target: Any, library: Any, *about: Any) -> None:
            super().__init__(typing, target, library or Part(target.codegen(), "part"), *about)

    return Nested


@lru_cache
def _cache_class() -> type[Any]:
    from numba.core import caching

    on_disk: Any = caching.FunctionCache

    class Cache(on_disk):  # type: ignore[misc]
        """Numba's machine code on disk. A full disk or a damaged file costs a compilation, never the run."""

        def __init__(self, function: Callable[..., object]) -> None:
            super().__init__(function)
            self._cache_file._source_stamp = texts.hash_of(texts.files(function.__module__))

        def load_overload(self, *about: Any) -> Any:
            try:
                return super().load_overload(*about)
            except Exception:
                with suppress(OSError):
                    self.flush()
                return None

        def save_overload(self, *compiled: Any) -> None:
            with suppress(OSError):
                super().save_overload(*compiled)

    return Cache


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise a KeyboardInterrupt where one strikes while Numba hands arrays back, which gives a SystemError."""
    try:
        yield
    except SystemError as error:
        cause: BaseException | None = error
        while cause is not None and not isinstance(cause, KeyboardInterrupt):
            cause = cause.__cause__ or cause.__context__
        if cause is None:
            raise
        raise KeyboardInterrupt(*cause.args) from error


def inlined(function: Function) -> Function:
    """Compile `function` into each kernel that calls it: no argument passes through memory, nothing is kept on disk."""
    return cast(Function, Kernel(function, is_kernel=False, forceinline=True))


def shared(function: Function) -> Function:
    """Compile `function` once into each kernel that calls it, not kept on disk: its arguments may be elements."""
    return cast(Function, Kernel(function, is_kernel=False))

"""The one way in which this package compiles a kernel.

A kernel consists of plain loops, scalars and tuples; it returns a status where others would raise. Its arguments are
arrays, numbers and plain tuples: a class in a signature would be named in the cache, where a later version could not
read it. Machine code is kept on disk until the text of its module changes, or that of a module whose kernels it calls.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache, update_wrapper
from hashlib import sha256
from threading import RLock
from typing import Any, TypeVar, cast

from . import elements

Function = TypeVar("Function", bound=Callable[..., object])


class Kernel:
    """A function that Numba compiles once it is called, from Python or by another kernel.

    Numba is imported then, so that modules of kernels can be imported without it.
    """

    def __init__(self, function: Callable[..., object], is_cached: bool, **options: bool) -> None:
        update_wrapper(self, function)
        self.py_func, self._is_cached, self._options, self._lock = function, is_cached, options, RLock()
        self._made: Any = None
        self._part: Any = None

    @property
    def compiled(self) -> Any:
        """The function as Numba has it."""
        with self._lock:
            if self._made is None:
                made = numba().njit(nogil=True, error_model="numpy", **self._options)(self.py_func)
                if self._is_cached:
                    with suppress(RuntimeError, OSError, TypeError):  # no directory that Numba may write to, or no text
                        made._cache = _cache_class()(self.py_func)
                self._made = made
        return self._made

    @property
    def _numba_type_(self) -> Any:
        """What Numba sees where another kernel calls this one: a part of that kernel, see `nested`."""
        with self._lock:
            if self._part is None:
                alone = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": nested()}
                self._part = numba().njit(nogil=True, error_model="numpy", **alone, **self._options)(self.py_func)
        return self._part._numba_type_

    def __call__(self, *args: Any) -> Any:
        """Call the compiled function."""
        return self.compiled(*args)


def kernel(function: Function) -> Function:
    """Compile `function` with Numba, keeping the machine code on disk where a directory for it can be written.

    Division by zero gives infinities as in NumPy. The interpreter lock is released while it runs.
    """
    return cast(Function, Kernel(function, is_cached=True))


@lru_cache
def numba() -> Any:
    """Return Numba, told how wide vectors should be, which it heeds until it has made its first function."""
    import numba
    from llvmlite import binding

    config: Any = numba.core.config
    if config.CPU_NAME is None and config.CPU_FEATURES is None and config.ENABLE_AVX:
        config.CPU_FEATURES = tuned(binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten())
    elements.register()
    return numba


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


def tuned(processor: str, features: str) -> str | None:
    """Return the features to compile for, None for Numba's own choice.

    Left alone Numba takes vectors of 512 bits wherever there are any. On Intel's processors, for which C compilers
    prefer 256, that makes the kernels of this package, those in lanes as well, about two times slower.
    """
    wide = "+avx512f" in features.split(",") and not processor.startswith("znver")
    return f"{features},+prefer-256-bit" if wide else None


@lru_cache
def _cache_class() -> type[Any]:
    from numba.core import caching

    on_disk: Any = caching.FunctionCache

    class Cache(on_disk):  # type: ignore[misc]
        """Numba's machine code on disk. A full disk or a damaged file costs a compilation, never the run."""

        def __init__(self, function: Callable[..., object]) -> None:
            super().__init__(function)
            self._cache_file._source_stamp = text_hash(function.__module__)

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


@lru_cache
def text_hash(module: str) -> str:
    """Return a hash of the text of a module and of those whose kernels it calls, where Numba heeds its file alone."""
    own = sys.modules[module]
    called, package = set[str](), __name__.split(".")[0] + "."
    for value in vars(own).values():
        home = str(getattr(value, "__module__", type(value).__module__))
        if isinstance(value, Kernel) or home.startswith(package):
            called.add(home)
    return sha256("".join([inspect.getsource(own), *map(text_hash, sorted(called - {module}))]).encode()).hexdigest()


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
    return cast(Function, Kernel(function, is_cached=False, forceinline=True))


def shared(function: Function) -> Function:
    """Compile `function` once into each kernel that calls it, not kept on disk: its arguments may be elements."""
    return cast(Function, Kernel(function, is_cached=False))

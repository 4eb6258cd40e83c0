"""The element type of a kernel: one body in a double, or several bodies in a vector of doubles.

A step is written once, on numbers that are called elements here. Compiled for doubles it steps one body; compiled for
vectors `<n x double>` it steps n bodies, each with the operations of the first text: IEEE operations element by
element, nothing reordered, nothing contracted. So a body has the same bits in both.

Elements know + - * /, unary minus, `abs` and comparisons, which give masks; what a text chooses by a mask it chooses
with `select`. Memory is addressed by plain pointers to doubles, so that no kernel allocates. Every function here also
runs uncompiled, on doubles alone.
"""

from __future__ import annotations

import ctypes
import operator
from collections.abc import Callable
from math import sqrt
from typing import Any

import numpy as np

Moment = ctypes.CFUNCTYPE(
    None,
    ctypes.c_double,
    ctypes.POINTER(ctypes.c_double),
    ctypes.POINTER(ctypes.c_double),
    ctypes.POINTER(ctypes.c_double),
)


def doubles(address: int) -> Any:
    """Return the pointer to the doubles at an address."""
    return ctypes.cast(int(address), ctypes.POINTER(ctypes.c_double))


def integers(address: int) -> Any:
    """Return the pointer to the integers of 64 bits at an address."""
    return ctypes.cast(int(address), ctypes.POINTER(ctypes.c_int64))


def lanes(like: Any) -> int:
    """Return how many bodies an element of this type holds."""
    return 1


def four() -> float:
    """Return an element of four bodies."""
    return 0.0


def eight() -> float:
    """Return an element of eight bodies."""
    return 0.0


def root(x: Any) -> Any:
    """Return the square root."""
    return sqrt(x)


def fused(a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, rounded once."""
    from fractions import Fraction

    try:
        exact = Fraction(a) * Fraction(b) + Fraction(c)
        return float(exact) if exact else a * b + c
    except (ValueError, OverflowError):  # not finite, or not to be
        return a * b + c


def splat(x: float, like: Any) -> Any:
    """Return the element, of the type of `like`, that holds x for every body."""
    return x


def load(pointer: Any, place: int, like: Any) -> Any:
    """Return the element at a place."""
    return pointer[place]


def store(pointer: Any, place: int, x: Any) -> None:
    """Write an element to a place."""
    pointer[place] = x


def select(mask: Any, a: Any, b: Any) -> Any:
    """Return a where the mask is set, else b."""
    return a if mask else b


def both(a: Any, b: Any) -> Any:
    """Return the mask that is set where both are."""
    return a and b


def either(a: Any, b: Any) -> Any:
    """Return the mask that is set where one of them is."""
    return a or b


def without(a: Any, b: Any) -> Any:
    """Return the mask that is set where a is and b is not."""
    return a and not b


def any_of(mask: Any) -> bool:
    """Whether the mask is set for any body."""
    return bool(mask)


def largest(x: Any, like: Any) -> Any:
    """Return the largest entry of a vector where `like` is a double, else x, whose entries belong to bodies."""
    return x


def call_moment(function: int, t: float, directors: Any, angular_velocity: Any, moment: Any) -> None:
    """Call the C function at an address: `void (double, const double *, const double *, double *)`."""
    Moment(function)(t, directors, angular_velocity, moment)


def call_kernel(function: int, block: int) -> None:
    """Call the kernel at an address: `void (int64_t block)`."""
    ctypes.CFUNCTYPE(None, ctypes.c_int64)(function)(block)


def sixteen() -> Any:
    """Return a pointer to sixteen doubles on the stack, the same ones at each call within a function."""
    return (ctypes.c_double * 16)()


def matrix() -> Any:
    """Return a 3 × 3 array on the stack, the same one at each call within a function."""
    return np.empty((3, 3))


def viewed(pointer: Any, shape: Any) -> Any:
    """Return the contiguous array of a shape, a tuple, at a pointer."""
    return np.ctypeslib.as_array(pointer, shape)


def shifted(pointer: Any, places: int) -> Any:
    """Return the pointer to what lies so many doubles further."""
    return doubles(ctypes.addressof(pointer.contents) + 8 * places)


def register() -> None:
    """Teach Numba the elements."""
    from llvmlite import ir
    from numba.core import cgutils, types
    from numba.core.extending import lower_builtin, models, register_model
    from numba.core.typing.templates import AbstractTemplate, infer_global, signature
    from numba.np.arrayobj import populate_array

    f8, i8, boolean, real = types.float64, types.int64, types.boolean, ir.DoubleType()

    class Vector(types.Type):
        def __init__(self, n: int) -> None:
            self.n = n
            super().__init__(name=f"Vector({n})")

    class Mask(types.Type):
        def __init__(self, n: int) -> None:
            self.n = n
            super().__init__(name=f"Mask({n})")

    class VectorModel(models.PrimitiveModel):
        def __init__(self, manager: Any, kind: Any) -> None:
            super().__init__(manager, kind, ir.VectorType(real, kind.n))

    class MaskModel(models.PrimitiveModel):
        def __init__(self, manager: Any, kind: Any) -> None:
            super().__init__(manager, kind, ir.VectorType(ir.IntType(1), kind.n))

    register_model(Vector)(VectorModel)
    register_model(Mask)(MaskModel)

    def typed(function: Any, rule: Callable[..., Any]) -> None:
        """Let `rule` give the type of a call from those of its arguments, None where it knows none."""

        class Template(AbstractTemplate):
            def generic(self, args: Any, kws: Any) -> Any:
                result = rule(*args)
                return None if result is None else signature(result[0], *result[1])

        infer_global(function)(Template)

    def spread(builder: Any, x: Any, n: int) -> Any:
        """Return the vector of n times x."""
        whole = ir.VectorType(x.type, n)
        first = builder.insert_element(ir.Constant(whole, ir.Undefined), x, ir.IntType(32)(0))
        return builder.shuffle_vector(
            first, ir.Constant(whole, ir.Undefined), ir.Constant(ir.VectorType(ir.IntType(32), n), [0] * n)
        )

    def wide(context: Any, builder: Any, x: Any, kind: Any, n: int) -> Any:
        if isinstance(kind, Vector):
            return x
        return spread(builder, context.cast(builder, x, kind, f8), n)

    def pair(a: Any, b: Any) -> int | None:
        found = [x.n for x in (a, b) if isinstance(x, Vector)]
        fits = found and all(isinstance(x, (Vector, types.Number)) for x in (a, b))
        return found[0] if fits else None

    def binary(function: Any, emit: Callable[[Any, Any, Any], Any], result: Any) -> None:
        def rule(a: Any, b: Any) -> Any:
            n = pair(a, b)
            return None if n is None else (result(n), (a, b))

        def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            n = pair(*sig.args) or 0
            return emit(builder, *(wide(context, builder, x, kind, n) for x, kind in zip(args, sig.args, strict=True)))

        typed(function, rule)
        for left, right in ((Vector, Vector), (Vector, types.Number), (types.Number, Vector)):
            lower_builtin(function, left, right)(lower)

    def arithmetic(name: str) -> Callable[[Any, Any, Any], Any]:
        return lambda builder, a, b: getattr(builder, name)(a, b)

    def compared(sign: str) -> Callable[[Any, Any, Any], Any]:
        return lambda builder, a, b: builder.fcmp_ordered(sign, a, b)

    for name, emitted in {"add": "fadd", "sub": "fsub", "mul": "fmul", "truediv": "fdiv"}.items():
        binary(getattr(operator, name), arithmetic(emitted), Vector)
    for name, sign in {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "=="}.items():
        binary(getattr(operator, name), compared(sign), Mask)
    binary(operator.ne, lambda builder, a, b: builder.fcmp_unordered("!=", a, b), Mask)

    def unary(function: Any, emit: Callable[[Any, Any], Any]) -> None:
        typed(function, lambda a: (a, (a,)) if isinstance(a, Vector) else None)
        lower_builtin(function, Vector)(lambda context, builder, sig, args: emit(builder, args[0]))

    def intrinsic(builder: Any, name: str, *args: Any) -> Any:
        a = args[0].type
        kind, suffix = ir.FunctionType(a, [a] * len(args)), f"v{a.count}f64" if a != real else "f64"
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.{suffix}"), args)

    unary(operator.neg, lambda builder, a: builder.fneg(a))
    unary(abs, lambda builder, a: intrinsic(builder, "fabs", a))

    def own(function: Any, rule: Callable[..., Any], emit: Callable[..., Any]) -> None:
        """Type and lower a function of this module, for whatever it takes."""
        typed(function, rule)
        count = function.__code__.co_argcount
        lower_builtin(function, *[types.Any] * count)(emit)

    def is_mask(*kinds: Any) -> bool:
        return all(kind == boolean or isinstance(kind, Mask) for kind in kinds)

    pointer = types.CPointer(f8)
    own(doubles, lambda a: (pointer, (i8,)), lambda c, b, s, args: b.inttoptr(args[0], real.as_pointer()))
    own(
        integers,
        lambda a: (types.CPointer(i8), (i8,)),
        lambda c, b, s, args: b.inttoptr(args[0], ir.IntType(64).as_pointer()),
    )
    own(lanes, lambda a: (i8, (a,)), lambda c, b, s, args: ir.IntType(64)(getattr(s.args[0], "n", 1)))
    own(four, lambda: (Vector(4), ()), lambda c, b, s, args: spread(b, real(0.0), 4))
    own(eight, lambda: (Vector(8), ()), lambda c, b, s, args: spread(b, real(0.0), 8))
    own(root, lambda a: (a, (a,)), lambda c, b, s, args: intrinsic(b, "sqrt", args[0]))

    def fused_rule(*kinds: Any) -> Any:
        found = [kind for kind in kinds if isinstance(kind, Vector)]
        return (found[0] if found else f8, kinds if found else (f8, f8, f8))

    def emit_fused(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        if isinstance(sig.return_type, Vector):
            n = sig.return_type.n
            args = [wide(context, builder, x, kind, n) for x, kind in zip(args, sig.args, strict=True)]
        return intrinsic(builder, "fma", *args)

    own(fused, fused_rule, emit_fused)
    own(
        splat,
        lambda x, like: (like, (f8, like)),
        lambda c, b, s, args: spread(b, args[0], s.args[1].n) if isinstance(s.args[1], Vector) else args[0],
    )

    def place(builder: Any, args: Any, kind: Any) -> Any:
        at = builder.gep(args[0], [args[1]])
        return builder.bitcast(at, ir.VectorType(real, kind.n).as_pointer()) if isinstance(kind, Vector) else at

    def emit_load(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.load(place(builder, args, sig.args[2]), align=8)

    def emit_store(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        builder.store(args[2], place(builder, args, sig.args[2]), align=8)
        return context.get_dummy_value()

    own(load, lambda p, i, like: (like, (pointer, i8, like)), emit_load)
    own(store, lambda p, i, x: (types.none, (pointer, i8, x if isinstance(x, Vector) else f8)), emit_store)

    def select_rule(mask: Any, a: Any, b: Any) -> Any:
        if isinstance(mask, Mask):
            return Vector(mask.n), (mask, a, b)
        wider = pair(a, b)
        kind = f8 if wider is None else Vector(wider)
        return (kind, (boolean, *(x if isinstance(x, Vector) else f8 for x in (a, b)))) if is_mask(mask) else None

    def emit_select(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        mask, *values = args
        if isinstance(sig.args[0], Mask):
            values = [wide(context, builder, x, k, sig.args[0].n) for x, k in zip(values, sig.args[1:], strict=True)]
        elif isinstance(sig.return_type, Vector):
            n = sig.return_type.n
            values = [wide(context, builder, x, k, n) for x, k in zip(values, sig.args[1:], strict=True)]
        return builder.select(mask, *values)

    own(select, select_rule, emit_select)
    masks = lambda a, b: (a if isinstance(a, Mask) else b, (a, b)) if is_mask(a, b) else None  # noqa: E731
    own(both, masks, lambda c, b, s, args: b.and_(*args))
    own(either, masks, lambda c, b, s, args: b.or_(*args))
    own(without, masks, lambda c, b, s, args: b.and_(args[0], b.not_(args[1])))

    def emit_any(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        if not isinstance(sig.args[0], Mask):
            return args[0]
        whole = builder.bitcast(args[0], ir.IntType(sig.args[0].n))
        return builder.icmp_unsigned("!=", whole, whole.type(0))

    own(any_of, lambda mask: (boolean, (mask,)) if is_mask(mask) else None, emit_any)

    def emit_largest(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        x, n = args[0], getattr(sig.args[0], "n", 1)
        if isinstance(sig.args[1], Vector):
            return x
        while n > 1:
            n //= 2
            half = [
                builder.shuffle_vector(x, x, ir.Constant(ir.VectorType(ir.IntType(32), n), [*range(at, at + n)]))
                for at in (0, n)
            ]
            x = builder.select(builder.fcmp_ordered(">", *half), *half)
        return builder.extract_element(x, ir.IntType(32)(0)) if isinstance(sig.args[0], Vector) else x

    own(largest, lambda x, like: (like if isinstance(like, Vector) else f8, (x, like)), emit_largest)

    def emit_call(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        at = real.as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [real, at, at, at])
        builder.call(builder.inttoptr(args[0], kind.as_pointer()), args[1:])
        return context.get_dummy_value()

    own(call_moment, lambda *kinds: (types.none, (i8, f8, pointer, pointer, pointer)), emit_call)

    def emit_kernel(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = ir.FunctionType(ir.VoidType(), [ir.IntType(64)])
        builder.call(builder.inttoptr(args[0], kind.as_pointer()), args[1:])
        return context.get_dummy_value()

    own(call_kernel, lambda *kinds: (types.none, (i8, i8)), emit_kernel)
    own(sixteen, lambda: (pointer, ()), lambda c, b, s, args: cgutils.alloca_once(b, real, size=ir.IntType(32)(16)))

    def array_at(context: Any, builder: Any, kind: Any, memory: Any, shape: list[Any]) -> Any:
        array, word = context.make_array(kind)(context, builder), context.get_constant(types.intp, 8)
        strides = [word]
        for n in shape[:0:-1]:
            strides.insert(0, builder.mul(strides[0], n))
        populate_array(array, memory, shape, strides, word, meminfo=None)
        return array._getvalue()

    def emit_matrix(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        memory = cgutils.alloca_once(builder, real, size=ir.IntType(32)(9))
        return array_at(context, builder, sig.return_type, memory, [context.get_constant(types.intp, 3)] * 2)

    def emit_view(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return array_at(context, builder, sig.return_type, args[0], cgutils.unpack_tuple(builder, args[1]))

    def view_rule(p: Any, shape: Any) -> Any:
        return types.Array(p.dtype, len(shape), "C"), (p, types.UniTuple(i8, len(shape)))

    own(matrix, lambda: (types.Array(f8, 2, "C"), ()), emit_matrix)
    own(viewed, view_rule, emit_view)
    own(shifted, lambda p, i: (pointer, (pointer, i8)), lambda c, b, s, args: b.gep(args[0], [args[1]]))

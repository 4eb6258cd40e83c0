"""The primitives `run`, `push` and `pull` of JAX, and their rules: see `nontwist.jax`.

All take arrays with the same number of mapped axes in front; an axis along which an array is the same has the length 1.
Linear arguments have the full length, so that transposes have the shapes of what they belong to.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from ..driver.varied import Varied
from ..geometry.arrays import Array

SECOND = (
    "runs have first derivatives only: no Hessians; Gauss–Newton methods need none, and quasi-Newton methods such as "
    "BFGS make one of gradients"
)
STATES = ((3, 3), (3,))


class Call(NamedTuple):
    """What a primitive is called with beside arrays: the problem, the names of all values, those of the tangents."""

    problem: Varied
    names: tuple[str, ...]
    wrt: tuple[str, ...] = ()

    def shapes(self, names: Sequence[str]) -> list[tuple[int, ...]]:
        """Return the shapes of parameters."""
        return [self.problem.shape(one) for one in self.problem.named(names).values()]

    @property
    def states(self) -> list[tuple[int, ...]]:
        """The shapes of the states."""
        return [(self.problem.count, *shape) for shape in STATES]


def run(problem: Varied, values: dict[str, Any]) -> Any:
    """Return the states of a run, as arrays of JAX."""
    return run_p.bind(*values.values(), call=Call(problem, tuple(values)))


def _same(call: Call, values: Sequence[Array], mapped: tuple[int, ...]) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Yield the values that differ along mapped axes, each with where they are among all."""
    shapes = call.shapes(call.names)
    own = np.broadcast_shapes(
        (1,) * len(mapped), *(_mapped(value, shape) for value, shape in zip(values, shapes, strict=True))
    )
    wide = [np.broadcast_to(value, (*own, *shape)) for value, shape in zip(values, shapes, strict=True)]
    for at in np.ndindex(*own):
        where = tuple(k if n > 1 else slice(None) for k, n in zip(at, own, strict=True))
        yield where, dict(zip(call.names, (one[at] for one in wide), strict=True))


def _mapped(array: Any, shape: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(array.shape[: array.ndim - len(shape)])


def _split(call: Call, arrays: Sequence[Any]) -> tuple[Sequence[Any], Sequence[Any]]:
    return arrays[: len(call.names)], arrays[len(call.names) :]


Shapes = Callable[[Call], list[tuple[int, ...]]]
Compute = Callable[[Call, dict[str, Any], list[Array]], Iterable[Array]]


def _primitive(name: str, compute: Compute, linear: Shapes, results: Shapes) -> Primitive:
    """Return a primitive that is computed on the host: at once outside of `jit`, else by a callback.

    Parameters
    ----------
    name : str
    compute : callable
        From values that are not mapped, and linear arguments with one mapped axis in front, to results with this axis.
    linear, results : callable
        The shapes of the linear arguments, and of the results, without mapped axes.
    """
    made = Primitive(f"nontwist_{name}")
    made.multiple_results = True

    def shapes(call: Call, arrays: Sequence[Any]) -> list[tuple[int, ...]]:
        known = call.shapes(call.names) + linear(call)
        mapped = np.broadcast_shapes(*(_mapped(one, shape) for one, shape in zip(arrays, known, strict=True)))
        return [(*mapped, *shape) for shape in results(call)]

    def here(call: Call, *arrays: Array) -> list[Array]:
        values, others = _split(call, arrays)
        found = [np.empty(shape) for shape in shapes(call, arrays)]
        mapped = found[0].shape[: found[0].ndim - len(results(call)[0])]
        for where, own in _same(call, values, mapped):
            rows = [one[where].reshape(-1, *shape) for one, shape in zip(others, linear(call), strict=True)]
            for whole, part in zip(found, compute(call, own, rows), strict=True):
                whole[where] = part.reshape(whole[where].shape)
        return found

    def at_once(*arrays: Any, call: Call) -> list[Any]:
        return [jnp.asarray(one) for one in here(call, *map(np.asarray, arrays))]

    def staged(*arrays: Any, call: Call) -> list[Any]:
        def on_host(*given: Any) -> list[Array]:
            return here(call, *map(np.asarray, given))

        promised = [jax.ShapeDtypeStruct(shape, np.dtype(np.float64)) for shape in shapes(call, arrays)]
        return jax.pure_callback(on_host, promised, *arrays, vmap_method="sequential")

    def abstract(*arrays: Any, call: Call) -> list[Any]:
        return [jax.core.ShapedArray(shape, np.dtype(np.float64)) for shape in shapes(call, arrays)]

    def mapped(arrays: Sequence[Any], axes: Sequence[Any], call: Call) -> Any:
        size = next(one.shape[axis] for one, axis in zip(arrays, axes, strict=True) if axis is not None)
        ahead = []
        for k, (one, axis) in enumerate(zip(arrays, axes, strict=True)):
            array = jnp.expand_dims(one, 0) if axis is None else jnp.moveaxis(one, axis, 0)
            if k >= len(call.names):
                array = jnp.broadcast_to(array, (size, *array.shape[1:]))
            ahead.append(array)
        found = made.bind(*ahead, call=call)
        return found, [0] * len(found)

    made.def_impl(at_once)
    made.def_abstract_eval(abstract)
    mlir.register_lowering(made, mlir.lower_fun(staged, multiple_results=True))
    batching.primitive_batchers[made] = mapped
    return made


def _push_here(call: Call, values: dict[str, Any], tangents: list[Array]) -> Iterable[Array]:
    return call.problem.push(values, dict(zip(call.wrt, tangents, strict=True)))


def _pull_here(call: Call, values: dict[str, Any], slopes: list[Array]) -> Iterable[Array]:
    return call.problem.pull(values, call.wrt, *slopes).values()


run_p = _primitive("run", lambda call, values, _: call.problem.run(values), lambda call: [], lambda call: call.states)
push_p = _primitive("push", _push_here, lambda call: call.shapes(call.wrt), lambda call: call.states)
pull_p = _primitive("pull", _pull_here, lambda call: call.states, lambda call: call.shapes(call.wrt))


def _jvp_of_run(values: Sequence[Any], tangents: Sequence[Any], call: Call) -> Any:
    states = run_p.bind(*values, call=call)
    changing = {
        name: tangent for name, tangent in zip(call.names, tangents, strict=True) if not isinstance(tangent, ad.Zero)
    }
    mapped = states[0].shape[: states[0].ndim - 3]
    along = [
        jnp.broadcast_to(tangent, (*mapped, *shape))
        for tangent, shape in zip(changing.values(), call.shapes(tuple(changing)), strict=True)
    ]
    return states, push_p.bind(*values, *along, call=call._replace(wrt=tuple(changing)))


def _linear(made: Primitive, other: Primitive) -> None:
    """Set the rules of a primitive that is linear in all but the values, and of which `other` is the transpose."""

    def jvp(arrays: Sequence[Any], tangents: Sequence[Any], call: Call) -> Any:
        values, _ = _split(call, arrays)
        fixed, linear = _split(call, tangents)
        if not all(isinstance(one, ad.Zero) for one in fixed):
            raise NotImplementedError(SECOND)
        return made.bind(*arrays, call=call), made.bind(*values, *map(ad.instantiate_zeros, linear), call=call)

    def transpose(slopes: Sequence[Any], *arrays: Any, call: Call) -> list[Any]:
        values, linear = _split(call, arrays)
        if any(map(ad.is_undefined_primal, values)):
            raise NotImplementedError(SECOND)
        found = other.bind(*values, *map(ad.instantiate_zeros, slopes), call=call)
        return [None] * len(values) + [
            one if ad.is_undefined_primal(place) else None for one, place in zip(found, linear, strict=True)
        ]

    ad.primitive_jvps[made] = jvp
    ad.primitive_transposes[made] = transpose


ad.primitive_jvps[run_p] = _jvp_of_run
_linear(push_p, pull_p)
_linear(pull_p, push_p)

r"""Runs as functions of JAX: differentiated in both directions, mapped, compiled, within a larger computation.

A run is not traced. It is computed by the kernels of the package, which JAX calls on the host, and so are its
derivatives: those of the discrete run, exact to round-off. `function` is built of three primitives,

    run(θ) = y,    push(θ, t) = (dy/dθ) t,    pull(θ, c) = (dy/dθ)ᵀ c,

y the stored states, θ the parameters. The Jacobian–vector product of `run` is `push`, which is linear in t; its
transpose is `pull`, and that of `pull` is `push`. From these JAX makes both modes: `jax.jvp` and `jax.jacfwd` carry
changes forward (as `nontwist.sensitivities`), `jax.grad` and `jax.jacrev` carry them back (as `nontwist.gradient`: the
discrete adjoint, whose cost does not depend on the number of parameters). `custom_jvp` alone would need the whole
Jacobian for a gradient, `custom_vjp` alone has no forward mode; the primitives need neither.

Under `jax.vmap` each primitive keeps its mapped axes in front and is called once for all of them. What is the same for
all, as θ in `jax.jacfwd`, is then integrated once. Derivatives of derivatives are refused.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Unpack

import numpy as np

from ..driver.problem import OfNodes, Problem, plan_of, posed, takes
from ..driver.starts import last_attitude
from ..driver.varied import Varied
from ..geometry.arrays import as_array
from ..geometry.attitudes import attitudes
from ..geometry.values import public, short_repr
from ..machine import library
from ..models.system import DirectorSystem, as_system

__all__ = ["function"]
public(__name__)


@takes(OfNodes, store="end", material_angular_velocity=(0.0, 0.0, 0.0))
def function(
    system: DirectorSystem | Problem, **keywords: Unpack[OfNodes]
) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """Return a JAX function that maps parameters of a run to its stored states.

    The function maps a dictionary to a dictionary. It works under `jax.jit`, `jax.grad`, `jax.jvp`, `jax.jacfwd`,
    `jax.jacrev`, `jax.vmap` and their compositions, but not under `jax.hessian`, since only first derivatives exist. It
    requires the extra `jax`, as in ``pip install ".[jax]"``, and ``jax.config.update("jax_enable_x64", True)`` before
    it is called.

    Parameters
    ----------
    system : DirectorSystem or Problem
        The body: `standard`, `nontwisting`, `suslov`, `heavy_top`, `with_gravity`; or a whole problem.
    t_end, step, t_start
        As in `simulate`. The step must be given, so that the number of states is known before the run and the steps do
        not change with the parameters.
    rotation, scalar_first, material_angular_velocity
        Start of the runs, as in `simulate`, unless the dictionary contains one.
    load, integrator, order, project
        As in `simulate`. "gauss", "lie-midpoint" and "energy-momentum" have derivatives.
    store : int or "end"
        Return every `store`-th state, or only the first and the last, which is the default.

    Returns
    -------
    function
        ``f(params)``, whose keys may be any of the names of `wrt` in `sensitivities`: "material_angular_velocity" (3,);
        "rotation" (3, 3), the matrix Λ; "inertia" (3, 3) or "principal_inertia" (3,); "axis" (3,); "dead_force" (3, 3);
        "spin" (k,); "load_scale"; "duration"; and parameters of the load, "values" (k, 3), "sine" (3,), "frequency",
        "damping" (3, 3), ..., or ``"load[1].values"`` for one of several terms. Parameters without a key have the
        values of the system, load and start. It returns "rotation", (n, 3, 3), the matrices Λ, and
        "material_angular_velocity", (n, 3).

        f is extended to all matrices and vectors: it depends on the nearest rotation, the symmetric part of the inertia
        and the direction of the axis. A gradient with respect to Λ is therefore tangent to the rotations. For a body
        with a constrained axis only the admissible part of a change counts, as in `sensitivities`.

    Raises
    ------
    ValueError
        An argument is invalid, here or in a call; the integrator or the load has no derivatives; or 64-bit numbers are
        disabled.
    ImportError
        JAX is not installed; the message states the command that installs it.
    NotImplementedError
        Second derivatives are requested.

    Notes
    -----
    Impossible values and runs that fail raise what `simulate` raises. Under `jax.jit`, JAX raises its own error with
    the same text.

    Examples
    --------
    The derivatives of the attitude after 1 s with respect to the moments of inertia, by one backward pass:

    >>> import jax
    >>> import nontwist.jax
    >>> from nontwist import standard
    >>> jax.config.update("jax_enable_x64", True)
    >>> run = nontwist.jax.function(standard([3, 4, 5]), t_end=1, step=0.05)
    >>> def height(params):  # of the third director
    ...     return run(params)["rotation"][-1, 2, 2]
    >>> params = {"material_angular_velocity": (0.1, 2.0, 0.0), "principal_inertia": (3.0, 4.0, 5.0)}
    >>> g = jax.jit(jax.grad(height))(params)
    >>> [round(float(x), 4) for x in g["principal_inertia"]]
    [-0.0004, 0.0004, -0.0001]
    """
    library("jax", "nontwist.jax needs JAX: pip install 'nontwist[jax]'")
    known = posed("function", system, keywords, OfNodes, store="end")
    if known.step is None:
        raise ValueError("give step=: a JAX function has steps that do not depend on its parameters")
    body, plan = as_system(known.system), plan_of(known)
    R = None if known.rotation is None else attitudes(last_attitude(known.rotation, known.scalar_first)[0])
    W = as_array(known.given.get("material_angular_velocity", np.zeros(3)), "material_angular_velocity", (3,))
    problem = Varied(body, plan, R, W, known.project)

    def run(params: Mapping[str, Any]) -> dict[str, Any]:
        if not isinstance(params, Mapping):
            raise ValueError(f"params must be a dictionary of names and arrays, got {short_repr(params)}")
        return _run(problem, params)

    return run


def _run(problem: Varied, params: Mapping[str, Any]) -> dict[str, Any]:
    """Return the states of a run as arrays of JAX."""
    from jax.dtypes import canonicalize_dtype

    from .primitives import run

    if canonicalize_dtype(np.float64) != np.float64:
        raise ValueError(
            'runs are computed with 64-bit numbers, which JAX has disabled: jax.config.update("jax_enable_x64", True)'
        )
    values = {
        name: _number(params[name], name, problem.shape(one)) for name, one in problem.named(list(params)).items()
    }
    attitude, velocity = run(problem, values)
    return {"rotation": attitude, "material_angular_velocity": velocity}


def _number(value: Any, name: str, shape: tuple[int, ...]) -> Any:
    """Return an array of JAX of what is given as a parameter, traced or not."""
    import jax
    import jax.numpy as jnp

    if isinstance(value, list | tuple) and any(isinstance(one, jax.core.Tracer) for one in jax.tree.leaves(value)):
        value = jnp.asarray(value)
    elif not isinstance(value, jax.Array):
        value = as_array(value, name, shape)
    if value.shape != shape:
        raise ValueError(f"{name} must have the shape {shape}, got {value.shape}")
    return value.astype(np.float64) if isinstance(value, jax.Array) else jnp.asarray(value)

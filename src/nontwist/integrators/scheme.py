"""What a compiled scheme says of itself: its marches, its stages, and what it carries from step to step."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..engine.generalised import MOMENT
from ..geometry.arrays import Array
from ..loads import Load

if TYPE_CHECKING:
    from ..engine.linearised import Wanted
    from ..engine.marching import Text
    from ..engine.records import Parts
    from ..kernels.kernel import Kernel

ONCE, MIDDLE = np.ones(1), np.full(1, 0.5)


def midpoint(order: int, form: int) -> tuple[Array, Array]:
    """Return the one fraction of a step that is taken at once, and its node of the load: the middle."""
    return ONCE, MIDDLE


def as_they_are(forms: NDArray[np.int64], bodies: Array, load: Load) -> NDArray[np.int64]:
    """Return the forms of the steps as the engine finds them."""
    return forms


def alike(forms: NDArray[np.int64], bodies: Array, load: Load) -> NDArray[np.int64]:
    """Return one form for all bodies."""
    return np.zeros_like(forms)


class Scheme(NamedTuple):
    """The step of a scheme and what it is marched with.

    The step is a text (`engine.marching`), the same for all forms of a step (`engine.bodies`) or one for each.
    """

    text: Text | None = None
    texts: Callable[[int, int], Text] | None = None  # of an order and a form
    is_director_scheme: bool = False  # carries W and N, gives λ; else it carries the momentum
    is_exact: bool = False  # without load: a stretch in which no moment acts is one motion. In principal axes
    stages: Callable[[int, int], tuple[Array, Array]] = midpoint  # of an order and a form: fractions, nodes of the load
    forms: Callable[[NDArray[np.int64], Array, Load], NDArray[np.int64]] = as_they_are
    explicit: tuple[int, ...] = ()  # forms of a step in which nothing is to be solved
    in_lanes: bool = True  # whether bodies are marched side by side
    table: Callable[[int], Array | None] = lambda order: None  # coefficients of an order
    carried: Callable[[int], int] = lambda order: 0  # numbers of a member beside STATE
    room: Callable[[int], int] = lambda lanes: 0  # numbers beside the workspace
    action: int = MOMENT  # what director forces and potentials are for it (`engine.generalised`)
    dissipation: float = 0.0
    within: Callable[[int], Array | None] = lambda order: None  # c, b, polynomials of an order, for guesses of substeps
    # What linearises steps, of an order, a form, what there is, and the inputs asked for; None: the text itself.
    linear: Callable[[int, int, Parts, Wanted], Kernel] | None = None

    def text_of(self, order: int, form: int) -> Text:
        """Return the text of its step."""
        if self.texts is not None:
            return self.texts(order, form)
        assert self.text is not None
        return self.text

"""Where the numbers of a Gauss step lie: coefficients, what is known of each stage, room for Newton's iteration.

A number of a stage lies at ``y[(component * WIDTH + stage) * lanes + lane]``.
"""

from ..engine.layout import layout

WIDTH = 8  # stages that there is room for
MOST = 3 * WIDTH  # unknowns of Newton's iteration
CARRIED = 6  # components of the increments that the next step is guessed from

TABLE = layout(  # matrices by columns
    "Table",
    nodes=WIDTH,
    weights=WIDTH,
    mu=WIDTH * WIDTH,
    guess=WIDTH * WIDTH,
    a=WIDTH * WIDTH,
    inverse=WIDTH * WIDTH,
    sums=WIDTH,
)
# Increments L of P and of vectors g, and what follows them; moments along the frame, in space, of the state (those of
# space as seen at the beginning of the step); momenta of rotors; increments of a held momentum; P, the vectors g, W;
# increments of the rows of the turn, and what follows them; sums; torques of potentials; velocities that the rows turn
# with, where that is not W.
STAGES = layout(
    "Stages",
    rate=12,
    ahead=12,
    moving=3,
    space=3,
    called=3,
    rotor=3,
    lift=1,
    P=3,
    rows=9,
    W=3,
    turning=9,
    turned=9,
    sums=9,
    held=3,
    V=3,
)
# Systems of equations with their right-hand sides; residuals; derivatives at the stages; a call's numbers.
ROOM = layout("Room", turns=MOST * (2 * MOST + 3), momenta=MOST * (MOST + 1), rest=MOST, B=72, H=72, call=15)


def room(lanes: int) -> int:
    """Return how many numbers a march needs beside the workspace."""
    return int(STAGES.size * WIDTH * lanes + ROOM.size)

"""Runs with more states than they store, for what is drawn of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray

    from ..loads import Load

FAR, DRAWN = 0.1, 20_000  # rad between states that are drawn as they are; states that are drawn, and steps for them


def largest_turn(run: xarray.Dataset) -> float:
    """Return the largest rotation from one state of a run to the next, rad."""
    from ..recordings.motions import rotation

    attitudes = rotation(run)
    return float((attitudes[:-1].inv() * attitudes[1:]).magnitude().max()) if run.sizes["time"] > 1 else 0.0


def smooth(
    run: xarray.Dataset, load: Load | None = None, span: tuple[float, float] | None = None, most: int = DRAWN
) -> xarray.Dataset:
    """Return a run, or a span of it, with more states where its own lie far apart; at most about `most`.

    A ValueError or a SimulationError says why there can be none: a load of functions, or one that ends here.
    """
    import numpy as np

    from ..driver import resample

    time = run["time"].values
    first, last = (time[0], time[-1]) if span is None else np.clip(span, time[0], time[-1])
    part = run.sel(time=slice(first, last))
    if first == last or len(part["time"]) >= most or largest_turn(run) <= FAR:
        return part
    speed = float(np.linalg.norm(run["material_angular_velocity"], axis=1).max())
    count = int(min(np.ceil((last - first) * speed / FAR), most))
    found = resample(run, np.union1d(part["time"], np.linspace(first, last, count)), load)
    return found.assign({name: one for name, one in run.items() if name not in found and "time" not in one.dims})

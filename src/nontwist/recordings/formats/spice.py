"""SPICE C-kernels, read by spiceypy through a meta-kernel (.tm) that lists CK, leapseconds and spacecraft clock.

A C-matrix maps vectors from the reference frame to the instrument (CK required reading), so its transpose is Λ. A
C-kernel of type 3 to 6 interpolates: it is sampled at a rate, times are ephemeris seconds from the first sample. The
angular velocity that a segment may have is that of the instrument in the reference frame, with components along it.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ..options import ReadOptions
from .apart import library, readable
from .content import Content

FRAME = "J2000"
MOST = 10_000_000  # samples


def read_spice(path: Path, how: ReadOptions) -> Content:
    """Read the attitude of the instrument or structure ``body``, its NAIF number, against J2000.

    Kernels that the process has loaded stay loaded.
    """
    spice = library("spiceypy", "spice")
    if how.rate is None:
        raise InputError("no-rate")
    with readable("meta-kernel of CK, leapseconds (LSK) and spacecraft clock (SCLK)"):
        before = {spice.kdata(k, "CK")[0] for k in range(spice.ktotal("CK"))}
        spice.furnsh(str(path))
        try:
            kernels = [spice.kdata(k, "CK")[0] for k in range(spice.ktotal("CK"))]
            objects = {int(one): kernel for kernel in kernels if kernel not in before for one in spice.ckobj(kernel)}
            named = [one for one in objects if how.body in (None, str(one))]
            samples = list(_sampled(spice, objects[named[0]], named[0], how.rate)) if len(named) == 1 else []
        finally:
            spice.unload(str(path))
    if len(named) != 1:
        raise InputError("which-instrument", names=", ".join(map(str, objects)) or "none is there")
    if not samples:
        raise InputError("no-samples")
    times, matrices, spins = (np.array(one) for one in zip(*samples, strict=True))
    name = str(named[0])
    note = f"orientation: C-kernel of {name} against {FRAME}, time in ephemeris seconds"
    known = {} if np.isnan(spins).any() else {name: spins}
    attitudes = {name: np.swapaxes(matrices, 1, 2)}
    return Content(bodies=attitudes, spins=known, time=times - times[0], sampled=True, notes=(note,))


def _sampled(spice: Any, kernel: str, body: int, rate: float) -> Iterator[tuple[float, Any, Any]]:
    """Yield times, C-matrices and angular velocities, NaN without them, at `rate` inside what the kernel covers."""
    cover, left = spice.ckcov(kernel, body, False, "INTERVAL", 0.0, "TDB"), MOST
    for k in range(spice.wncard(cover)):
        first, last = spice.wnfetd(cover, k)
        times = first + np.arange(min(int((last - first) * rate) + 1, left)) / rate
        left -= len(times)
        for time in times:
            ticks = spice.sce2c(int(body / 1000), time)
            try:
                matrix, spin, _ = spice.ckgpav(body, ticks, 0.0, FRAME)
            except spice.NotFoundError:  # there is none with an angular velocity
                try:
                    matrix, spin = spice.ckgp(body, ticks, 0.0, FRAME)[0], np.full(3, np.nan)
                except spice.NotFoundError:
                    continue
            yield float(time), matrix, spin

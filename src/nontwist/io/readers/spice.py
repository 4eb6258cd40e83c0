"""SPICE C-kernels, read by spiceypy through a meta-kernel (.tm) that lists CK, leapseconds and spacecraft clock.

A C-matrix maps vectors from the reference frame to the instrument (CK required reading), so its transpose is Λ. A
C-kernel of type 3 to 6 interpolates: it is sampled at --rate, times are ephemeris seconds from the first sample. The
angular velocity that a segment may have is that of the instrument in the reference frame, with components along it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...analysis.tables import Reading
from .content import Content, library, reading

FRAME = "J2000"
MOST = 10_000_000  # samples


def read_spice(path: Path, how: Reading) -> Content:
    """Read the attitude of the instrument or structure ``body``, its NAIF number, against J2000."""
    spice = library("spiceypy", "spice")
    with open(path, "rb"):
        pass  # errors of the system in its words
    if how.rate is None:
        raise ValueError("a C-kernel is a function of time: give the samples per second with --rate HZ (rate=)")
    words = "meta-kernel of CK, leapseconds (LSK) and spacecraft clock (SCLK)"
    with reading(words):
        spice.kclear()
        try:
            spice.furnsh(str(path))
            kernels = [spice.kdata(k, "CK")[0] for k in range(spice.ktotal("CK"))]
            objects = {int(one): kernel for kernel in kernels for one in spice.ckobj(kernel)}
            body = _body(objects, how.body)
            times, matrices, spins = ([], [], []) if body is None else _sampled(spice, objects[body], body, how.rate)
        finally:
            spice.kclear()
    if body is None:
        raise ValueError(f"specify the instrument: --body (body=) {', '.join(map(str, objects)) or 'none is there'}")
    if not times:
        raise ValueError("there are no attitudes at this rate; choose a higher --rate (rate=)")
    note = f"orientation: C-kernel of {body} against {FRAME}, time in ephemeris seconds"
    attitudes = {str(body): np.swapaxes(np.array(matrices), 1, 2)}
    known = {} if np.isnan(spins).any() else {str(body): np.array(spins)}
    return Content(bodies=attitudes, spins=known, time=np.array(times) - times[0], sampled=True, notes=(note,))


def _body(objects: dict[int, str], named: str | None) -> int | None:
    if named is None:
        return next(iter(objects)) if len(objects) == 1 else None
    return next((one for one in objects if str(one) == named.strip()), None)


def _sampled(spice: Any, kernel: str, body: int, rate: float) -> tuple[list[float], list[Any], list[Any]]:
    """Return times, C-matrices and angular velocities, NaN without them, at `rate` inside what the kernel covers."""
    cover = spice.ckcov(kernel, body, False, "INTERVAL", 0.0, "TDB")
    times: list[float] = []
    matrices: list[Any] = []
    spins: list[Any] = []
    for k in range(spice.wncard(cover)):
        first, last = spice.wnfetd(cover, k)
        count = min(int((last - first) * rate) + 1, MOST - len(times))
        for time in first + np.arange(count) / rate:
            ticks = spice.sce2c(int(body / 1000), time)
            try:
                matrix, spin, _ = spice.ckgpav(body, ticks, 0.0, FRAME)
            except spice.NotFoundError:  # there is none with an angular velocity
                try:
                    matrix, spin = spice.ckgp(body, ticks, 0.0, FRAME)[0], np.full(3, np.nan)
                except spice.NotFoundError:
                    continue
            times.append(float(time))
            matrices.append(matrix)
            spins.append(spin)
    return times, matrices, spins

"""Recordings: from a file to attitudes, rates, times and bodies, and the twist of a motion.

- A reader of `formats` or `text` finds `Content`: a `Table` of columns by header, attitudes of bodies, or both.
- The rows of one sensor are kept; `headers` tells which columns hold what, `times` the `Clock`.
- `orientations` makes a `Reading` of each way to read an orientation; `conventions` compares them with the `Evidence`
  beside; rows that are missing are found: a `Motion`. `reading` does likewise for angular velocities: `Rates`.
- `motions` takes a motion of any form, and cleans it: `Samples`.
- `relative` brings two to one clock and to the axes of their segments.
- `twisting` measures the twist and its errors, `counting` counts it live.
"""

from . import options as options  # whose sentences errors of this package look up

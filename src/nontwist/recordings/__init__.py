"""Recordings: from a file to attitudes, rates, times and bodies, and the twist of a motion.

- A reader of `formats` finds `Content`: a `Table` of columns by header, attitudes of bodies, or both.
- The rows of one sensor are kept; `headers` and `spellings` tell which columns hold what, `times` the `Clock`.
- `attitudes` makes a `Reading` of each way to read an orientation; `checks` compares them with the `Evidence` beside.
- `rotations` says which rows are missing: a `Motion`. `rates` does likewise for angular velocities: `Rates`.
- `motions` takes a motion of any form, and cleans it: `Samples`.
- `relative` brings two to one clock (`clocks`) and to the axes of their segments.
- `twisting` measures the twist and its errors (`noise`), `counting` counts it live.
"""

from . import sentences as sentences  # which errors of this package look up

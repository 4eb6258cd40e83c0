"""Count the turns that a tethered vehicle puts into its tether: roll and loops, which yaw alone does not see.

Lines on standard input: time (s) and the attitude, body to earth, as a quaternion w x y z. The tether is made fast at
the stern, along -x of the body. `tether_counter.c` is the same in C, for the vehicle itself.
"""

import sys
from math import pi

from nontwist import TwistCounter

counter = TwistCounter("x", order=2, scalar_first=True)
for line in sys.stdin:
    time, *attitude = map(float, line.split())
    count = counter.update(attitude, time)
    turns, error = count.twist / (2 * pi), count.error_estimate / (2 * pi)
    lost = f" ({counter.flagged} gaps too long)" if counter.flagged else ""
    print(f"{time:.6g} s: {turns:+.12f} turns, give or take {error:.1e}{lost}")

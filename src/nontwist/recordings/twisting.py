"""Twist of any motion: how much a body turned about its own axis, whatever path the axis took.

Let d3(t) = Λ(t) n be the axis, and let the non-twisting frame start as the body's triad and be transported along d3
without twist (eq-non-twisting). The twist ψ is the angle about d3 from that frame to the body's triad; its rate is the
twist rate ψ' = w·d3 (eq-w_twist). ψ is computed from the frame, of order 4 in the spacing of the samples, not by
integrating rates; whole turns are counted from sample to sample. `twist_noise` has what errors of the samples do to it.
The integrators that count ∫ w·n dt in their stages give the ψ of a run about its own axis n, and so its frame.

**Solid angle.** With the smallest rotation S from d3(0) to d3(t), the swing, Λ(t)Λ(0)ᵀ = S exp(τ d̂3(0)) defines the
swing-twist angle τ: it is the angle about d3(t) from the triad transported along the single great circle to the body's
triad. The angle from the frame transported along the path to the body's triad is ψ. So τ - ψ is the holonomy of the
path closed by the great circle; by Gauss and Bonnet that is the enclosed solid angle Ω:

    τ - ψ = Ω        modulo 2π.

The digits of Ω are those of τ - ψ; its multiple of 2π comes from the sum of the triangles (d3(0), d3(t_i), d3(t_i+1)) =
(a, b, c). With the sums p = a + b and q = a + c the area of one is 2 atan2(a·(p × (c - b)), p·q)
(A. Van Oosterom, J. Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125-126: 1 + a·b + b·c + c·a = p·q), without
cancellation near the antipode -a, where p and q are small differences of given numbers.

**At the antipode.** ψ depends on the path alone and has no singularity. At the distance δ from -a an error dη of d3
turns the great circle back by dη/δ, which sweeps an area of 2 dη/δ: τ and Ω are ill-conditioned, off by about 4e-16/δ
from round-off, at that sample and not later. At the antipode itself every half circle leads back, and Ω is arbitrary:
within 4e-15 rad (16 units of round-off) Ω keeps the value of the sample before, as if the path returned through it, and
τ is ψ + Ω. The next step adds the lune between the half circles through the samples before and after.
Ω is continuous elsewhere. Where the path passes -a on the left (-a lies to its right) Ω grows by nearly 2π within a few
δ, on the other side it falls by as much; the two differ by 4π, the area of the sphere, because -a counts as outside.
A path straight through -a, at a sample or between two, counts as passing on the left.

For an axis fixed in space the twist is ∫ w·n dt: minus the twist of the inverse motion about its body axis n.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..analysis.datasets import RUN, as_dataset, recorded
from ..analysis.trajectory import FORMAT_VERSION, Trajectory
from ..analysis.variables import assembled, labelled
from ..errors import warn
from ..geometry.arrays import EPS, Array, Dataset, arcs, as_array, as_floats, dot, principal_angle
from ..geometry.attitudes import turns
from ..geometry.frame_kernels import transport_samples
from ..geometry.frames import estimates, rolls, triad_about
from ..geometry.path_kernels import angles, body_axes
from ..geometry.values import among, counted, hinted, number_text, short_repr
from .counting import as_direction
from .motions import GAP, Samples, given_motion
from .relative import CLOCKS, relative_motion
from .twist_noise import noise_level, noise_of_rounding, noise_of_twist, rounding

NEAR = 8  # steps beside a gap that show how fast a body turns
JUMP, SEEN = 5.0, 0.05  # times the steps around; rad
ANTIPODAL = 1e-7
SAME = 1e-9  # of a step, between times that are the same
# Distance from the antipode of the start, rad, below which round-off of the axis hides on which side it is.
_LOST = 16 * EPS


@hinted
def twist(
    motion: Any,
    time: ArrayLike | None = None,
    *,
    axis: ArrayLike | str = "z",
    axis_frame: Literal["body", "space"] = "body",
    relative_to: Any = None,
    relative_time: ArrayLike | None = None,
    clocks: Literal["shared", "shift", "drift"] | None = "shared",
    shake: ArrayLike | None = None,
    align: Literal["static"] | None = None,
    static: tuple[float, float] | None = None,
    scalar_first: bool | None = None,
    order: int = 4,
) -> Dataset:
    """Return the twist of a motion about an axis, with an error estimate.

    Parameters
    ----------
    motion : Rotation, (n, 3, 3) Λ, (n, 4) quaternions, run, trajectory, DataArray or DataFrame
        Attitudes, body to space; all forms of `nontwist.rotation`. Signs of quaternions do not matter.
    time : (n,) array, optional
        s or the unit that it states, or dates or durations, which count from the first; those of two recordings tell
        when each begins. Taken from `motion` where it has times. Without times there is no `twist_rate`.
    axis : (3,) array or str
        Of any length but zero; or "x", "y", "z", "-x", "-y", "-z", in small letters or capitals.
    axis_frame : "body" or "space"
        Whether the axis is fixed in the body or in space.
    relative_to : motion, optional
        A second body: the result is the twist of `motion` relative to it, as for a joint. "space" then means this body.
        If its times differ, it is interpolated at those of `motion`.
    relative_time : (n,) array, optional
        Times of `relative_to`, as `time`.
    clocks : "shared", "shift", "drift" or None
        Whether the times of both come from one clock, or differ by a shift, or by a shift and a drift. Shift and drift
        are found from the angular speeds and recorded in the attribute `alignment`, the drift with twice its standard
        deviation. None: the two may be separate files; times that overlap are taken as they are, dates that are whole
        or half hours apart are of two time zones, and else the shift is found.
    shake : (2,) or (k, 2) floats, optional
        Start and end, s, in the times of `motion`, of the interval in which both sensors were shaken together with the
        joint at rest, or of k of them: two for a drift, far apart. The clocks are aligned by the angular speeds in
        them alone, whose correlation must be 0.97 or more. Not with clocks "shared".
    align : "static", optional
        Assume that at rest the axes of the body, and of `relative_to`, coincide with those of space: for sensors with
        unknown mounting. `axis` is then a direction in space at rest.
    static : (2,) floats, optional
        Start and end of the interval at rest, s; by default the one second in which both turn least. Without times,
        rows, counted from 0.
    scalar_first : bool, optional
        Order of quaternions given as a plain array.
    order : 4 or 2
        Order of the frames; 2 for a path with corners at its samples (geodesic in between).

    Returns
    -------
    Dataset on `time`
        twist_angle
            ψ, rad, unwrapped, 0 at the start. Of a run about its own axis, the constrained one or d3, what its
            integrator counted within steps, if it counts: then ψ does not depend on which states are stored.
        twist_rate
            ψ', rad/s, by central differences of ψ, or that of the run where ψ is (absent without times).
        swing_twist_angle
            τ, rad, in (-π, π], of the rotation relative to the first sample; ψ + Ω where the swing is half a turn.
        solid_angle
            Ω, sr, enclosed by the path of the axis and the great circle back to its start. Every area counts as often
            as it is encircled, with the antipode of the start outside. Equal to τ - ψ modulo 2π to round-off. At the
            distance δ from that antipode, an error of the axis enters Ω and τ multiplied by 2/δ; at the antipode
            (within 4e-15 rad) Ω has the value of the sample before.
        path_length
            Length of the path of the axis on the sphere, rad, along great circles.
        error_estimate
            Estimated error of ψ, rad, by sampling: about twice the largest error so far. It includes noise of the
            samples as far as noise looks like motion. Errors of clocks and mountings (`clocks`, `align`) are in neither
            estimate. Both are 0 where the integrator has counted ψ; those of the run remain.
        noise_estimate
            Standard deviation of ψ, rad, by noise of the samples, assumed independent and equal about d3 and across it,
            or by rounding of quaternions and matrices where that is more.
            The noise level, the attribute `noise_level` (rad), is estimated from the roughness of the path of the axis;
            motion that the samples do not resolve counts as noise. NaN for fewer than 12 samples.
        frame
            The non-twisting frame, rows d1, d2, d3; in body components if the axis is fixed in space.

    Raises
    ------
    ValueError
        There are too few samples, something is not a rotation, or axes of neighbouring samples are antipodal (the
        message names the row, counted from 0, or the line of a text file). Recordings do not overlap, or clocks cannot
        be aligned: speeds do not match, another shift fits nearly as well, or a drift is uncertain.

    Warns
    -----
    UserWarning
        Rows are dropped (zero or not finite, or duplicate times) or sorted; times look rounded, there are gaps, the
        attitude jumps, or neighbouring samples are more than a right angle apart: the message states their number and
        the first row, counted from 0, or its line in a text file. The body moves while it should be at rest. Dates are
        taken for those of two time zones.

    Examples
    --------
    An axis moves once around a cone of half-angle 60°, as in a gimbal. The body returns to its first attitude, and has
    turned by 2π cos 60° about its axis:

    >>> import numpy as np
    >>> from scipy.spatial.transform import Rotation
    >>> from nontwist import twist
    >>> longitude = np.linspace(0, 360, 201)
    >>> motion = Rotation.from_euler("ZY", np.stack([longitude, np.full(201, 60)], axis=1), degrees=True)
    >>> round(float(np.degrees(twist(motion).twist_angle[-1])), 3)
    180.0
    """
    n, sign = as_direction(axis, axis_frame)
    if clocks is not None and not among(clocks, CLOCKS):
        raise ValueError(f"clocks must be 'shared', 'shift' or 'drift', got {short_repr(clocks)}")
    if align is not None and not among(align, ("static",)):
        raise ValueError(f"align must be None or 'static', got {short_repr(align)}")
    pose, pairs = None if static is None else as_array(static, "static", (2,)), _shaken(shake)
    if pose is not None and pose[0] > pose[1]:
        raise ValueError(f"static must be two times, the earlier first, got {pose.tolist()}")
    beside = None if relative_to is None else given_motion(relative_to, relative_time, scalar_first, "relative_time")
    given = given_motion(motion, time, scalar_first, "time")
    rounded = math.hypot(*(0.0 if one is None else rounding(one.values) for one in (given, beside)))
    data = relative_motion(given, beside, clocks, pairs, align == "static", pose, order)
    del given, beside  # what is not needed below makes room
    for note in data.notes:
        warn(note)
    d1, d3 = body_axes(data.quaternion, sign, triad_about(n))
    p = data.quaternion / np.linalg.norm(data.quaternion, axis=1, keepdims=True) * [sign, sign, sign, 1]
    is_run = time is None and relative_to is None
    counted_twist = _counted(motion, data.rows.size, n) if is_run and axis_frame == "body" else None
    length, turn = _steps(p, d3, data, _speeds(motion) if is_run else None, counted_twist is None)
    swing, frame, psi = _swing_twist(p, n), _frame(d3, d1[0], order), np.empty(len(d3))
    flat = _frame(d3, frame[0, 0], 2)  # along great circles
    lead = np.arctan2(dot(frame[:, 0], flat[:, 1]), dot(frame[:, 0], flat[:, 0]))
    angles(d1, frame, psi)
    del p, d1, flat
    if counted_twist is not None:
        back, psi = psi - counted_twist[0], counted_twist[0]
        c, s = np.cos(back)[:, None], np.sin(back)[:, None]
        frame[:, 0], frame[:, 1] = c * frame[:, 0] + s * frame[:, 1], c * frame[:, 1] - s * frame[:, 0]
    sigma = max(noise_level(d3, data.time), rounded)
    noise = noise_of_twist(d3, sigma, order)
    if rounded:
        noise = np.fmax(noise, noise_of_rounding(d3, data.quaternion * [sign, sign, sign, 1], rounded))
    tau, area = _closed(d3, lead, swing, psi)
    sampling = estimates(d3[None], order)[0]
    if counted_twist is not None:
        sampling, noise = np.zeros_like(psi), np.zeros_like(psi)
    variables = {
        "twist_angle": (sign * psi, "rad", "twist angle", "ψ"),
        "swing_twist_angle": (principal_angle(sign * tau), "rad", "swing-twist angle", "τ"),
        "solid_angle": (sign * area, "sr", "solid angle of the path, closed by a great circle", "Ω"),
        "path_length": (np.append(0.0, np.cumsum(length)), "rad", "path length of the axis on the sphere", "s"),
        "error_estimate": (sampling, "rad", "estimated error of the twist angle by sampling", "ε"),
        "noise_estimate": (noise, "rad", "estimated deviation of the twist angle by noise", "σ"),
        "frame": (frame, "1", "non-twisting frame, rows d1, d2, d3", "χ"),
    }
    if data.time is not None:
        scale = 2.0 ** (int(np.frexp(np.ptp(data.time))[1]) - 1)  # products of intervals do not overflow
        rate = np.gradient(sign * psi, data.time / scale, edge_order=2 if psi.size > 2 else 1) / scale
        rate = rate if counted_twist is None else counted_twist[1]
        variables["twist_rate"] = (rate, "rad s-1", "twist rate", "ψ'")
    where = "space" if axis_frame == "space" else "the body"
    record = {
        "format_version": FORMAT_VERSION,
        "title": f"twist about the axis ({', '.join(f'{x:.6g}' for x in n)}), fixed in {where}",
        "axis": n.tolist(),
        "axis_frame": axis_frame,
        "order": order,
        "samples": data.rows.size,
        "samples_left_out": data.left_out,
        "largest_turn_between_samples": float(turn.max()),
        "noise_level": sigma,
        "notes": "; ".join(map(str, data.notes)),
        "alignment": "; ".join(data.facts),
        "conventions": "Λ maps body to space; the rows of frame are d1, d2, d3; swing_twist_angle - twist_angle = "
        "solid_angle modulo 2π",
    }
    time, dims = data.rows.astype(np.float64) if data.time is None else data.time, ("time", "director", "axis")
    described = {
        name: (dims[: array.ndim], array, {"units": unit, "long_name": words, "symbol": symbol})
        for name, (array, unit, words, symbol) in variables.items()
    }
    found = assembled(labelled(described, time=time), record)
    if data.time is None:
        found["time"].attrs = {"units": "1", "long_name": "row, from 0"}
    return found


def _counted(motion: Any, count: int, n: Array) -> tuple[Array, Array] | None:
    """Return ψ of a run about its own axis at its `count` states, as its integrator counted it, and ψ'; or None."""
    if isinstance(motion, Trajectory) and motion.twist is not None:
        axis, time, mean = motion.system.axis, motion.time, motion.twist / np.diff(motion.time)
        rate = motion.observables("twist_rate")["twist_rate"]
    elif {"mean_twist_rate", "twist_rate"} <= {*getattr(motion, "variables", ())} and "system" in motion.attrs:
        run = as_dataset(motion, RUN)
        axis = recorded(run, "system")["axis"]
        time, mean, rate = (run[name].values for name in ("time", "mean_twist_rate", "twist_rate"))
        middles, known, apart = (time[1:] + time[:-1]) / 2, run["midtime"].values, SAME * np.diff(time).max(initial=0.0)
        if known.shape != middles.shape or not np.allclose(known, middles, rtol=0, atol=apart):
            return None  # of some states, and other intervals than theirs
    else:
        return None
    along = float(n @ ((0.0, 0.0, 1.0) if axis is None else np.array(axis)))
    if mean.shape != (count - 1,) or rate.shape != (count,) or abs(along) < 1 - 8 * EPS:  # some states, another axis
        return None
    sign = math.copysign(1.0, along)
    return sign * np.append(0.0, np.cumsum(mean * np.diff(time))), sign * rate


def _shaken(shake: ArrayLike | None) -> Array | None:
    if shake is None:
        return None
    pairs = as_floats(shake, "shake")
    pairs = as_array(pairs[None] if pairs.shape == (2,) else pairs, "shake", (None, 2))
    if not len(pairs) or (pairs[:, 0] >= pairs[:, 1]).any():
        raise ValueError(f"shake must be pairs of times, the earlier first, got {pairs.tolist()}")
    return pairs


def _frame(d3: Array, d1: Array, order: int) -> Array:
    """Non-twisting frames along unit vectors, the first with d1; `_steps` has reported wide steps, with the row."""
    frame = np.empty((1, len(d3), 3, 3))
    transport_samples(d3[None], d1[None], *rolls(d3[None], order, closed=False), frame)
    return np.asarray(frame[0])


def _speeds(motion: Any) -> Array | None:
    """Return the angular speeds at the states of a run, rad/s; None of what is no run."""
    W: Any = getattr(motion, "material_angular_velocity", None)
    if "director" in getattr(W, "dims", ()):
        W = W.transpose(..., "director").values
    return np.linalg.norm(W, axis=-1) if isinstance(W, np.ndarray) else None


def _steps(p: Array, d3: Array, data: Samples, speeds: Array | None, is_sampled: bool) -> tuple[Array, Array]:
    """Return the angles between neighbouring axes and attitudes, these by the speeds, which know of whole turns.

    `speeds` are those of a run; of a recording they are those around a gap. Warns of wide steps, where the twist is
    that of the samples, and of single ones of a recording that are far wider than those around, and refuses antipodal
    axes, naming their rows.
    """
    angle = arcs(d3)
    flat = np.flatnonzero(angle > np.pi - ANTIPODAL)
    if flat.size:
        a, b = data.place(flat[0]), data.place(flat[0] + 1)
        raise ValueError(f"the axis turns by half a turn from {a} to {b}: the shortest path between them is not unique")
    turn = turns(p[:-1], p[1:])
    if data.time is not None:
        h = np.diff(data.time)
        if speeds is None:
            _warn_of_jumps(turn, h, data)
            least = _around_gaps(p, h)
        else:
            v = speeds[data.rows]
            least = np.minimum(v[1:], v[:-1]) * h
        turn = np.where(least > np.pi, least, turn)
    wide = np.flatnonzero(turn > np.pi / 2)
    if wide.size and is_sampled:
        steps, a, b = counted(wide.size, "step"), data.place(wide[0]), data.place(wide[0] + 1)
        first = f"from {a} to {b} ({np.degrees(turn[wide[0]]):.0f}°)"
        lost = ", and whole turns may be missing" * bool((turn > np.pi).any())
        told = f"{steps} of more than a right angle, the first {first}: the motion in between is a guess{lost}"
        warn(told)
    return angle, turn


def _around_gaps(p: Array, h: Array) -> Array:
    """Return by how much a body turns in gaps of the samples at the speed around them: of `NEAR` steps, the lower."""
    least, k, t = np.zeros_like(h), np.flatnonzero(h > GAP * np.median(h)), np.append(0.0, np.cumsum(h))
    sides = (np.maximum(k - NEAR, 0), k), (k + 1, np.minimum(k + 1 + NEAR, len(h)))
    nothing = np.full(len(k), np.inf)
    before, after = (np.divide(turns(p[i], p[j]), t[j] - t[i], out=nothing.copy(), where=i < j) for i, j in sides)
    slower = np.minimum(before, after)
    least[k] = np.where(slower < np.inf, slower, 0.0) * h[k]
    return least


def _warn_of_jumps(turn: Array, h: Array, data: Samples) -> None:
    """Warn of steps that are far faster than all but one of the three before and behind: a reset, or a wild sample."""
    rate = turn / h
    near = np.stack([np.roll(np.pad(rate, 3), k)[3:-3] for k in (-3, -2, -1, 1, 2, 3)])
    around: Array = h * np.sort(near, axis=0)[-2]
    usual = float(np.quantile(turn, 0.99, method="lower"))
    jumps = np.flatnonzero(turn > np.maximum(JUMP * around, max(SEEN, 2 * usual)))
    if jumps.size:
        k = int(jumps[np.argmax(turn[jumps])])
        step, beside = np.degrees([turn[k], around[k]])
        warn(
            f"{counted(jumps.size, 'jump')} of the attitude, the largest of {step:.3g}° from {data.place(k)} to "
            f"{data.place(k + 1)} between steps of {number_text(beside, '.2g')}°: if the sensor was reset there or the "
            "sample is wrong, the twist is wrong by up to as much"
        )


def _swing_twist(p: Array, n: Array) -> Array:
    """Twist angle about the body axis n of the rotation relative to the first, in [-2π, 2π].

    Half of it has as its tangent the quotient of two components of the quaternion p₀* p: along n, and the scalar.
    """
    u, s = p[0, :3], p[0, 3]
    along = p[:, :3] @ (s * n + np.cross(u, n)) - (u @ n) * p[:, 3]
    return np.asarray(2 * np.arctan2(along, p[:, 3] * s + p[:, :3] @ u))


def _closed(d3: Array, lead: Array, tau: Array, psi: Array) -> tuple[Array, Array]:
    """Return τ in (-π, π] and the solid angle between the path so far and the great circle back to its start.

    The area counts the turns: triangles from the start to each step, and what is between great circles and path, the
    `lead` of the frame over that of order 2. τ - ψ gives the digits.
    """
    a, p = d3[0], d3 + d3[0]
    length = np.linalg.norm(p, axis=1)
    clear = length > _LOST
    last = np.maximum.accumulate(np.where(clear, np.arange(len(p)), 0))[:-1]
    b, c = p[last], p[1:]
    triple, along = np.cross(b, c - b) @ a, dot(b, c)
    lune = 2 * np.arctan2(triple, along - np.where(clear[:-1], 0.0, (b @ a) * (c @ a)))
    lune[~clear[1:]] = 0.0
    straight = lune < -2 * np.pi + 2 * _LOST * (1 / length[last] + 1 / np.maximum(length[1:], _LOST))
    lune[straight] += 4 * np.pi
    area = np.append(0.0, np.cumsum(lune))
    area += np.unwrap(lead)
    tau = principal_angle(np.where(clear, tau, psi + area))
    return tau, area + principal_angle(tau - psi - area)

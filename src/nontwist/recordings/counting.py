"""Twist counted live, sample by sample: `TwistCounter`."""

from __future__ import annotations

import struct
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry import arrays
from ..geometry.arrays import Array, Rotation, as_array
from ..geometry.frames import as_order, triad_about
from ..geometry.path_kernels import SIZE, count
from ..geometry.values import require_among
from .motions import as_rotation, raw_motion
from .options import ReadOptions
from .orientations import MEASURED

_GIVEN, _FOUND = struct.Struct("=5d"), struct.Struct("=2d")
_new: Any = tuple.__new__  # of a named tuple, in two thirds of the time
_FOUND_AT = 40  # bytes of a quaternion and a time before what is found


def as_direction(axis: ArrayLike | str, axis_frame: str) -> tuple[Array, float]:
    """Return an axis as a unit vector, and the sign of a twist about it: -1 where it is fixed in space."""
    n = arrays.as_direction(axis, "axis", "the body or in space")
    require_among(axis_frame, "axis_frame", ("body", "space"))
    return n, 1.0 if axis_frame == "body" else -1.0


class TwistCount(NamedTuple):
    """The twist so far and its estimated error: floats of one stream, arrays of several.

    Attributes
    ----------
    twist : float or array, rad
        In whole turns as well, 0 at the first sample.
    error_estimate : float or array, rad
        Of its sampling, as that of `nontwist.twist`.
    """

    twist: Any
    error_estimate: Any


class TwistCounter:
    """A counter of the twist of one body or many: the angle by which each has turned about its axis along its path.

    It accepts one sample at a time; the time and the memory per sample are constant. After any number of samples the
    twist and its error estimate equal, bit for bit, what `nontwist.twist` returns for these samples. At order 2 later
    samples change nothing that has been counted. At order 4 the twist at the last sample extrapolates the curvature of
    the path. The twist at the sample before, `settled`, is final once the axis has moved on from it: from the fourth
    sample on it equals, bit for bit, the twist there that `nontwist.twist` finds in the whole recording.

    Samples may be missing: where the quaternion of a stream is zero or not finite, its count is unchanged. Gaps in
    which the body turns by less than half a turn are bridged. A step is flagged if the body turned by half a turn, or
    would have turned by more in that time at its previous speed: whole turns may be lost there.

    Only one thread may use a counter at a time; several threads that update the same counter need a lock. A counter can
    be copied and pickled at any sample; the copy continues to count.

    Parameters
    ----------
    axis : (3,) array or str
        As in `nontwist.twist`.
    order : 4 or 2
        Order of the frames. Use 2 if the axis moves along great circles from sample to sample, or if noise hides its
        curvature.
    axis_frame : "body" or "space"
        Whether the axis is fixed in the body or in space.
    scalar_first : bool, optional
        Order of quaternions that are not a Rotation of SciPy.

    Raises
    ------
    ValueError
        `axis` has no direction, or `order` is neither 4 nor 2.

    Examples
    --------
    A tethered vehicle flies one loop, nose up, and rolls twice on the way. Yaw cannot count these turns:

    >>> import numpy as np
    >>> from scipy.spatial.transform import Rotation
    >>> from nontwist import TwistCounter
    >>> counter = TwistCounter("x")
    >>> for t in np.linspace(0, 1, 201):
    ...     attitude = Rotation.from_euler("YX", [-2 * np.pi * t, 4 * np.pi * t])
    ...     turned = counter.update(attitude, time=t)
    >>> round(turned.twist / (2 * np.pi), 9)
    2.0
    """

    def __init__(
        self,
        axis: ArrayLike | str = "z",
        order: int = 4,
        *,
        axis_frame: Literal["body", "space"] = "body",
        scalar_first: bool | None = None,
    ) -> None:
        n, self._sign = as_direction(axis, axis_frame)
        ReadOptions(scalar_first=scalar_first)
        self._order, self._scalar_first, self._triad = as_order(order), scalar_first, triad_about(n)
        self.reset()

    def reset(self) -> None:
        """Forget all samples. The next sample is the first, and sets the number of streams anew.

        Examples
        --------
        >>> from nontwist import TwistCounter
        >>> counter = TwistCounter(scalar_first=True)
        >>> counter.update((1, 0, 0, 0)).twist, counter.update((0.8, 0, 0, 0.6)).twist
        (0.0, 1.2870022175866...)
        >>> counter.reset()
        >>> counter.update((0.8, 0, 0, 0.6)).twist
        0.0
        """
        self._shape: tuple[int, ...] | None = None
        self._updates, self._has_times = 0, False
        self._lay_out(0)

    def _lay_out(self, m: int) -> None:
        """Make the memory of m streams, and lay the call of the kernel out in it."""
        self._memory = np.zeros(m * (9 + SIZE))
        ends = np.cumsum([4 * m, m, 4 * m])
        parts = np.split(self._memory, ends)
        self._given, self._time, self._found = parts[0].reshape(m, 4), parts[1], parts[2].reshape(m, 4)
        kernel: Any = count
        arguments = parts[3].reshape(m, SIZE), self._given, self._time, self._order, self._sign, self._triad
        self._count = kernel.bound(*arguments, MEASURED, self._found)
        self._bytes: Any = self._memory.data.cast("B") if m == 1 else None

    def update(self, rotation: Rotation | ArrayLike, time: ArrayLike | None = None) -> TwistCount:
        """Add the next sample of every stream.

        Parameters
        ----------
        rotation : Rotation, (..., 4) array or (..., 3, 3) array
            Attitudes, body to space: a single one, for instance as four numbers, or one for each stream. The first call
            determines the number of streams. Signs of quaternions do not matter.
        time : float or (...) array, s, optional
            Later than at the previous call. Times are used only to find long gaps; without them, samples count as
            equally spaced.

        Returns
        -------
        TwistCount
            A named tuple: `twist` so far, rad, unwrapped and 0 at the first sample; and `error_estimate`, rad, its
            error by sampling. Floats for one stream, arrays for several.

        Raises
        ------
        ValueError
            The number of streams changes; a quaternion does not have length 1 within 1e-2, or its order is not known;
            something is not a rotation; a time is not later than the one before, or is given at some calls and not at
            others. Nothing is counted then.

        Examples
        --------
        Two streams, as one array:

        >>> from nontwist import TwistCounter
        >>> counter = TwistCounter("x", scalar_first=False)
        >>> start = counter.update([(0, 0, 0, 1), (0, 0, 0, 1)])
        >>> counter.update([(0.6, 0, 0, 0.8), (-0.6, 0, 0, 0.8)]).twist
        array([ 1.28700222, -1.28700222])
        """
        if self._shape == () and self._scalar_first is not None and self._has_times is (time is not None):
            plain: Any = rotation.tolist() if type(rotation) is np.ndarray else rotation
            if type(plain) in (tuple, list) and len(plain) == 4:
                a, b, c, d = plain
                moment: Any = self._updates if time is None else time
                try:
                    if self._scalar_first:
                        _GIVEN.pack_into(self._bytes, 0, b, c, d, a, moment)
                    else:
                        _GIVEN.pack_into(self._bytes, 0, a, b, c, d, moment)
                except struct.error:
                    return self._update(rotation, time)
                wrong, _ = self._count()
                if wrong:
                    raise self._error(wrong, 0)
                self._updates += 1
                return _new(TwistCount, _FOUND.unpack_from(self._bytes, _FOUND_AT))
        return self._update(rotation, time)

    def _update(self, rotation: Any, time: Any) -> TwistCount:
        q = self._quaternions(rotation)
        shape = q.shape[:-1]
        if self._shape is not None and shape != self._shape:
            raise ValueError(f"rotation must have a sample for each of the streams {self._shape}, got {shape}")
        if self._shape is not None and (time is not None) != self._has_times:
            raise ValueError("time must be given at every update or at none")
        moments = as_array(self._updates if time is None else time, "time", (...,), np.inf)
        if moments.shape not in ((), shape):
            raise ValueError(f"time must be a number or have the shape {shape}, got {moments.shape}")
        if self._shape is None:
            self._lay_out(int(np.prod(shape)))
        self._given[...] = q.reshape(-1, 4)
        self._time[...] = moments.ravel()
        wrong, k = self._count()
        if wrong:
            raise self._error(wrong, k, f"[{', '.join(map(str, np.unravel_index(k, shape)))}]" if shape else "")
        self._shape, self._has_times = shape, time is not None
        self._updates += 1
        return TwistCount(self.twist, self.error_estimate)

    def _quaternions(self, rotation: Any) -> Array:
        """Return quaternions, scalar last, not finite where there is no sample."""
        motion = raw_motion(rotation, self._scalar_first)
        if np.ndim(0.0 if motion.time is None else motion.time):
            raise ValueError("rotation has times: give its samples one by one, or the whole of it to nontwist.twist")
        values = motion.values
        if values.shape[-1] == 4:
            return values
        missing = np.asarray(~np.isfinite(values).all(axis=(-2, -1)))
        q: Array = as_rotation(np.where(missing[..., None, None], np.eye(3), values), MEASURED).as_quat()
        q[missing] = np.nan
        return q

    def _error(self, wrong: int, k: int, place: str = "") -> ValueError:
        if wrong == 1:
            return ValueError(f"quaternion{place} must have the length 1, it has {np.linalg.norm(self._given[k]):.6g}")
        return ValueError(f"time{place} must increase, got {self._time[k]:g}, which is not later")

    def _column(self, k: int) -> Any:
        found = np.empty(0) if self._shape is None else self._found[:, k].reshape(self._shape)
        return float(found) if self._shape == () else found.copy()

    @property
    def twist(self) -> float | Array:
        """Twist so far, rad; 0 at the first sample."""
        return self._column(0)

    @property
    def settled(self) -> float | Array:
        """Twist at the sample before the last, rad, which later samples do not change."""
        return self._column(2)

    @property
    def error_estimate(self) -> float | Array:
        """Estimated error of the twist by sampling, rad."""
        return self._column(1)

    @property
    def flagged(self) -> int | NDArray[np.int64]:
        """Number of steps so far in which the body may have turned by half a turn or more."""
        found = self._column(3)
        return int(found) if self._shape == () else found.astype(np.int64)

    def __repr__(self) -> str:
        if self._shape is None:
            return "<TwistCounter without samples>"
        count = f"{self.twist:.6g} rad" if self._shape == () else f"{len(self._found)} streams"
        return f"<TwistCounter: {count} after {self._updates} updates, {int(self._found[:, 3].sum())} flagged>"

    def __getstate__(self) -> dict[str, Any]:
        named = ("_order", "_sign", "_scalar_first", "_triad", "_shape", "_updates", "_has_times", "_memory")
        return {name: getattr(self, name) for name in named}

    def __setstate__(self, state: dict[str, Any]) -> None:
        memory = state.pop("_memory")
        self.__dict__.update(state)
        self._lay_out(len(memory) // (9 + SIZE))
        self._memory[...] = memory

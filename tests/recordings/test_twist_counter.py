"""The live counter of twist against `twist` of the same samples, and everything that happens to live data."""

import pickle
import re
from functools import partial

import numpy as np
import pandas
import pytest
from scipy.spatial.transform import Rotation

from nontwist import TwistCounter, integrate, standard, twist
from recordings.test_twist import smooth

pytestmark = pytest.mark.filterwarnings("ignore:.*right angle:UserWarning")
counted = partial(twist, scalar_first=False)


def raw(seed, n=60):
    """Quaternions of a smooth motion, rounded to four decimals as recordings are, with random signs."""
    q = smooth(seed, n)[1].as_quat().round(4)
    return q * np.random.default_rng(seed).choice([-1, 1], size=(n, 1))


@pytest.mark.parametrize(("seed", "order", "axis_frame"), [(0, 2, "body"), (3, 4, "space")])
def test_equals_twist_after_each_sample(seed, order, axis_frame):
    """Also after a start from rest."""
    how = {"axis": np.random.default_rng(seed).normal(size=3), "order": order, "axis_frame": axis_frame}
    rest = 1e-9 * np.random.default_rng(1).normal(size=(9, 4)) + raw(2)[0]
    for q, moving in ((raw(seed, 25), 3), (np.concatenate([rest, raw(2, 10)[1:]]), 99)):
        whole, counter = counted(q, **how), TwistCounter(**how, scalar_first=False)
        for k, x in enumerate(q):
            count = counter.update(x)
            if k:
                far = counted(q[: k + 1], **how)
                assert count == (far.twist_angle.values[-1], far.error_estimate.values[-1])
            if order == 2:
                assert count.twist == whole.twist_angle.values[k]
            if k >= moving:
                assert counter.settled == whole.twist_angle.values[k - 1]


def test_wide_steps():
    """Where the frame that is extrapolated is far from the one that settles."""
    q = np.random.default_rng(1).standard_normal((99, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    whole, counter = counted(q), TwistCounter(scalar_first=False)
    settled = [(counter.update(x), counter.settled)[1] for x in q]
    assert settled[4:] == whole.twist_angle.values[3:-1].tolist()


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("size", [1e-104, 1e-300])
def test_barely_moving_axis(size, order):
    q = np.concatenate([size * np.random.default_rng(0).standard_normal((60, 2)), np.tile([0.6, 0.8], (60, 1))], axis=1)
    counter = TwistCounter(order=order, scalar_first=False)
    found = np.array([counter.update(x) for x in q])
    assert np.isfinite(found).all()
    assert found[:, 0] == pytest.approx(counted(q, order=order).twist_angle.values, abs=1e-15)


@pytest.mark.parametrize("order", [2, 4])
def test_rests_and_repetitions(order):
    """While the axis rests, nothing settles at order 4; the twist goes on."""
    R = smooth(3, 80)[1]
    held = np.repeat(R.as_quat(), np.where(np.arange(80) == 40, 30, 1), axis=0)
    spin = np.where(np.arange(109) < 40, 0, np.minimum(np.arange(109) - 40, 29)) * 0.8
    q = (Rotation.from_quat(held) * Rotation.from_rotvec(np.outer(spin, [0, 0, 1]))).as_quat()
    whole, counter = counted(q, order=order), TwistCounter(order=order, scalar_first=False)
    found = [counter.update(x).twist for x in q]
    assert found[-1] == whole.twist_angle.values[-1]
    assert found == pytest.approx(whole.twist_angle.values, abs=0.05 if order == 4 else 0)
    assert counter.settled == whole.twist_angle.values[-2]


@pytest.mark.parametrize("order", [2, 4])
def test_many_streams(order):
    q = np.stack([raw(seed) for seed in range(6)], axis=1).reshape(60, 2, 3, 4)
    many, *ones = (TwistCounter(order=order, scalar_first=False) for _ in range(7))
    for k in range(60):
        found = many.update(q[k], time=0.1 * k)
        single = [one.update(x, time=0.1 * k) for one, x in zip(ones, q[k].reshape(6, 4), strict=True)]
        assert np.array_equal(found, np.reshape(np.transpose(single), (2, 2, 3)))
    assert many.settled.ravel().tolist() == [one.settled for one in ones]
    assert (many.flagged.dtype, many.flagged.any()) == (np.int64, False)


FORMS = {
    "four numbers": lambda r: tuple(r.as_quat().tolist()),
    "an array": lambda r: r.as_quat(),
    "of single precision": lambda r: r.as_quat().astype(np.float32),
    "a Rotation": lambda r: r,
    "a matrix": lambda r: r.as_matrix(),
    "scalar first": lambda r: np.roll(r.as_quat(), 1),
    "labelled, scalar first": lambda r: pandas.Series(np.roll(r.as_quat(), 1), list("wxyz")),
}


@pytest.mark.parametrize("name", FORMS)
def test_every_form_of_one_attitude(name):
    R = smooth(1, 40)[1]
    counter = TwistCounter("y", 2, scalar_first=name.endswith("scalar first"))
    found = [counter.update(FORMS[name](r)).twist for r in R]
    precision = 1e-6 if "single" in name else 1e-12
    assert found == pytest.approx(twist(R, axis="y", order=2).twist_angle.values, abs=precision)
    assert type(found[-1]) is float


def spin(turns):
    return Rotation.from_rotvec([0, 0, 2 * np.pi * turns])


def test_gaps():
    """A steady spin of 0.1 turns in a second: what is missing for 4 s is bridged, for 6 s it is not."""
    counter, found = TwistCounter(), []
    for t in (0, 1, 2, 6, 7, 13, 14):
        count = counter.update(spin(0.1 * t), time=t)
        found.append((round(count.twist / 2 / np.pi, 14), counter.flagged))
    assert found[4:] == [(0.7, 0), (found[5][0], 1), (0.4, 1)]  # the turn that was lost


def test_missing_sample():
    counter = TwistCounter(scalar_first=False)
    q = [spin(0.15 * k).as_quat() for k in range(12)]
    for k in (2, 3):
        q[k] = [np.nan] * 4 if k == 2 else [0.0] * 4
    for x in q[:5]:
        count = counter.update(x)
    assert count.twist == pytest.approx(2 * np.pi * 0.6, abs=1e-14)
    q[5:9] = [[np.nan] * 4] * 4
    assert counter.update(q[5]) == count
    for x in q[6:10]:
        counter.update(x)
    assert counter.flagged == 1
    late = TwistCounter(scalar_first=False)
    assert late.update(np.array([[0, 0, 0, 1], [np.nan] * 4])).twist.tolist() == [0, 0]
    assert late.update(np.stack([q[1], q[1]])).twist.tolist() == [pytest.approx(0.3 * np.pi), 0]
    assert late.update(np.stack([q[4], q[4]])).twist.tolist() == pytest.approx([1.2 * np.pi, 0.9 * np.pi])


@pytest.mark.parametrize("order", [2, 4])
def test_half_turn_of_the_axis(order):
    counter = TwistCounter(order=order)
    for k in range(4):
        count = counter.update(Rotation.from_rotvec([0.1 * k, 0, 0]) * spin(0.1 * k))
    over = Rotation.from_rotvec([np.pi + 0.3, 0, 0])
    assert counter.update(over * spin(0.3)).twist == count.twist
    assert counter.flagged == 1
    assert counter.update(over * spin(0.4)).twist == pytest.approx(count.twist + 0.2 * np.pi, abs=1e-12)
    assert counter.flagged == 1


def last():
    """A counter, of which 2 s and 3 s are counted."""
    counter = TwistCounter(scalar_first=False)
    counter.update((0, 0, 0, 1), time=2)
    counter.update((0, 0, 0.6, 0.8), time=3)
    return counter


def state(counter):
    return repr(counter), np.append(counter.twist, counter.error_estimate).tolist()


def two():
    """A counter of two streams, of which the second is at 1 s."""
    many = TwistCounter(scalar_first=False)
    many.update(np.eye(4)[[3, 3]], time=[0, 1])
    return many


ONE, PAIR, NEXT = (0, 0, 0.6, 0.8), np.eye(4)[[3, 3]], {"time": 4}
WRONG_COUNTERS = [
    ({"axis": (0, 0, 0)}, "axis is zero"),
    ({"order": 3}, "order must be 2 or 4, got 3"),
    ({"axis_frame": "sky"}, "axis_frame must be 'body' or 'space', got 'sky'"),
    ({"scalar_first": "w"}, "scalar_first must be True or False, got 'w'"),
]
WRONG_UPDATES = [
    (TwistCounter, (0, 0, 0, 1), {}, "quaternions need scalar_first=True (w, x, y, z) or"),
    (TwistCounter, np.diag([1.0, 1, -1]), {}, "rotation is left-handed"),
    (last, ONE, {"time": 3}, "time must increase, got 3, which is not later"),
    (last, ONE, {}, "time must be given at every update or at none"),
    (last, (0, 0, 0.6, 0.9), NEXT, "quaternion must have the length 1, it has 1.08167"),
    (last, np.eye(4), NEXT, "rotation must have a sample for each of the streams (), got (4,)"),
    (TwistCounter, integrate(standard([3, 4, 5]), t_end=1), {}, "rotation has times: give its samples one by one"),
    (last, ("a", 0, 0, 1), NEXT, "the motion must consist of numbers"),
    (last, ONE, {"time": "noon"}, "time must consist of numbers"),
    (last, ONE, {"time": np.nan}, "time"),
    (two, PAIR, {"time": [1, 1]}, "time[1] must increase, got 1"),
    (two, PAIR, {"time": [1, 2, 3]}, "time must be a number or have the shape (2,)"),
    (two, 2 * PAIR, {"time": 5}, "quaternion[0] must have the length 1, it has 2"),
]


def test_errors_count_nothing():
    for how, told in WRONG_COUNTERS:
        with pytest.raises(ValueError, match=f"^{re.escape(told)}"):
            TwistCounter(**how)
    for make, rotation, time, told in WRONG_UPDATES:
        counter = make()
        before = state(counter)
        with pytest.raises(ValueError, match=f"^{re.escape(told)}"):
            counter.update(rotation, **time)
        assert state(counter) == before
    tiny = TwistCounter((0, 3e-200, 4e-200)), TwistCounter((0, 0.6, 0.8))  # whose squares underflow
    assert len({[one.update(R) for R in Rotation.random(9, rng=1)][-1] for one in tiny}) == 1


def test_pickle_and_reset():
    counter, q = TwistCounter("x", scalar_first=False), raw(4)
    for x in q[:30]:
        counter.update(x)
    kept = pickle.loads(pickle.dumps(counter))
    assert [kept.update(x) for x in q[30:]] == [counter.update(x) for x in q[30:]]
    assert re.fullmatch(r"<TwistCounter: -?\d\S* rad after 60 updates, 0 flagged>", repr(counter))
    counter.reset()
    assert repr(counter) == "<TwistCounter without samples>"
    assert counter.update(np.eye(4)).twist.tolist() == [0, 0, 0, 0]

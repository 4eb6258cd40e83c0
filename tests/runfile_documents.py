"""Generated run files: mostly right, often with something wrong in them."""

from copy import deepcopy

import numpy as np
from hypothesis import strategies as st

from nontwist.integrators import INTEGRATORS
from nontwist.models.bodies import BODIES

WORDS = st.sampled_from(["body", "space", "standard", "pulse", "split", "wxyz", "", "é\u0007", "1e400"])
ANY_NUMBER = st.one_of(st.floats(), st.integers(-(10**30), 10**400))
NICE = st.floats(-10, 10).map(lambda x: round(x, 3))
POSITIVE = st.floats(0.001, 10).map(lambda x: round(x, 3))
GARBAGE = st.one_of(ANY_NUMBER, WORDS, st.booleans(), st.just([]), st.just({}), st.lists(ANY_NUMBER, max_size=4))
VECTOR, SIZES = (st.lists(numbers, min_size=3, max_size=3) for numbers in (NICE, POSITIVE))
table = st.fixed_dictionaries
one_of = st.sampled_from


@st.composite
def bodies(draw):
    """Of a kind's own sample; with other moments of inertia, or of a cuboid, and at times with a weight."""
    kind = draw(one_of([*BODIES]))
    body = {"kind": kind, **{key: np.array(value).tolist() for key, value in BODIES[kind].sample.items()}}
    a, b, c = draw(SIZES)
    cuboid = {"cuboid": {"mass": draw(POSITIVE), "lengths": [a, b, c]}}
    shapes = [body["inertia"], [b + c, a + c, a + b]] + [cuboid] * ("mass" not in BODIES[kind].takes)
    body["inertia"] = draw(one_of(shapes))
    if body["inertia"] is not cuboid and draw(st.booleans()):
        body |= {"mass": draw(one_of([0.001, 0.1])), "centre_of_mass": [x / 100 for x in draw(VECTOR)]}
    return body


ROTATIONS = (
    table({"quaternion": st.just([1.0, 0, 0, 0]), "order": st.just("xyzw")}),
    table({"vector": VECTOR, "unit": one_of(["radians", "degrees"])}),
    table({"euler": VECTOR, "sequence": one_of(["ZYX", "xyz", "ZXZ"]), "unit": st.just("degrees")}),
)
VELOCITIES = (table({frame: VECTOR}) for frame in ("body", "space"))
STARTS = table(
    {
        "rotation": st.one_of(*ROTATIONS),
        "angular_velocity": st.one_of(*VELOCITIES),
        "project": one_of([True] * 9 + [False]),
    }
)


def load(kind, **keys):
    frame = {"frame": one_of(["body", "space"])} if kind not in ("damping", "rotor") else {}
    return table({"kind": st.just(kind), **frame, **keys})


LOADS = (
    load("constant", moment=VECTOR),
    load("table", times=POSITIVE.map(lambda t: [0.0, t]), values=st.lists(VECTOR, min_size=2, max_size=2)),
    load("pulse", amplitude=VECTOR, end=POSITIVE),
    load("sine", amplitude=VECTOR, frequency=POSITIVE),
    load("damping", coefficient=POSITIVE),
    load("rotor", axis=st.just([0.0, 1.0, 1.0]), momentum=POSITIVE),
)


@st.composite
def documents(draw):
    """A document, with up to three of its values put wrong."""
    t_end, steps = draw(one_of([1, 2, 0.5, 1e-3])), draw(st.integers(1, 40))
    name = draw(one_of([*["gauss", "lie-midpoint", "energy-momentum"] * 4, *INTEGRATORS]))
    orders = INTEGRATORS[name].orders
    data = {
        "body": draw(bodies()),
        "start": draw(STARTS),
        "load": draw(st.lists(st.one_of(*LOADS), max_size=2)),
        "time": {"t_end": t_end, "step": t_end / steps, "store": draw(one_of([1, 1, 3, "end"]))},
        "integrator": {"name": name} | ({"order": draw(one_of(orders))} if orders else {}),
    }
    data = deepcopy(data)  # parts of which are the same objects in every document
    for _ in range(draw(one_of([0] * 11 + [1, 1, 3]))):
        _spoil(draw, data)
    return data


def _spoil(draw, data):
    """Put one value of the document wrong, or only extreme, or take it away, or add a key."""
    place = data
    while keys := list(place) if isinstance(place, dict) else list(range(len(place))):
        key = draw(one_of(keys))
        if isinstance(place[key], (dict, list)) and draw(st.integers(0, 5)):
            place = place[key]
            continue
        what = draw(one_of(["garbage", "garbage", "number", "number", "take", "add"]))
        if what == "take":
            del place[key]
        elif what == "add" and isinstance(place, dict):
            place[draw(one_of(["kindd", "x", "a b", "order", "mass"]))] = draw(GARBAGE)
        else:
            place[key] = draw(ANY_NUMBER if what == "number" else GARBAGE)
        return

"""Generated run files: mostly right, often with something wrong in them."""

import math

from hypothesis import strategies as st

from nontwist.integrators import INTEGRATORS
from nontwist.models.bodies import BODIES

WORDS = st.sampled_from(["body", "space", "standard", "pulse", "split", "wxyz", "", "é\u0007", "1e400"])
ANY_NUMBER = st.one_of(st.floats(), st.integers(-(10**30), 10**400))
NICE = st.floats(-10, 10).map(lambda x: round(x, 3))
POSITIVE = st.floats(0.001, 10).map(lambda x: round(x, 3))
GARBAGE = st.one_of(ANY_NUMBER, WORDS, st.booleans(), st.just([]), st.just({}), st.lists(ANY_NUMBER, max_size=4))
ROUND_NUMBERS = st.sampled_from([1, 2, 0.5, 1e-3])


def vectors(numbers=NICE):
    return st.lists(numbers, min_size=3, max_size=3)


@st.composite
def inertias(draw):
    """Of a body that exists: from a second moment of mass that is positive definite."""
    a, b, c = (draw(POSITIVE) for _ in range(3))
    principal = [b + c, a + c, a + b]
    if draw(st.booleans()):
        return principal
    s = draw(st.floats(-0.9, 0.9)) * math.sqrt(a * b)
    return [[principal[0], -s, 0.0], [-s, principal[1], 0.0], [0.0, 0.0, principal[2]]]


@st.composite
def bodies(draw):
    kind = draw(st.sampled_from([*BODIES]))
    body = {"kind": kind, "inertia": draw(inertias())}
    if "axis" in BODIES[kind].takes:
        body["axis"] = draw(vectors())
    if "mass" not in BODIES[kind].takes and draw(st.sampled_from([False] * 4 + [True])):
        body["inertia"] = {"cuboid": {"mass": draw(POSITIVE), "lengths": draw(vectors(POSITIVE))}}
    elif "mass" in BODIES[kind].takes or draw(st.booleans()):
        body |= {"mass": draw(st.sampled_from([0.001, 0.1])), "centre_of_mass": draw(vectors(st.floats(-0.1, 0.1)))}
    return body


@st.composite
def starts(draw):
    quaternion = [1.0, 0.0, 0.0, 0.0]
    rotation = draw(
        st.one_of(
            st.just({"quaternion": quaternion, "order": "xyzw"}),
            st.fixed_dictionaries({"vector": vectors(), "unit": st.sampled_from(["radians", "degrees"])}),
            st.fixed_dictionaries(
                {"euler": vectors(), "sequence": st.sampled_from(["ZYX", "xyz", "ZXZ"]), "unit": st.just("degrees")}
            ),
        )
    )
    velocity = {draw(st.sampled_from(["body", "space"])): draw(vectors())}
    return {"rotation": rotation, "angular_velocity": velocity, "project": draw(st.sampled_from([True] * 9 + [False]))}


@st.composite
def loads(draw):
    kind = draw(st.sampled_from(["constant", "table", "pulse", "sine", "damping", "rotor"]))
    if kind == "damping":
        return {"kind": kind, "coefficient": draw(POSITIVE)}
    if kind == "rotor":
        return {"kind": kind, "axis": [0.0, 1.0, 1.0], "momentum": draw(POSITIVE)}
    load = {"kind": kind, "frame": draw(st.sampled_from(["body", "space"]))}
    if kind == "constant":
        load["moment"] = draw(vectors())
    elif kind == "table":
        load |= {"times": [0.0, draw(POSITIVE)], "values": [draw(vectors()), draw(vectors())]}
    elif kind == "pulse":
        load |= {"amplitude": draw(vectors()), "end": draw(POSITIVE)}
    else:
        load |= {"amplitude": draw(vectors()), "frequency": draw(POSITIVE)}
    return load


def fitting(body, forces):
    """Return the integrators that take this body under these loads."""
    found = ["gauss", "lie-midpoint", "energy-momentum"]
    if body["kind"] != "suslov" and all(load["kind"] != "rotor" for load in forces):
        found.append("split")
    if body["kind"] in ("standard", "nontwisting") and "mass" not in body and not forces:
        found.append("exact")
    return found


@st.composite
def documents(draw):
    """A document, with up to three of its values put wrong."""
    t_end, steps = draw(ROUND_NUMBERS), draw(st.integers(1, 40))
    body, forces = draw(bodies()), draw(st.lists(loads(), max_size=2))
    name = draw(st.sampled_from([*fitting(body, forces) * 3, *INTEGRATORS]))
    orders = INTEGRATORS[name].orders
    data = {
        "body": body,
        "start": draw(starts()),
        "load": forces,
        "time": {"t_end": t_end, "step": t_end / steps, "store": draw(st.sampled_from([1, 1, 3, "end"]))},
        "integrator": {"name": name} | ({"order": draw(st.sampled_from(orders))} if orders else {}),
    }
    for _ in range(draw(st.sampled_from([0] * 8 + [1, 1, 3]))):
        _spoil(draw, data)
    return data


def _spoil(draw, data):
    """Put one value of the document wrong, or only extreme, or take it away, or add a key."""
    place = data
    while True:
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        if not keys:
            return
        key = draw(st.sampled_from(keys))
        if isinstance(place[key], (dict, list)) and draw(st.integers(0, 5)):
            place = place[key]
            continue
        what = draw(st.sampled_from(["garbage", "garbage", "number", "number", "take", "add"]))
        if what == "take":
            del place[key]
        elif what == "add" and isinstance(place, dict):
            place[draw(st.sampled_from(["kindd", "x", "a b", "order", "mass"]))] = draw(GARBAGE)
        else:
            place[key] = draw(ANY_NUMBER if what == "number" else GARBAGE)
        return

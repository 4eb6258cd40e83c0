"""What every run promises: integrator × body × load, each cell with the same promises, or refused for a reason.

Bodies, loads and integrators are those of `covering.problems`, wheels, memory and dry friction, and those that are
registered when the tests begin. In the quick suite each load meets gauss and a sixth of the other integrators, with a
body that changes; the long suite has more.
"""

import numpy as np
import pytest

import nontwist as nt
from covering.problems import ASKEW, BODIES, LOADS, W, made_load, schemes
from nontwist.integrators import INTEGRATORS
from nontwist.models.bodies import BODIES as KINDS

OWN = {name: kind for name, kind in KINDS.items() if not kind.make.__module__.startswith("nontwist.")}  # at run time
SCHEMES = schemes() | {
    " ".join([name, str(getattr(one, "order", ""))]).strip(): one
    for name, kind in INTEGRATORS.items()
    if not kind.__module__.startswith("nontwist.")
    for one in kind.variants()
}
QUICK = ["energy-momentum 2", "lie-midpoint 2", "energy-momentum 1 dissipative", "split 4", "exact", "continuous"]
QUICK += SCHEMES.keys() - schemes().keys()
STEP, COUNT = 1 / 4, 6
START = {"rotation": ASKEW, "material_angular_velocity": W, "project": True}
BODY_MOMENT, SPACE_MOMENT = (0.9, -0.4, 0.7), (0.3, 0.5, -0.2)  # that a stepper is given in each step


def made(name, factor=1.0):
    """Return a body, with its inertia times a factor."""
    if name not in OWN:
        return BODIES[name](factor)
    one = OWN[name].make(**OWN[name].sample)
    return nt.DirectorSystem(factor * one.euler_inertia, one.axis, one.dead_force, name=one.name)


SYSTEMS = {name: made(name) for name in [*BODIES, *OWN]}
HEAVY = {name for name, system in SYSTEMS.items() if system.dead_force.any()}
SPINNING = {name for name, system in SYSTEMS.items() if system.spin is not None}
HELD = {name for name, system in SYSTEMS.items() if system.axis is not None}
PRINCIPAL = {
    name for name in HELD if np.allclose(np.cross(SYSTEMS[name].inertia @ SYSTEMS[name].axis, SYSTEMS[name].axis), 0)
}


def fading(t, z, d, w):
    return 0.5 * w[0] - z[0], 0.3 * d[1, 2] - 0.1 * z[1] * z[0]


def remembered(t, z, d, w):
    return -0.2 * z[0], 0.1 * z[1] * w[2], 0.3


MOTOR = [0.2, 0.7, 1.3], [0, 0.5, -0.3]
MORE = {
    "wheels": nt.wheel((1, 1, 0), 0.2, 3, 0.1) + nt.wheel((1, -1, 1), 0.1, -2, MOTOR),
    "rubbing wheel": nt.wheel((1, 1, 0), 0.2, 3, 0.1, viscous=0.05),
    "dry wheel": nt.wheel((1, 1, 0), 0.2, 0.2, coulomb=0.05),
    "memory": nt.memory_load(fading, remembered, [0.3, -0.2], compiled=True),
    "dry friction": nt.dry_friction(0.9, (1, 0.2, 0)),
}
WHEELS = ["wheels", "rubbing wheel", "dry wheel"]
STEPPED = ("gauss", "lie-midpoint", "energy-momentum")
NOT_STEPPED = {("gauss 4", load) for load in [*LOADS][1::2]}  # by a stepper, which compiles its own steps
REMEMBERING = {"rubbing wheel", "dry wheel", "memory"}


def load_of(name):
    return MORE.get(name) or made_load(name)


POTENTIALS = {name for name in LOADS if made_load(name).potentials}
BY_COEFFICIENTS = {"linear", "quadratic", "spring", "dipole"}  # of the components of directors, at most quadratic
ROTORS = {"rotor", "rotor table", "sum", "wheels"}
FACTORED = POTENTIALS | {load for load in LOADS if "force" in load} | {"rotor table"}  # scaled before or after a sum
RESUMED = {
    "split": 1e-14,
    "exact": 1e-14,
    "continuous": 1e-10,
}  # how far off runs are that resume; others have the bits


def refusal(scheme, body, load):
    """Return words of the refusal of a cell, or None where it runs."""
    name = scheme.split()[0]
    if load in REMEMBERING and (name not in STEPPED or (name == "lie-midpoint" and scheme.endswith("dissipative"))):
        return "does not take " + ("loads with memory" if load == "memory" else "wheels with friction")
    if load in ("dry friction", "dry wheel") and name not in ("gauss", "lie-midpoint"):
        return "needs an integrator that splits its steps"
    if load in ("dry friction", "dry wheel") and body in SPINNING:
        return "does not act on a body whose spin is prescribed"
    if load == "dry friction" and scheme.endswith("dissipative"):
        return "dissipation= is not possible"
    if load == "wheels" and body in SPINNING:  # without their inertia
        return "spin= needs an axis that is principal"
    if name == "exact":
        is_held_about_d3 = body in PRINCIPAL and SYSTEMS[body].axis[2] == 1
        is_free = body not in HEAVY | SPINNING and (
            (body not in HELD and load in ("none", "rotor")) or (is_held_about_d3 and load == "none")
        )
        return None if is_free else "closed-form solution|prescribed spin"
    if name == "split" and load in ROTORS:
        return "does not accept rotors and wheels"
    if name in ("split", "energy-momentum") and body in SPINNING:
        return "does not accept a prescribed spin"
    if name == "split" and body in HELD - PRINCIPAL:
        return "needs a constrained axis that is principal"
    if scheme.endswith("dissipative") and body in HELD:
        return "has no dissipation for a body with a constrained axis"
    return None


def keeps_energy(scheme, body, load):
    """Whether K + V changes by the work of the load alone, to round-off."""
    if body in SPINNING or load == "gravity gradient" or scheme.endswith("dissipative"):
        return False
    if scheme.startswith("split"):
        return body not in HEAVY and load not in POTENTIALS
    return not scheme.startswith("gauss") or load not in POTENTIALS - BY_COEFFICIENTS


def cells(names, offsets, every=1):
    """Yield cells of these integrators: every so manieth load, with a body so many places on in their list."""
    bodies, loads = list(SYSTEMS), [*LOADS, *MORE]
    for i, scheme in enumerate(names):
        for k in range(i % every, len(loads), every):
            for offset in offsets:
                yield scheme, bodies[(k + offset) % len(bodies)], loads[k]


MARKED = [
    *cells(["gauss 4"], (0,)),
    *cells(QUICK, (0,), 6),
    *(pytest.param(*cell, marks=pytest.mark.long) for cell in cells(SCHEMES, (4,))),
]


@pytest.mark.parametrize(("scheme", "body", "load"), MARKED)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_cell(scheme, body, load):
    system, kind = SYSTEMS[body], SCHEMES[scheme]
    how = {"t_end": STEP * COUNT, "step": STEP, "integrator": kind, "load": load_of(load)}
    words = refusal(scheme, body, load)
    if words:
        for call in (nt.integrate, nt.simulate_ensemble, prepared):
            with pytest.raises(ValueError, match=words):
                call(system, **START, **how)
        return
    run = nt.integrate(system, **START, **how)
    require_balances(run, scheme, body, load)
    require_same_run(prepared(system, **START, **how, store=1), run)
    if load != "gravity gradient":  # which needs equal inertias
        require_members(run, body, load, how)
    half = nt.integrate(system, **START, **how | {"t_end": STEP * COUNT / 2})
    rest = nt.integrate(system, start=half, project=True, **how)
    gap = abs(rest.directors - run.directors[COUNT // 2 :]).max()
    is_near = load in ("wheels", "dry friction") or (load == "dry wheel" and kind.name != "gauss")
    assert gap <= RESUMED.get(kind.name, 1e-14 if is_near else 0)  # marches in pieces begin without first guesses
    if kind.name in STEPPED and (scheme, load) not in NOT_STEPPED:
        require_steps(system, how)


def require_balances(run, scheme, body, load):
    data, h = run.to_dataset(), np.diff(run.time)
    bound = 1e-10 if scheme == "continuous" else 1e-13
    assert data.orthonormality_defect.max() < bound
    if body in HELD - SPINNING and not scheme.startswith("energy-momentum"):  # which has the constraint in the mean
        assert abs(run.material_angular_velocity @ run.system.axis).max() < bound
    energy = (data.kinetic_energy + data.potential_energy).values
    if keeps_energy(scheme, body, load):
        assert np.diff(energy) == pytest.approx(run.load_work, abs=10 * bound)
    if body not in HELD | HEAVY and load in ("none", "rotor", "rotor table"):
        total = nt.rotation(data).apply(data.get("rotor_momentum", np.zeros(3)) + data.material_momentum.values)
        assert abs(total - total[0]).max() < 10 * bound
    if body not in HELD | HEAVY and load in WHEELS:
        assert np.ptp(data.total_momentum.values, axis=0).max() < 10 * bound
    if load == "dry friction":
        assert data.dissipated_energy.values.min() >= -1e-15
        assert data.dissipated_energy.values.sum() == pytest.approx(-run.load_work.sum(), abs=bound)
    if load in ("rubbing wheel", "dry wheel"):
        assert np.diff(data.wheel_loss.values, axis=0).min() >= 0
    if body not in HELD | HEAVY and load not in POTENTIALS:
        momentum = data.spatial_momentum.values
        assert np.diff(momentum, axis=0) == pytest.approx(h[:, None] * run.moment, abs=10 * bound)


def prepared(system, rotation, material_angular_velocity, load_scale=1.0, **how):
    start = {"rotation": rotation, "material_angular_velocity": material_angular_velocity}
    return nt.propagator(system, **how)(**start, load_scale=load_scale)


def require_same_run(found, run):
    """Require the same bits of two runs."""
    for name in ("time", "quaternion", "material_angular_velocity", "multipliers", "moment", "load_work", "memory"):
        one, other = getattr(found, name), getattr(run, name)
        assert (one is None and other is None) or np.array_equal(one, other), name
    assert found.to_dataset().identical(run.to_dataset())


def require_members(run, body, load, how):
    """Require of members the bits of runs, whoever is in their lanes and whatever the scales of their loads.

    Member 1 is the run, member 8 that of the load times 0.7; so is a call of a propagator with this scale. Solvers of
    SciPy, which have no lanes, get these two alone.
    """
    some = np.array([1, 8]) if how["integrator"].name == "continuous" else np.arange(9)
    factors = np.array([1.2, 1, 0.9, 1, 1.1, 1, 1, 1.3, 1])[some]
    start = START | {"material_angular_velocity": W * np.where(factors == 1, 1, 0.5)[:, None]}
    how, scales = how | {"store": 3}, np.array([0.6, 1, 0.5 if load == "dry friction" else -0.5, 1, 1, 0, 2, 1, 0.7])
    stack = nt.DirectorSystem.stack([made(body, c) for c in factors])
    many = nt.simulate_ensemble(stack, **start, **how, load_scale=scales[some], variables="all", threads=2)
    many = many.assign_coords(member=some)
    scaled = nt.integrate(run.system, **START, **how | {"load": 0.7 * how["load"]})
    bound = 1e-12 if load in FACTORED else 0
    if len(how["load"].terms) == 1 and not bound:
        require_same_run(prepared(run.system, **START, **how, load_scale=0.7), scaled)
    whole = run.to_dataset().isel(time=slice(None, None, 3))
    for member, one, rounding in ((1, whole, 0), (8, scaled.to_dataset(), bound)):
        shared = [name for name in many.data_vars if name in one and one[name].dims[0] == "time"]
        assert len(shared) >= 10
        for name in shared:
            sums = load == "wheels" and name in ("wheel_work", "internal_state")  # over intervals of the output
            near = max(rounding, 1e-14) if sums else rounding
            np.testing.assert_allclose(many[name].sel(member=member).values, one[name].values, rtol=near, atol=near)
            assert many[name].attrs == one[name].attrs
        assert many.attrs["integrator"] == one.attrs["integrator"]


def require_steps(system, how):
    """Require of a stepper the states of a run under the load and constant moments, and their work.

    To the bit where both add the moments in the same order, to round-off in gauss.
    """
    constant = nt.body_moment(lambda t: BODY_MOMENT) + nt.space_moment(lambda t: SPACE_MOMENT)
    run = nt.integrate(system, **START, **how | {"load": how["load"] + constant})
    loop = nt.stepper(system, STEP, integrator=how["integrator"], load=how["load"])
    loop.reset(**START)
    states = [loop.step(BODY_MOMENT, SPACE_MOMENT) for _ in range(COUNT)]
    assert [state.time for state in states] == run.time[1:].tolist()
    found = np.array([[*state.quaternion, *state.material_angular_velocity, state.load_work] for state in states])
    known = np.column_stack([run.quaternion[1:], run.material_angular_velocity[1:], run.load_work])
    gap = abs(abs(found) - abs(known)).max()  # a run chooses the signs of quaternions
    is_marched = how["load"].wheels or how["load"].is_dry
    bound = 1e-14 if how["integrator"].name == "gauss" or is_marched else 0
    assert gap <= bound
    if system.axis is not None:
        reaction = np.array([state.reaction_moment for state in states]) + run.multipliers[:, -1]
        assert abs(reaction).max() <= 10 * bound

"""Ctrl-C: what was marched is kept, bit for bit as the whole run has it."""

import contextlib
import pickle
import re
import signal
from itertools import pairwise

import numpy as np
import pytest

from conftest import BODIES
from nontwist import heavy_top, integrate, moment, pulse, simulate, sine
from nontwist.driver import single_run
from nontwist.driver.notices import sigterm_interrupts
from nontwist.errors import SimulationInterrupt, Status
from nontwist.integrators import Continuous, marched_stacks, split, stack_march
from nontwist.validation.compiled_steps import ReferenceEnergyMomentum

STEP = 2.0**-7
HOW = {"t_end": 1.0, "step": STEP, "angular_velocity": [1, -2, 0.5], "project": True}
FIRST = pulse([3, -1, 0], 0.0, 0.125)
LOAD = pulse([3, -1, 2], 0.0, 1.0) + sine([0.5, 0, 1], 2, frame="space")
QUANTITIES = "multipliers", "moment", "load_work", "newton_iterations"


@pytest.fixture
def interrupted_in(monkeypatch):
    """March in blocks of 20 steps; Ctrl-C strikes when the kernel has done its third, before that is counted."""

    def prepare(order):
        stages = len(split.substep_nodes(order))
        monkeypatch.setattr(stack_march, "NODES", 20 * stages)
        monkeypatch.setattr(marched_stacks, "KEPT_NODES", 0)  # marches so short are laid out once, and not interrupted
        sound, calls = stack_march.StackMarch._run, []

        def struck(*arguments):
            result = sound(*arguments)
            calls.append(1)
            if len(calls) == 3:
                raise KeyboardInterrupt
            return result

        monkeypatch.setattr(stack_march.StackMarch, "_run", struck)

    return prepare


@pytest.mark.parametrize(("name", "store"), [("lie-midpoint", 1), ("energy-momentum", 7), ("split", "end")])
def test_part_of_the_whole_run(interrupted_in, monkeypatch, name, store):
    body = BODIES["nontwisting"]()
    scheme = {"step": STEP, "load": LOAD, "integrator": name, "order": 2}
    whole = integrate(body, **HOW | scheme)
    interrupted_in(2)
    with pytest.raises(SimulationInterrupt, match=r"^interrupted at t = 0\.3125 s, after 40 of 128 steps$") as info:
        integrate(body, store=store, **HOW | scheme)
    monkeypatch.undo()
    partial, copy = info.value.partial, pickle.loads(pickle.dumps(info.value))
    assert isinstance(copy, KeyboardInterrupt)
    assert (str(copy), copy.partial.message) == (str(info.value), partial.message)
    assert np.array_equal(copy.partial.directors, partial.directors)
    stored = {1: list(range(41)), 7: [0, 7, 14, 21, 28, 35, 40], "end": [0, 40]}[store]
    assert partial.status == Status.INTERRUPTED
    assert np.array_equal(partial.time, np.array(stored) * STEP)
    assert np.array_equal(partial.directors, whole.directors[stored])
    size = abs(whole.director_velocities).max()
    assert partial.director_velocities == pytest.approx(whole.director_velocities[stored], abs=1e-15 * size)
    for quantity, over in zip(QUANTITIES, (np.mean, np.mean, np.sum, np.max), strict=True):
        expected = np.array([over(getattr(whole, quantity)[a:b], axis=0) for a, b in pairwise(stored)])
        assert getattr(partial, quantity) == pytest.approx(expected, rel=1e-12, abs=1e-13), quantity
    data = partial.to_dataset()
    assert data.attrs["status"] == 6
    assert data.attrs["message"] == str(info.value)
    rest = integrate(body, start=partial, t_end=1.0, **scheme)
    assert np.array_equal(rest.directors[-1], whole.directors[-1])


@pytest.mark.parametrize(
    ("body", "more", "store", "steps"),
    [("standard", [], 1, 36), ("standard", [pulse([1, 2, 0], 0.75, 1.0)], "end", 40)],
)
def test_exact_motion_without_moments(interrupted_in, monkeypatch, body, more, store, steps):
    """After the load it pauses after so many stored states, 20 here; between loads as it does everywhere."""
    scheme = {"t_end": 1.0, "step": STEP, "load": sum(more, FIRST), "integrator": "split", "order": 2}
    whole = integrate(BODIES[body](), **HOW | scheme)
    interrupted_in(2)
    with pytest.raises(SimulationInterrupt, match=rf"after {steps} of 128 steps$") as info:
        integrate(BODIES[body](), **HOW | scheme, store=store)
    partial = info.value.partial
    assert np.array_equal(partial.directors, whole.directors[: steps + 1 : 1 if store == 1 else steps])
    monkeypatch.undo()
    rest = integrate(BODIES[body](), start=partial, **scheme)
    assert rest.directors[-1] == pytest.approx(whole.directors[-1], abs=1e-14)


def test_outputs_end_with_last_step(interrupted_in, monkeypatch):
    times, scheme = np.linspace(0, 1, 70), {"step": STEP, "load": LOAD, "integrator": "gauss", "order": 4}
    how = {name: HOW[name] for name in ("angular_velocity", "project")} | scheme
    body = BODIES["nontwisting"]()
    whole, steps = integrate(body, times=times, **how), integrate(body, t_end=1.0, **how)
    interrupted_in(4)
    with pytest.raises(SimulationInterrupt, match=r"after 100 of 128 steps$") as info:
        integrate(body, times=times, **how)
    monkeypatch.undo()
    partial, passed, end = info.value.partial, times[times < 100 * STEP], 100 * STEP
    assert partial.time.tolist() == [*passed, end]
    assert np.array_equal(partial.directors, [*whole.directors[: passed.size], steps.directors[100]])
    assert partial.load_work[:-1] == pytest.approx(whole.load_work[: passed.size - 1], rel=1e-12)
    assert partial.load_work.sum() == pytest.approx(steps.load_work[:100].sum(), rel=1e-12)
    impulse = np.diff(partial.time) @ partial.moment
    assert impulse == pytest.approx(STEP * steps.moment[:100].sum(axis=0), rel=1e-12)


def test_continuous():
    def load(t, d, w):
        if t > 0.6:
            raise KeyboardInterrupt
        return [0.0, 0.0, 1.0]

    how = {"t_end": 1.0, "step": 0.05, "angular_velocity": [1, -2, 0.5], "load": moment(load)}
    with pytest.raises(SimulationInterrupt, match=r"^interrupted at t = 0\.\d+ s") as info:
        integrate(BODIES["standard"](), integrator=Continuous(method="RK45", rtol=1e-6), **how)
    partial = info.value.partial
    assert 3 <= partial.time.size <= 13
    assert partial.time == pytest.approx(np.arange(partial.time.size) * 0.05)
    assert partial.moment[:, 2] == pytest.approx(1)


@pytest.mark.parametrize("by", ["", "interrupted (SIGHUP)"])
def test_dataset_is_interrupted(by, monkeypatch):
    def struck(*arguments):
        raise KeyboardInterrupt(by)

    monkeypatch.setattr("nontwist.analysis.trajectory.observables_of_one", struck)
    with pytest.raises(SimulationInterrupt, match=f"^{re.escape(by or 'interrupted')} while") as info:
        simulate(BODIES["standard"](), **HOW)
    assert info.value.partial.status == Status.OK
    assert info.value.partial.time.size == 129


STOPS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


@pytest.fixture
def handlers():
    """The handlers of these signals outside of the block; one that reaches them fails the test, and ends nothing."""

    def missed(number, frame):
        raise AssertionError(f"signal {number} was not caught")

    before = {number: signal.signal(number, missed) for number in STOPS}
    yield {number: signal.getsignal(number) for number in STOPS}
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", STOPS)
def test_later_signals_are_ignored(number, handlers):
    """One that is ignored stays so."""
    with sigterm_interrupts():
        with pytest.raises(KeyboardInterrupt, match=rf"^interrupted \({number.name}\)$"):
            signal.raise_signal(number)
        for another in STOPS:
            signal.raise_signal(another)
    assert {one: signal.getsignal(one) for one in STOPS} == handlers
    signal.signal(number, signal.SIG_IGN)
    with sigterm_interrupts():
        signal.raise_signal(number)
    assert signal.getsignal(number) == signal.SIG_IGN


@pytest.mark.parametrize(
    ("name", "number"), [*zip(["lie-midpoint", "split", "continuous", "reference"], 2 * STOPS, strict=False)]
)
def test_the_message_names_the_signal(name, number, handlers, monkeypatch):
    """The signal comes when progress is reported, after a block or step, or when the load is asked for."""
    monkeypatch.setattr(stack_march, "NODES", 20)
    monkeypatch.setattr(marched_stacks, "KEPT_NODES", 0)

    @contextlib.contextmanager
    def signalling(steps):
        yield lambda done: signal.raise_signal(number)

    monkeypatch.setattr(single_run, "progress_bar", signalling)
    load = moment(lambda t, d, w: signal.raise_signal(number)) if name == "continuous" else None
    how = HOW | {"integrator": ReferenceEnergyMomentum() if name == "reference" else name, "progress": True}
    with pytest.raises(SimulationInterrupt) as info, sigterm_interrupts():
        integrate(BODIES["nontwisting"](), load=load, **how)
    assert re.match(rf"interrupted \({number.name}\) at t = [\d.]+ s, after \d+ of \d+ steps$", str(info.value))
    assert info.value.partial.message == str(info.value)


@pytest.mark.parametrize("strikes", [1, 3])
def test_chosen_steps(monkeypatch, strikes):
    """While steps are chosen nothing more is marched; in the run that stores states between them these are kept."""
    how = {"t_end": 5, "material_angular_velocity": (1, 2, 3)}
    body, sound, calls = heavy_top([3, 4, 5], 1.0, (0, 0, 0.2)), stack_march.StackMarch._run, []
    whole = simulate(body, **how)

    def struck(*arguments):
        calls.append(1)
        result = sound(*arguments)
        if len(calls) == strikes:
            raise KeyboardInterrupt
        return result

    monkeypatch.setattr(stack_march, "NODES", 20 if strikes == 1 else 2**17)
    monkeypatch.setattr(marched_stacks, "KEPT_NODES", 0)
    monkeypatch.setattr(stack_march.StackMarch, "_run", struck)
    with pytest.raises(SimulationInterrupt) as info:
        simulate(body, **how)
    assert len(calls) <= strikes + 1  # and the last state is written
    assert info.value.partial.time[-1] <= whole.time[-1]

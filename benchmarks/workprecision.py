"""The time to reach an error of the attitude at t = 5, package and other tools side by side.

Propagators are timed: body, load and steps are prepared, as with other tools. For every method the setting (step or
tolerance) is refined around each target error; the time is the shortest of those measured. A call takes 4 to 8 µs in
addition to its steps. `continuous` is SciPy's DOP853, in Python: a cross-check that shares no code.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from nontwist import propagator
from nontwist.errors import SimulationError
from nontwist.integrators import INTEGRATORS

from .peers import Call, Method, peers
from .rows import Row, digits
from .timing import VERY_SLOW, shuffled
from .workloads import WORKLOADS, Array, Workload

TARGETS = (1e-3, 1e-6, 1e-9, 1e-13)
EQUAL = 2.4e-7  # of MuJoCo and Exudyn RK44 at a step of 0.005 s
FINEST = 3e-14  # the error below which no finer setting is tried
LONGEST = {"steps": 0.2, "tolerance": 2.0, "none": 2.0}  # the seconds beyond which none is
DRAWN = {  # integrators in the figure
    "exact": "#882255",
    "split 6": "#009E73",
    "gauss 4": "#fc9272",
    "gauss 8": "#ef3b2c",
    "gauss 16": "#67000d",
    "lie-midpoint 2": "#0072B2",
}
GRID = 10  # steps come in multiples of this where the load has breakpoints, which then lie on the grid


@dataclass(frozen=True)
class Point:
    """A method at one setting."""

    method: str
    kind: str
    setting: float
    error: float
    seconds: float
    own: bool


@dataclass(frozen=True)
class Result:
    """All of one motion."""

    workload: Workload
    points: list[Point]

    def seconds(self, method: str, target: float) -> float | None:
        """Return the time in which `method` reaches `target`."""
        return min((p.seconds for p in self.points if p.method == method and p.error <= target), default=None)

    def best(self, methods: list[str], target: float) -> tuple[str, float] | None:
        """Return the fastest of `methods` at `target`, and its time."""
        found = [(s, m) for m in methods if (s := self.seconds(m, target)) is not None]
        return (min(found)[1], min(found)[0]) if found else None

    @property
    def methods(self) -> dict[str, bool]:
        """Names, and whether they are the package's."""
        return {p.method: p.own for p in self.points}


def own(w: Workload) -> list[Method]:
    """Return what the package offers for a motion: every integrator, every order."""
    found: list[Method] = []
    for name, cls in INTEGRATORS.items():
        for order in cls.orders or (None,):
            label = name if order is None else f"{name} {order}"
            if cls.orders:
                options, settings, kind = {"order": order}, (GRID if w.knots else 2, 2**20), "steps"
            else:
                options, settings, kind = {}, (0, 0), "none"
            prepare = _prepare(w, name, options, kind)
            try:
                prepare(1000)()
            except SimulationError:
                pass
            except ValueError:  # it does not take the body or the load
                continue
            found.append(Method(label, prepare, _attitude, settings, kind, own=True))
    return found


def _prepare(w: Workload, name: str, options: dict[str, Any], kind: str) -> Callable[[float], Call]:
    def prepare(setting: float) -> Call:
        how: dict[str, Any] = {"load": w.load, "integrator": name, **options}
        if kind == "steps":
            how |= {"t_end": w.t_end, "step": w.t_end / int(setting)}
        else:
            how |= {"times": [w.t_end]}
        run = propagator(w.system, **how)
        return lambda: run(material_angular_velocity=w.velocity)

    return prepare


def _attitude(run: Any) -> Array:
    return run.directors[-1].T


@cache
def measure(key: str) -> Result:
    """Measure all methods on the motion of a key."""
    w = next(w for w in WORKLOADS if w.key == key)
    methods = [*own(w), *peers(w)]
    targets = (*TARGETS, EQUAL) if key == "C" else TARGETS
    calls, errors, known = {}, {}, {}
    for k, method in enumerate(methods):
        for setting, (call, error, time) in explore(w, method, targets).items():
            calls[k, setting], errors[k, setting], known[k, setting] = call, error, time
    seconds = shuffled(calls, known=known)
    points = [
        Point(methods[k].name, methods[k].kind, setting, errors[k, setting], seconds[k, setting], methods[k].own)
        for k, setting in calls
    ]
    return Result(w, points)


def explore(w: Workload, method: Method, targets: tuple[float, ...]) -> dict[float, tuple[Call, float, float]]:
    """Return calls, errors and seconds at settings from coarse to fine, closer together around the targets."""
    found: dict[float, tuple[Call, float, float]] = {}
    times: dict[float, float] = {}

    def run(setting: float) -> float:
        if setting in times:
            return found[setting][1] if setting in found else np.inf
        call = method.prepare(setting)
        try:
            for _ in range(2):  # the first call may compile
                start = perf_counter()
                result = call()
                times[setting] = perf_counter() - start
                if times[setting] > VERY_SLOW and len(times) > 1:
                    break
        except (SimulationError, RuntimeError, ValueError):
            times[setting] = 0.0
            return np.inf
        error = w.error(method.attitude(result))
        if not np.isfinite(error):
            return np.inf
        found[setting] = call, error, times[setting]
        return error

    if method.kind == "none":
        run(0.0)
        return found
    first, last = method.settings
    factor = 2.0 if method.kind == "steps" else 0.1
    ladder, setting = [], first
    while min(first, last) <= setting <= max(first, last):
        ladder.append(rounded(w, setting, method.kind))
        error = run(ladder[-1])
        if error <= FINEST or times[ladder[-1]] > LONGEST[method.kind]:
            break
        setting *= factor
    for target in targets:
        good = next((k for k, s in enumerate(ladder) if run(s) <= target), None)
        if not good:
            continue
        coarse, fine = ladder[good - 1], ladder[good]
        for _ in range(4):
            middle = rounded(w, float(np.sqrt(coarse * fine)), method.kind)
            if run(middle) <= target:
                fine = middle
            else:
                coarse = middle
    return found


def rounded(w: Workload, setting: float, kind: str) -> float:
    """Return a setting that is possible: whole numbers of steps that fit the grid."""
    unit = GRID if w.knots else 1
    return float(max(1, round(setting / unit)) * unit) if kind == "steps" else setting


# Motions, methods of the package by their first word (fastest: all), errors, the other tool.
PAIRS: tuple[tuple[str, str, tuple[float, ...], str], ...] = (
    ("ABCT", "fastest", (1e-9,), "heyoka.py"),
    ("CT", "gauss", (1e-6, 1e-9, 1e-13), "heyoka.py"),
    ("AC", "exact", (1e-9, 1e-13), "heyoka.py"),
    ("ABCT", "fastest", (1e-6,), "SciPy DOP853"),
    ("ABCT", "fastest", (1e-6,), "diffrax Dopri8"),
    ("C", "gauss", (1e-3,), "Exudyn generalised-α"),
    ("C", "gauss", (EQUAL,), "Exudyn RK44"),
    ("C", "gauss", (EQUAL,), "MuJoCo RK4"),
)


def rows() -> list[Row]:
    """Return what other tools take over what the fastest method of a family takes, which the note names."""
    return [
        ratio(key, family, target, peer) for keys, family, targets, peer in PAIRS for key in keys for target in targets
    ]


def ratio(key: str, family: str, target: float, peer: str) -> Row:
    """Compare one tool with a family of methods on a motion."""
    result, name = measure(key), f"{key}, {family} at {target:.0e}: {peer}"
    names = [m for m, ours in result.methods.items() if ours and family in ("fastest", m.split()[0])]
    ours, theirs = result.best(names, target), result.seconds(peer, target)
    if ours is None or theirs is None:
        why = "not reached" if peer in result.methods else "not installed"
        return Row(name, None, "×", note=why)
    return Row(name, theirs / ours[1], "×", note=f"{ours[0]}, {digits(1e6 * ours[1])} µs")


def write(folder: Path) -> None:
    """Write all points as CSV, and a figure."""
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / "work-precision.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["workload", "method", "kind", "setting", "error", "microseconds"])
        for w in WORKLOADS:
            for p in sorted(measure(w.key).points, key=lambda p: (not p.own, p.method, p.seconds)):
                writer.writerow(
                    [w.key, p.method, p.kind, f"{p.setting:.6g}", f"{p.error:.3g}", f"{1e6 * p.seconds:.4g}"]
                )
    draw(folder / "work-precision.svg")


def draw(path: Path) -> None:
    """Draw time over error, a panel for each motion."""
    from matplotlib.figure import Figure

    from nontwist.plot.journals import column_width, style

    looks: dict[str, dict[str, Any]] = {
        name: {"color": colour, "linestyle": "-", "linewidth": 1.6} for name, colour in DRAWN.items()
    }
    others = sorted({m for w in WORKLOADS for m, ours in measure(w.key).methods.items() if not ours})
    for name, marker in zip(others, "osv^x+*<>pdh", strict=False):
        grey = "0" if name.startswith("heyoka") else "0.55"
        looks[name] = {"linestyle": "--", "linewidth": 0.7, "marker": marker, "markersize": 2.5, "color": grey}
    with style():
        figure = Figure(figsize=(column_width(2), 6.6), layout="constrained")
        handles = {}
        for ax, w in zip(figure.subplots(2, 2, sharex=True, sharey=True).flat, WORKLOADS, strict=True):
            result = measure(w.key)
            for name, look in looks.items():
                points = sorted((p.seconds, p.error) for p in result.points if p.method == name)
                if points:
                    seconds, errors = np.array(front(points)).T
                    dot = {"marker": "D", "markersize": 5} if len(points) == 1 else {}
                    (handles[name],) = ax.loglog(errors, 1e6 * seconds, **dot, **look)
            ax.set_title(f"{w.key}: {w.title}", loc="left")
            ax.set_xlim(1e-1, 2e-15)
            ax.set_xlabel("error of the attitude at t = 5 s (rad)")
            ax.set_ylabel("time (µs)")
            ax.label_outer()
        figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=4, fontsize=8)
        figure.savefig(path, metadata={"Date": None})


def front(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the points, sorted by time, that none faster beats in error."""
    kept: list[tuple[float, float]] = []
    for seconds, error in points:
        if not kept or error < kept[-1][1]:
            kept.append((seconds, error))
    return kept

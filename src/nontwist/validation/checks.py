"""`validate`: numbers with a known value, measured in this run, in groups; as a page of summaries and as JSON.

A check holds when ``|measured - expected| <= tolerance``. An error or a drift has the expected value 0. The tolerance
is what the documentation promises, or the accuracy of the expected value.
"""

from __future__ import annotations

import json
import math
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib import import_module
from time import perf_counter
from types import ModuleType
from typing import Literal

Kind = Literal["printed", "closed form", "many digits", "independent", "invariant", "order"]

KINDS: dict[Kind, str] = {
    "printed": "digits that the paper prints",
    "closed form": "a formula, or its quadrature to round-off",
    "many digits": "computed once with 40 digits or more, by two methods that share no code with the package",
    "independent": "another method: DOP853 at a tolerance of 1e-13, another form of the equations, SciPy",
    "invariant": "a conserved quantity or an exact balance of the equations",
    "order": "the slope of the error against the step in logarithms; of all that were measured, the one furthest off",
}

# The module of each group: its `CHECKS` are plain functions that yield checks, its docstring says what is compared.
GROUPS = {
    "paper": "motion_equations",
    "equations": "motion_equations",
    "geometry": "frame_checks",
    "free": "closed_forms",
    "loaded": "loaded_bodies",
    "suslov": "closed_forms",
    "tops": "closed_forms",
    "orders": "orders",
    "invariants": "conserved",
    "nonreversible": "orders",
    "compiled": "compiled_steps",
    "frames": "frame_checks",
    "twist": "frame_checks",
}
OF_ALL_BODIES = ("equations", "orders", "invariants", "compiled")  # groups that check bodies of every kind

# The literature that sources of checks name, beside the labels of the paper.
REFERENCES = {
    "Bishop 1975": "R. L. Bishop, There is more than one way to frame a curve, Amer. Math. Monthly 82 (1975) 246–251",
    "Blanes, Casas & Ros 2000": "S. Blanes, F. Casas, J. Ros, Improved high order integrators based on the Magnus "
    "expansion, BIT 40 (2000) 434–450",
    "Bloch": "A. M. Bloch, Nonholonomic Mechanics and Control, Springer",
    "Brüls, Cardona & Arnold 2012": "O. Brüls, A. Cardona, M. Arnold, Lie group generalized-α time integration of "
    "constrained flexible multibody systems, Mech. Mach. Theory 48 (2012) 121–137",
    "Codman 1934": "E. A. Codman, The Shoulder, Boston 1934",
    "Girard, Gauss–Bonnet": "the solid angle of a polygon is 2π less the sum of its exterior angles",
    "Hairer, Lubich & Wanner": "E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., Springer "
    "2006",
    "Kahan & Li 1997": "W. Kahan, R.-C. Li, Composition constants for raising the orders of unconventional schemes for "
    "ordinary differential equations, Math. Comp. 66 (1997) 1089–1099",
    "Landau & Lifshitz": "L. D. Landau, E. M. Lifshitz, Mechanics, 3rd ed., Butterworth-Heinemann 1976",
    "Modin & Verdier 2020": "K. Modin, O. Verdier, What makes nonholonomic integrators work?, Numer. Math. 145 "
    "(2020) 405–435",
    "Montgomery 1991": "R. Montgomery, How much does the rigid body rotate? A Berry's phase from the 18th century, "
    "Amer. J. Phys. 59 (1991) 394–398",
    "Simo & Wong 1991": "J. C. Simo, K. K. Wong, Unconditionally stable algorithms for rigid body dynamics that "
    "exactly preserve energy and momentum, Int. J. Numer. Methods Eng. 31 (1991) 19–52",
    "Suslov 1946": "G. K. Suslov, Theoretical Mechanics, Moscow 1946 (in Russian)",
    "Suzuki 1990": "M. Suzuki, Fractal decomposition of exponential operators, Phys. Lett. A 146 (1990) 319–323",
    "Wang, Jüttler, Zheng & Liu 2008": "W. Wang, B. Jüttler, D. Zheng, Y. Liu, Computation of rotation minimizing "
    "frames, ACM Trans. Graph. 27 (2008) 2:1–2:18",
    "Whittaker": "E. T. Whittaker, Analytical Dynamics of Particles and Rigid Bodies, 4th ed., Cambridge 1937",
    "Wittenburg 1977": "J. Wittenburg, Dynamics of Systems of Rigid Bodies, Teubner 1977",
}


@dataclass(frozen=True)
class Check:
    """One number with a known value.

    Attributes
    ----------
    name : str
        What is measured, with its unit.
    expected, measured : float
        0 and the largest error, where the expected value is not one number.
    tolerance : float
        Absolute; 0 for counts.
    source : str
        Equation labels of the paper, keys of `REFERENCES`, or the module with the derivation; semicolons between.
    kind : Kind
        Of the expected value: a key of `KINDS`.
    group : str
        A key of `GROUPS`.
    """

    name: str
    expected: float
    measured: float
    tolerance: float
    source: str
    kind: Kind
    group: str = ""

    @property
    def holds(self) -> bool:
        """Whether the measured number is the expected one, within the tolerance; never for NaN."""
        return bool(abs(self.measured - self.expected) <= self.tolerance)


HEADER = "| group | checks | kinds | largest share | check with this share | time, s |"
HEAD = (
    "# Validation",
    "",
    "`make validate` measures numbers with known values and writes this page, in about a minute, without network",
    "access. A check passes if the measured and the known number differ by no more than a tolerance, set beforehand.",
    "Below, the *share* is this difference over the tolerance. `nontwist validate` prints every check, `--group` those",
    "of one group.",
)


@dataclass(frozen=True)
class Validation:
    """All checks of a validation by group, notes on what was not checked, and why, and the seconds of each group."""

    checks: tuple[Check, ...]
    notes: tuple[str, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)

    @property
    def holds(self) -> bool:
        """Whether every check passes."""
        return all(check.holds for check in self.checks)

    @property
    def groups(self) -> dict[str, tuple[Check, ...]]:
        """The checks by their groups."""
        names = dict.fromkeys(check.group for check in self.checks)
        return {name: tuple(check for check in self.checks if check.group == name) for name in names}

    @property
    def summary(self) -> str:
        """How many checks pass."""
        return f"{sum(check.holds for check in self.checks)} of {len(self.checks)} checks pass"

    def to_json(self) -> str:
        """Return versions, verdict, all checks with every digit, and the references that they cite."""
        from ..analysis.trajectory import versions

        rows = [asdict(check) | {"holds": check.holds} for check in self.checks]
        cited = " ".join(check.source for check in self.checks)
        references = {short: full for short, full in REFERENCES.items() if short in cited}
        found = {"holds": self.holds, "versions": versions(), "checks": rows, "references": references}
        return json.dumps(found | {"notes": self.notes, "seconds": self.seconds}, indent=1, ensure_ascii=False)

    def to_markdown(self, rows: str | None = None) -> str:
        """Return a summary: one row for each group, and a link to the file of all `rows`, if there is one."""
        from ..analysis.trajectory import versions

        made = ", ".join(f"{name} {number}" for name, number in versions().items())
        lines = [*HEAD, *([f"[{rows}]({rows}) has every row, with its source."] if rows else [])]
        lines += ["", f"**{self.summary}** ({made}).", "", HEADER, "| --- | ---: | --- | ---: | --- | ---: |"]
        for group, checks in self.groups.items():
            kinds = Counter(check.kind for check in checks)
            worst = max(checks, key=share)
            counts = ", ".join(f"{n} {kind}" for kind, n in kinds.items())
            cells = [f"**{group}**: {words_of(group)}", str(len(checks)), counts, f"{share(worst):.1g}", worst.name]
            cells.append(f"{self.seconds[group]:.1f}" if group in self.seconds else "")
            lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
        lines += ["", "The known values are of these kinds:", ""]
        lines += [f"- **{kind}**: {words}." for kind, words in KINDS.items()]
        return "\n".join(lines) + "\n"


def module_of(group: str) -> ModuleType:
    """Return the module with the checks of a group."""
    return import_module(f"{__package__}.{GROUPS[group]}")


def words_of(group: str) -> str:
    """Return the paragraph of a group in the docstring of its module."""
    _, _, text = (module_of(group).__doc__ or "").partition(f"**{group}**: ")
    return " ".join(text.partition("\n\n")[0].split())


def share(check: Check) -> float:
    """Return the error over the tolerance; infinity for a check that fails without one."""
    gap = abs(check.measured - check.expected)
    if check.tolerance > 0:
        return gap / check.tolerance if math.isfinite(gap) else math.inf
    return 0.0 if check.holds else math.inf


def numbers(check: Check) -> tuple[str, str, str]:
    """Return expected, measured and tolerance as text, with the digits that the tolerance resolves."""
    tolerance = f"{check.tolerance:.2g}"
    if check.expected == 0 and check.tolerance > 0:
        return "0", f"{check.measured:.2g}", tolerance
    places = -math.floor(math.log10(check.tolerance)) if check.tolerance > 0 else 0
    places += check.kind == "order"
    return f"{check.expected:.{places}f}", f"{check.measured:.{places}f}", tolerance


def validate(
    groups: str | Iterable[str] | None = None, *, workers: int = 1, progress: Callable[[str], None] | None = None
) -> Validation:
    """Validate the package against the paper, closed-form solutions, invariants and orders.

    Parameters
    ----------
    groups : str or iterable of str, optional
        Keys of `nontwist.validation.GROUPS`; all by default.
    workers : int
        Number of processes that share the groups. More than one requires a script that is safe to import
        (``if __name__ == "__main__":``).
    progress : callable, optional
        Called with a description of the next step.

    Returns
    -------
    Validation
        All checks, whether they pass, and notes on what was not checked.

    Raises
    ------
    ValueError
        There is no such group.

    Examples
    --------
    >>> from nontwist import validate
    >>> validation = validate("geometry")
    >>> validation.holds
    True
    >>> [check.name for check in validation.checks if check.source == "eq-dexp"][0]
    'SO(3): dexp against the integral of exp(s θ̂)'
    """
    from ..geometry.values import among, as_function, as_list, as_whole, nearest, short_repr

    named = list(GROUPS) if groups is None else [groups] if isinstance(groups, str) else as_list(groups, "groups")
    if unknown := [name for name in named if not among(name, GROUPS)]:
        raise ValueError(f"unknown group {short_repr(unknown[0])}; {nearest(unknown[0], GROUPS)}")
    chosen, workers = list(dict.fromkeys(named)), as_whole(workers, "workers", 1)
    say = (lambda text: None) if progress is None else as_function(progress, "progress")
    found: dict[str, tuple[list[Check], float]] = {}
    if workers == 1 or len(chosen) == 1:
        for name in chosen:
            say(f"{len(found)} of {len(chosen)} groups done: {name}")
            found[name] = checks_of(name)
    else:
        from concurrent.futures import ProcessPoolExecutor, as_completed
        from multiprocessing import get_context

        from ..sweeps.workers import own_modules

        context = get_context("spawn")
        with ProcessPoolExecutor(workers, context, imported, own_modules()) as pool:
            tasks = {pool.submit(checks_of, name): name for name in chosen}
            say(f"0 of {len(chosen)} groups done")
            for task in as_completed(tasks):
                found[tasks[task]] = task.result()
                say(f"{len(found)} of {len(chosen)} groups done")
    checks = tuple(check for name in chosen for check in found[name][0])
    return Validation(checks, notes_on(chosen), {name: found[name][1] for name in chosen})


def imported(*modules: str) -> None:
    """Import the modules that add bodies, loads and integrators, in a new process."""
    for name in modules:
        import_module(name)


def notes_on(groups: Iterable[str]) -> tuple[str, ...]:
    """Return what some groups do not check, and why; and which of them check bodies of one's own."""
    from .conserved import unchecked
    from .problems import own_kinds

    notes = unchecked() if "invariants" in groups else []
    checked = [group for group in groups if group in OF_ALL_BODIES]
    if checked and (own := own_kinds()):
        notes.append(f"the checks of all bodies in {', '.join(checked)} include your own: {', '.join(map(repr, own))}")
    return tuple(notes)


def checks_of(group: str) -> tuple[list[Check], float]:
    """Return all checks of a group, and the seconds that they took."""
    from ..driver.notices import COARSE_STEP

    module, start = module_of(group), perf_counter()
    with warnings.catch_warnings():  # orders are measured with coarse steps
        warnings.filterwarnings("ignore", COARSE_STEP)
        checks = [replace(check, group=group) for function in module.CHECKS[group] for check in results_of(function)]
    return checks, perf_counter() - start


def results_of(function: Callable[[], Iterable[Check]]) -> Iterator[Check]:
    """Yield the checks of a function, with one that fails where it cannot be carried out."""
    try:
        yield from function()
    except Exception as error:
        what = getattr(function, "__name__", repr(function)).replace("_", " ")
        name = f"exceptions of {what}: {type(error).__name__}: {error}"
        yield Check(name, 0.0, 1.0, 0.0, function.__module__, "independent")

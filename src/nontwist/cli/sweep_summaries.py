"""What the commands on sweeps print."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .outcomes import say
from .summaries import hint, print_rows, print_table, shown_unit, typed

if TYPE_CHECKING:
    from ..runfile import RunFile
    from ..sweeps.plan import Plan

SHOWN = 10  # kinds of failure
NUMBER = re.compile(r"-?\d+(\.\d+)?(e[+-]?\d+)?")


def plan_rows(run_file: RunFile, plan: Plan) -> dict[str, str]:
    """Return what a sweep will take, in words."""
    from ..driver.costs import amount, duration

    assert run_file.sweep is not None
    rows = {f"over {one.key}": _over(one.model_dump()) for one in run_file.sweep.over}
    rows["members"] = f"{plan.members:,}".replace(",", " ")
    rows["blocks"] = f"{plan.blocks} of {plan.block} members"
    rows["store"] = f"{amount(plan.bytes)} in about {plan.files} files, {plan.bytes_each} bytes per member"
    each = f"{duration(plan.seconds_each)} per member, as measured"
    rows["time"] = f"about {duration(plan.seconds)} on {plan.workers} cores like this one, without start-up ({each})"
    if plan.refused:
        rows["refused"] = f"{plan.refused:.0%} of the members tried, the first because: {plan.reason}"
    return rows


def _over(data: dict[str, Any]) -> str:
    values = data.pop("values", None)
    rest = ", ".join(f"{key} {value}" for key, value in data.items() if key not in ("key", "kind"))
    return f"{data['kind']}: {f'{len(values)} values' if values is not None else rest}".removesuffix(": ")


def sweep_facts(store: Path) -> dict[str, Any]:
    """Return what a store holds, as plain data."""
    from ..sweeps import open_sweep
    from ..sweeps.store import open_store

    kept = open_store(store)
    data = open_sweep(store, verify=bool(kept.seal))
    marked = kept.done()
    sweep = kept.members.sweep
    reasons = {int(i): reason for done in marked.values() for i, reason in done.reasons.items()}
    swept = [one.key for one in sweep.over]
    return {
        "store": str(store),
        "title": data.attrs["title"],
        "members": len(kept.members),
        "seal": kept.seal_words,
        "blocks": kept.blocks,
        "blocks_done": len(marked),
        "members_done": sum(last - first for first, last in map(kept.span, marked)),
        "failed": sum(done.failed for done in marked.values()),
        "seconds": sum(done.seconds for done in marked.values()),
        "swept": {one.key: _over(one.model_dump()) for one in sweep.over},
        "samples": sweep.samples,
        "sampling": sweep.sampling if sweep.drawn else None,
        "seed": sweep.seed,
        "variables": {str(name): _variable(data[name]) for name in data.data_vars if name not in (*swept, "status")},
        "failures": _kinds(reasons),
    }


def _variable(values: Any) -> dict[str, Any]:
    least, most = (float(one) for one in (values.min(), values.max()))
    names = {name: values.attrs.get(name, "") for name in ("units", "long_name")}
    return {**names, "dimensions": list(map(str, values.dims)), "min": least, "max": most}


def _kinds(reasons: dict[int, str]) -> list[dict[str, Any]]:
    """Return failures that differ in numbers alone as one: how many, the first member, its reason."""
    first: dict[str, int] = {}
    kind_of = {i: NUMBER.sub("#", reason) for i, reason in sorted(reasons.items())}
    for i, kind in kind_of.items():
        first.setdefault(kind, i)
    return [
        {"members": count, "first": first[kind], "reason": reasons[first[kind]]}
        for kind, count in Counter(kind_of.values()).most_common(SHOWN)
    ]


def print_sweep(facts: dict[str, Any]) -> None:
    """Print what a store holds."""
    from ..geometry.values import number_text

    rows = {
        "members": f"{facts['members_done']} of {facts['members']} are done, {facts['failed']} failed",
        "blocks": f"{facts['blocks_done']} of {facts['blocks']}, {number_text(facts['seconds'], '.3g')} s of work",
        "seal": facts["seal"],
        **{f"over {key}": words for key, words in facts["swept"].items()},
    }
    if facts["sampling"]:
        rows["samples"] = f"{facts['samples']} per point, {facts['sampling']}, seed {facts['seed']}"
    print_rows(facts["title"], rows)
    variables = facts["variables"].values()
    columns = {
        "name": list(facts["variables"]),
        "unit": [shown_unit(one["units"]) for one in variables],
        "dimensions": [", ".join(one["dimensions"]) for one in variables],
        "range": [f"{one['min']:.6g} to {one['max']:.6g}" for one in variables],
        "meaning": [one["long_name"] for one in variables],
    }
    print_table("variables", columns, spare=("dimensions", "meaning"))
    if facts["failed"]:
        failures = facts["failures"]
        table = {
            "members": [str(one["members"]) for one in failures],
            "first": [str(one["first"]) for one in failures],
            "reason of the first": [one["reason"] for one in failures],
        }
        print_table("failures", table)
    if facts["swept"] and facts["variables"]:
        plain = ("grid", "list")
        quantity = _telling({name: len(one["dimensions"]) for name, one in facts["variables"].items()})
        keys = [f"{key}{'' if words.startswith(plain) else '.0'}" for key, words in facts["swept"].items()]
        drawn = keys if len(keys) == 2 else keys[:1]
        say(hint(f"nontwist sweep-show {typed(facts['store'])} --plot {' '.join(drawn)} {quantity}"))


def _telling(dimensions: dict[str, int]) -> str:
    """Return what says something: a number, or else the length of a vector, or else a component of an attitude."""
    whole = {name: n for name, n in dimensions.items() if n < 3 and name != "quaternion"}
    if whole:
        return min(whole, key=lambda name: whole[name])
    name = max(dimensions, key=lambda name: dimensions[name])
    return f"{name}.2.2" if dimensions[name] == 3 else f"{name}.3"

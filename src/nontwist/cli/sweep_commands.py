"""`nontwist sweep`, `sweep-verify`, `sweep-show`: many runs of one file, their store, and what is in it."""

from __future__ import annotations

import re
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

import nontwist

from ..geometry.values import counted, number_text
from ..io.whole import require_free, written
from .outcomes import DIFFERS, on_file
from .printing import print_rows, print_table, print_variables, say, say_next, say_written
from .run_commands import read_one
from .shared_options import (
    Answer,
    OneRunFile,
    Opt,
    Overrides,
    Quiet,
    argument,
    looks_like_a_file,
    refuse,
    require_suffix,
)

if TYPE_CHECKING:
    from ..runfile import RunFile
    from ..sweeps.sweeping import Plan

# What the commands on sweeps print.

SHOWN = 10  # kinds of failure
NUMBER = re.compile(r"-?\d+(\.\d+)?(e[+-]?\d+)?")


def plan_rows(run_file: RunFile, plan: Plan) -> dict[str, str]:
    """Return what a sweep will take, in words."""
    from ..driver.notices import amount, duration

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
    return f"{data['kind']}: {counted(len(values), 'value') if values is not None else rest}".removesuffix(": ")


def sweep_facts(store: Path) -> dict[str, Any]:
    """Return what a store holds, as plain data."""
    from ..sweeps.members import spread
    from ..sweeps.store import open_store

    kept = open_store(store)
    data = nontwist.open_sweep(store, verify=bool(kept.blocks.seal))
    marked = kept.done()
    sweep = kept.members.sweep
    reasons = {int(i): reason for done in marked.values() for i, reason in done.reasons.items()}
    hidden = {"status", *(one.key for one in sweep.over)}
    return {
        "store": str(store),
        "title": data.attrs["title"],
        "members": len(kept.members),
        "seal": kept.seal_words,
        "blocks": kept.blocks.count,
        "blocks_done": len(marked),
        "members_done": sum(last - first for first, last in map(kept.blocks.span, marked)),
        "failed": sum(done.failed for done in marked.values()),
        "seconds": sum(done.seconds for done in marked.values()),
        "swept": {one.key: _over(one.model_dump()) for one in sweep.over},
        "samples": sweep.samples,
        "sampling": sweep.sampling if sweep.drawn else None,
        "seed": sweep.seed,
        "variables": {str(name): _variable(one) for name, one in data.data_vars.items() if name not in hidden},
        "failures": _kinds(reasons),
        "drawn": [_varying(*one) for one in spread(sweep, 100).items()][: 1 + (len(sweep.over) == 2)],
    }


def _varying(key: str, values: Any) -> str:
    """Return a key, or its first component that differs among members."""
    differs = (values != values[0]).nonzero()
    return ".".join([key, *(str(k[0] if len(k) else 0) for k in differs[1:])])


def _variable(values: Any) -> dict[str, Any]:
    least, most = (float(one) for one in (values.min(), values.max()))
    names = {name: values.attrs.get(name, "") for name in ("units", "long_name")}
    return {**names, "dimensions": list(map(str, values.dims)), "min": least, "max": most}


def _kinds(reasons: dict[int, str]) -> list[dict[str, Any]]:
    """Return failures that differ in numbers alone as one: how many, the first member, its reason."""
    kinds: dict[str, list[int]] = {}
    for i, reason in sorted(reasons.items()):
        kinds.setdefault(NUMBER.sub("#", reason), []).append(i)
    most = sorted(kinds.values(), key=len, reverse=True)[:SHOWN]
    return [{"members": len(one), "first": one[0], "reason": reasons[one[0]]} for one in most]


def print_sweep(facts: dict[str, Any]) -> None:
    """Print what a store holds."""
    rows = {
        "members": f"{facts['members_done']} of {facts['members']} are done, {facts['failed']} failed",
        "blocks": f"{facts['blocks_done']} of {facts['blocks']}, {number_text(facts['seconds'], '.3g')} s of work",
        "seal": facts["seal"],
        **{f"over {key}": words for key, words in facts["swept"].items()},
    }
    if facts["sampling"]:
        rows["samples"] = f"{facts['samples']} per point, {facts['sampling']}, seed {facts['seed']}"
    print_rows(facts["title"], rows)
    about = facts["variables"].values()
    dimensions = [", ".join(one["dimensions"]) for one in about]
    ranges = [f"{one['min']:.6g} to {one['max']:.6g}" for one in about]
    print_variables(facts["variables"], ("dimensions", "meaning"), dimensions=dimensions, range=ranges)
    if facts["failed"]:
        counts, firsts, reasons = zip(*(map(str, one.values()) for one in facts["failures"]), strict=True)
        print_table("failures", {"members": counts, "first": firsts, "reason of the first": reasons})
    if facts["swept"] and facts["variables"]:
        quantity = _telling({name: len(one["dimensions"]) for name, one in facts["variables"].items()})
        say_next(("sweep-show", facts["store"], "--plot", *facts["drawn"], quantity))


def _telling(dimensions: dict[str, int]) -> str:
    """Return what says something: a number, or else the length of a vector, or else a component of an attitude."""
    name = min(dimensions, key=lambda name: (name == "quaternion", dimensions[name]))
    return name + (".3" if name == "quaternion" else ".2.2" * (dimensions[name] == 3))


Store = Annotated[Path, argument("STORE", "The store of a sweep (a folder).")]
WORKERS = Opt("Number of threads, or of processes with --dask local.", "N", default="all processors", least=1)
BLOCK = Opt("Members per block.", "N", default="at most 10 s and 64 MiB, as measured", least=1)
DASK = Opt("Run on a Dask cluster.", "ADDRESS|local", default="threads")
PLOTTED = argument("[KEY [KEY2] QUANTITY]", "With --plot: one or two swept keys, and the quantity to draw over them.")
FIGURE = Opt("Figure of --plot (.pdf, .png, .svg).", "PATH", default="STORE-QUANTITY.png")
MEMBER = Opt("With --member: the result (.nc) or the run file (.toml).", "PATH", default="MEMBER.nc here")


def sweep_command(
    file: OneRunFile,
    overrides: Overrides = None,
    out: Annotated[Path | None, Opt("Store (a folder).", "STORE", default="NAME.zarr here")] = None,
    workers: Annotated[int | None, WORKERS] = None,
    dask: Annotated[str | None, DASK] = None,
    block: Annotated[int | None, BLOCK] = None,
    dry_run: Annotated[bool, Opt("Print members, blocks, bytes and time; write nothing.")] = False,
    *,
    answer: Quiet,
) -> None:
    """Run all members of FILE, a run file with a table [sweep], into a store (Zarr).

    Resumes where it stopped: blocks in the store are verified against their hashes and not run again. Members that fail
    are counted and do not stop the others. Completed blocks remain saved after Ctrl-C, SIGTERM or a closed terminal
    (SIGHUP). Exits with status 4 if a block cannot be computed.
    """
    from ..driver.notices import sigterm_interrupts
    from ..machine import cores
    from ..sweeps.members import Members
    from ..sweeps.sweeping import plan

    store = Path(f"{file.stem}.zarr") if out is None else out
    if looks_like_a_file(store):
        require_suffix(store, ".zarr", instead="; the store is a folder")
    run_file = read_one(file, overrides)
    if dry_run:
        with on_file(file):
            forecast = plan(Members(run_file), workers or cores(), block)
        if answer.in_words({"file": str(file), "store": str(store), **forecast._asdict()}):
            print_rows(f"{file}, dry run: {store} is not written", plan_rows(run_file, forecast))
            options = {"--out": store, "--workers": workers, "--dask": dask, "--block": block}
            given = [word for name, one in options.items() if one is not None for word in (name, one)]
            say_next(("sweep", file, *given), sets=overrides)
        return
    begin = perf_counter()
    with sigterm_interrupts(), on_file(file):
        many = nontwist.sweep(run_file, store, workers=workers, dask=dask, block=block, progress=answer.bar)
    seconds, failed = perf_counter() - begin, int((many["status"] != 0).sum())
    numbers = {"file": str(file), "store": str(store), "members": many.sizes["member"], "failed": failed}
    if answer.in_words(numbers | {"seconds": seconds}):
        taken = f"{number_text(seconds, '.3g')} s, with start-up"
        rows = {"store": str(store), "members": f"{numbers['members']}, {failed} failed", "time taken": taken}
        print_rows(many.attrs["title"], rows)
    if failed:
        whole = f"{failed} of {numbers['members']} members failed"
        say(f"warning: {whole}; nontwist sweep-show {store} lists the reasons", "yellow")
    answer.written([store], ("sweep-show", store))


def verify_command(store: Store, answer: Quiet) -> None:
    """Verify STORE: hash every byte, count members, and name missing or damaged blocks.

    Exits with status 1 if there are such blocks; nontwist sweep computes only these again. Exits with status 3 if the
    metadata of STORE are damaged.
    """
    from ..sweeps.store import open_store

    kept = open_store(store)
    found = kept.verified()
    for k in found.missing[:20]:
        say(f"{kept.blocks.name(k)}: missing", "red")
    if len(found.missing) > 20:
        say(f"... and {len(found.missing) - 20} more are missing", "red")
    for k, reason in found.damaged.items():
        say(f"{kept.blocks.name(k)}: damaged: {reason}", "red")
    damaged = {str(k): reason for k, reason in found.damaged.items()}
    numbers = {"store": str(store), **found._asdict(), "damaged": damaged, "complete": found.complete}
    if answer.in_words(numbers):
        good = found.blocks - len(found.missing) - len(found.damaged)
        rows = {
            "members": f"{found.members}, {found.failed} failed",
            "blocks": f"{good} of {found.blocks} are as they were written",
            "SHA-256": found.sha256 or "none while blocks are missing",
            "seal of metadata": kept.seal_words,
        }
        print_rows(f"{store} is {'complete' if found.complete else 'NOT complete'}", rows)
    if not found.complete:
        raise typer.Exit(DIFFERS)


def show_command(
    store: Store,
    plotted: Annotated[list[str] | None, PLOTTED] = None,
    plot: Annotated[bool, Opt("Draw QUANTITY over one or two swept keys.")] = False,
    figure: Annotated[Path | None, FIGURE] = None,
    member: Annotated[int | None, Opt("Run this member again, in full.", "N", least=0)] = None,
    out: Annotated[Path | None, MEMBER] = None,
    *,
    answer: Annotated[Answer, {"force": "", "json": ""}],
) -> None:
    """Describe STORE: what was swept, what was stored, which members failed and why.

    Components are named by their number: body.axis.0, material_angular_velocity.2. For a vector, --plot draws its
    length. The last state of --member equals that in the store, bit for bit.
    """
    from ..plot.journals import require_places
    from ..sweeps.opening import draw

    wrong = bool(plotted) != plot or (plotted and len(plotted) not in (2, 3))
    refuse((wrong, "--plot", "give --plot KEY QUANTITY, or --plot KEY KEY2 QUANTITY"))
    if plotted:
        figure = figure or Path(f"{store.name.removesuffix('.zarr')}-{plotted[-1]}.png")
        require_places(figure, force=answer.force)
        nontwist.plot.save(draw(store, plotted[:-1], plotted[-1]), figure, force=answer.force)
        say_written([figure])
    elif member is not None:
        _rerun(store, member, out or Path(f"{member}.nc"), answer.force)
    elif answer.in_words(facts := sweep_facts(store)):
        print_sweep(facts)


def _rerun(store: Path, member: int, out: Path, force: bool) -> None:
    from ..sweeps.store import open_store

    require_suffix(out, ".nc", ".toml")
    require_free(out, force=force)
    command = "run" if out.suffix.lower() == ".toml" else "view"
    if command == "run":
        text = open_store(store).members.member(member).text(sweep=False)
        with written(out, force=force) as file:
            file.write(text.encode())
    else:
        nontwist.save_run(nontwist.sweep_member(store, member), out, force=force)
    say_written([out], (command, out))

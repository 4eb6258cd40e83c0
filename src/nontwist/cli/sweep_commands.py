"""`nontwist sweep`, `sweep-verify`, `sweep-show`: many runs of one file, their store, and what is in it."""

from __future__ import annotations

import re
import sys
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import Debug, Force, Json, OneRunFile, Overrides, Quiet, looks_like_a_file, require_suffix
from .outcomes import DIFFERS, SOLVER, CommandError, about, say
from .run_commands import printed_warnings, read_one
from .summaries import hint, print_json, print_rows, print_table, set_again, shown_unit, typed

if TYPE_CHECKING:
    from ..runfile import RunFile
    from ..sweeps.plan import Plan
    from ..sweeps.workers import Progress

# What the commands on sweeps print.

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
    data = open_sweep(store, verify=bool(kept.blocks.seal))
    marked = kept.done()
    sweep = kept.members.sweep
    reasons = {int(i): reason for done in marked.values() for i, reason in done.reasons.items()}
    swept = [one.key for one in sweep.over]
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


EVERY = 10.0  # s between lines of progress where stderr is no terminal
Store = Annotated[Path, typer.Argument(metavar="STORE", help="The store of a sweep (a folder).", show_default=False)]


def sweep_command(
    file: OneRunFile,
    overrides: Overrides = None,
    out: Annotated[
        Path | None, typer.Option(metavar="STORE", help="Store (a folder).", show_default="NAME.zarr here")
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=1,
            help="Number of threads, or of processes with --dask local.",
            show_default="all processors",
        ),
    ] = None,
    dask: Annotated[
        str | None, typer.Option(metavar="ADDRESS|local", help="Run on a Dask cluster.", show_default="threads")
    ] = None,
    block: Annotated[
        int | None,
        typer.Option(
            metavar="N", min=1, help="Members per block.", show_default="at most 10 s and 64 MiB, as measured"
        ),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print members, blocks, bytes and time; write nothing.")
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Run all members of FILE, a run file with a table [sweep], into a store (Zarr).

    Resumes where it stopped: blocks in the store are verified against their hashes and not run again. Members that fail
    are counted and do not stop the others. Completed blocks remain saved after Ctrl-C, SIGTERM or a closed terminal
    (SIGHUP). Exits with status 4 if a block cannot be computed.
    """
    from ..driver import sigterm_interrupts

    store = Path(f"{file.stem}.zarr") if out is None else out
    if looks_like_a_file(store):
        require_suffix(store, ".zarr", instead="; the store is a folder")
    with _explained():
        run_file = read_one(file, overrides)
        if dry_run:
            _print_plan(run_file, file, store, workers, block, as_json)
            if not as_json:
                options = {"--out": store, "--workers": workers, "--dask": dask, "--block": block}
                again = [word for name, one in options.items() if one is not None for word in (name, typed(one))]
                say(hint(" ".join(["nontwist sweep", typed(file), *set_again(overrides), *again])))
            return
        from ..geometry.values import number_text
        from ..sweeps import sweep

        begin = perf_counter()
        report = False if quiet else True if sys.stderr.isatty() else _progress_lines()
        with sigterm_interrupts(), about(str(file), ValueError), printed_warnings(file):
            many = sweep(run_file, store, workers=workers, dask=dask, block=block, progress=report)
        seconds = perf_counter() - begin
    failed = int((many["status"] != 0).sum())
    numbers = {"file": str(file), "store": str(store), "members": many.sizes["member"], "failed": failed}
    if as_json:
        print_json({**numbers, "seconds": seconds})
    elif not quiet:
        rows = {
            "store": str(store),
            "members": f"{numbers['members']}, {failed} failed",
            "time taken": f"{number_text(seconds, '.3g')} s, with start-up",
        }
        print_rows(many.attrs["title"], rows)
    if failed:
        say(
            f"warning: {failed} of {numbers['members']} members failed; nontwist sweep-show {store} lists the reasons",
            "yellow",
        )
    if not quiet:
        say(f"written: {store}; {hint(f'nontwist sweep-show {typed(store)}')}")


def verify_command(store: Store, as_json: Json = False, quiet: Quiet = False, debug: Debug = False) -> None:
    """Verify STORE: hash every byte, count members, and name missing or damaged blocks.

    Exits with status 1 if there are such blocks; nontwist sweep computes only these again. Exits with status 3 if the
    metadata of STORE are damaged.
    """
    with _explained():
        from ..sweeps.store import open_store

        kept = open_store(store)
        found = kept.verified()
    for k in found.missing[:20]:
        say(f"{kept.blocks.name(k)}: missing", "red")
    if len(found.missing) > 20:
        say(f"... and {len(found.missing) - 20} more are missing", "red")
    for k, reason in found.damaged.items():
        say(f"{kept.blocks.name(k)}: damaged: {reason}", "red")
    if as_json:
        damaged = {str(k): reason for k, reason in found.damaged.items()}
        print_json({"store": str(store), **found._asdict(), "damaged": damaged, "complete": found.complete})
    elif not quiet:
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
    plotted: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[KEY [KEY2] QUANTITY]",
            help="With --plot: one or two swept keys, and the quantity to draw over them.",
        ),
    ] = None,
    plot: Annotated[bool, typer.Option("--plot", help="Draw QUANTITY over one or two swept keys.")] = False,
    figure: Annotated[
        Path | None,
        typer.Option(metavar="PATH", help="Figure of --plot (.pdf, .png, .svg).", show_default="STORE-QUANTITY.png"),
    ] = None,
    member: Annotated[int | None, typer.Option(metavar="N", min=0, help="Run this member again, in full.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            help="With --member: the result (.nc) or the run file (.toml).",
            show_default="MEMBER.nc here",
        ),
    ] = None,
    force: Force = False,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Describe STORE: what was swept, what was stored, which members failed and why.

    Components are named by their number: body.axis.0, material_angular_velocity.2. For a vector, --plot draws its
    length. The last state of --member equals that in the store, bit for bit.
    """
    if bool(plotted) != plot or (plotted and len(plotted) not in (2, 3)):
        raise typer.BadParameter("give --plot KEY QUANTITY, or --plot KEY KEY2 QUANTITY", param_hint="--plot")
    with _explained():
        if plotted:
            _draw(store, plotted, figure or Path(f"{store.name.removesuffix('.zarr')}-{plotted[-1]}.png"), force)
        elif member is not None:
            _rerun(store, member, out or Path(f"{member}.nc"), force)
        else:
            facts = sweep_facts(store)
            if as_json:
                print_json(facts)
            else:
                print_sweep(facts)


@contextmanager
def _explained() -> Iterator[None]:
    """Turn what only sweeps raise into its exit status, and warnings into messages."""
    from ..errors import SweepError

    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_: say(f"warning: {message}", "yellow")
            yield
    except SweepError as error:
        raise CommandError(str(error), SOLVER) from error


def _print_plan(
    run_file: RunFile, file: Path, store: Path, workers: int | None, block: int | None, as_json: bool
) -> None:
    from ..driver.costs import cores
    from ..sweeps.members import Members
    from ..sweeps.plan import plan

    with about(str(file), ValueError):
        forecast = plan(Members(run_file), workers or cores(), block)
    if as_json:
        print_json({"file": str(file), "store": str(store), **forecast._asdict()})
    else:
        print_rows(f"{file}, dry run: {store} is not written", plan_rows(run_file, forecast))


def _progress_lines() -> Any:
    """Return what prints the progress line by line, now and then."""
    from ..sweeps.workers import words

    last = [perf_counter()]

    def report(now: Progress) -> None:
        if perf_counter() - last[0] > EVERY:
            last[0] = perf_counter()
            say(f"{now.done} of {now.members} members, {words(now)}")

    return report


def _draw(store: Path, plotted: list[str], figure: Path, force: bool) -> None:
    from ..plot.journals import require_places, save
    from ..sweeps.figure import draw

    require_places(figure, force=force)
    save(draw(store, plotted[:-1], plotted[-1]), figure, force=force)
    say(f"written: {figure}")


def _rerun(store: Path, member: int, out: Path, force: bool) -> None:
    from ..io import save_run
    from ..io.whole import require_free, written
    from ..sweeps import sweep_member
    from ..sweeps.reading import member_file
    from ..sweeps.store import open_store

    require_suffix(out, ".nc", ".toml")
    require_free(out, force=force)
    command = "run" if out.suffix.lower() == ".toml" else "view"
    if command == "run":
        text = member_file(open_store(store), member).text(sweep=False)
        with written(out, force=force) as file:
            file.write(text.encode())
    else:
        save_run(sweep_member(store, member), out, force=force)
    say(f"written: {out}; {hint(f'nontwist {command} {typed(out)}')}")

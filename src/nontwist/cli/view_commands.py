"""`nontwist view` and `nontwist play`: pages on which runs can be watched, and bodies kicked."""

from __future__ import annotations

import math
import shlex
import shutil
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import nontwist

from ..errors import SimulationError
from ..io.whole import require_free
from ..recordings.options import ReadOptions
from ..spec import specs
from .outcomes import about, require_readable
from .printing import Dataset, say
from .shared_options import Force, Opt, argument, given_again, numbers_of, refuse, require_suffix

if TYPE_CHECKING:
    from ..viewer import View

FAR, DRAWN = 0.1, 20_000  # rad between states that are drawn as they are; states that are drawn, and steps for them
STEPS = 10**6  # of a run whose states are completed, which takes as long as the run

Show = Annotated[bool, Opt("Open the page in the browser.", option="--open/--no-open")]


LENGTH = Opt(
    "Length of the film until its last picture, which stands for 1.5 s; the length of the run shows it in real time.",
    "SECONDS",
    default="8",
    least=0.1,
)
FPS = Opt(
    "Pictures per second of the film; a GIF shows each for whole hundredths of a second: 15 becomes 14.3.",
    "RATE",
    default="12.5 (GIF), 25 (MP4)",
    least=0.1,
    most=50,
)
WIDTH = Opt(
    "Width of the whole film or picture.",
    "PIXELS",
    default="for each run 480 (GIF), 720 (MP4), 960 (PNG)",
    least=100,
    most=4096,
)
CAMERA = Opt(
    "Direction from which films and pictures are seen, degrees: 35,20.",
    "AZIMUTH,ELEVATION",
    default="from the side of the paths; under gravity from above the horizon",
    parser=lambda text: numbers_of(text, "two angles like 35,20"),
)
LABELS = Opt(
    "Name of the run; of two, separated by a comma.",
    "A[,B]",
    default="titles, or kinds of the bodies, with the names of the files where they are equal",
)
TITLE = Opt("Title of the page, film or picture.", "TEXT", default="that of the run file")


def view_command(
    ctx: typer.Context,
    run: Annotated[Path, argument("RUN", "Run or twist result (NetCDF), or recording of any format.")],
    other: Annotated[Path | None, argument("[RUN2]", "Second run or recording, shown next to RUN.")] = None,
    *,
    reading: ReadOptions,
    first: Annotated[float | None, Opt("Start of the part to show, s.", "T", "--from", default="the start")] = None,
    last: Annotated[float | None, Opt("End of the part to show, s.", "T", "--to", default="the end")] = None,
    out: Annotated[Path | None, Opt("Page to write (.html).", "PATH", default="RUN-view.html here")] = None,
    gif: Annotated[Path | None, Opt("Write a film instead (.gif).", "PATH")] = None,
    mp4: Annotated[Path | None, Opt("Write a film instead (.mp4); needs ffmpeg.", "PATH")] = None,
    png: Annotated[Path | None, Opt("Write a picture of one moment instead (.png).", "PATH")] = None,
    at: Annotated[float | None, Opt("Time of --png.", "SECONDS", default="the end")] = None,
    seconds: Annotated[float | None, LENGTH] = None,
    fps: Annotated[float | None, FPS] = None,
    width: Annotated[int | None, WIDTH] = None,
    camera: Annotated[Any, CAMERA] = None,
    dark: Annotated[bool, Opt("Use the colours of the dark page in films and pictures.")] = False,
    labels: Annotated[str | None, LABELS] = None,
    title: Annotated[str | None, TITLE] = None,
    show: Show = True,
    force: Force = False,
) -> None:
    """Write an offline page that animates runs or recordings: body, frame, twist, momenta, energy.

    Options from --columns to --time-unit define how recordings are read, as in nontwist twist; a recording shows its
    twist about the z axis. States of a run that are far apart, as those of a run to a tolerance, are completed by
    states in between. --from and --to choose a part; the twist of runs and recordings counts from its start. The page
    is one HTML file of 60 to 500 kB, up to 1 MB for two runs. --gif, --mp4 and --png write a film or a picture of the
    same scene, without a browser. Exits with status 3 if a file contains neither a run nor a motion, and with
    status 5 if a file cannot be read or written, or exists already.
    """
    from ..viewer.films import NO_FFMPEG, save_film, save_still

    if out is not None:
        kind = out.suffix.lower()
        hint = f"; {kind.replace('.', '--')} {out} writes that" if kind in (".gif", ".mp4", ".png") else ""
        require_suffix(out, ".html", instead=hint)
    given_films = {".gif": gif, ".mp4": mp4, ".png": png}
    films = {path: kind for kind, path in given_films.items() if path is not None}
    for path, kind in films.items():
        require_suffix(path, kind, option=f"--{kind[1:]}")
    is_empty = first is not None and last is not None and first >= last
    refuse(
        (mp4 is not None and shutil.which("ffmpeg") is None, "--mp4", NO_FFMPEG),
        (is_empty, "--to", f"must be after --from, {first or 0:g}, got {last or 0:g}"),
        (at is not None and png is None, "--at", "applies to --png only; add --png PATH"),
    )
    moving = [path for path in (gif, mp4) if path is not None]
    by_page = "; add one of them. The page follows the system, and has a button"
    refuse((dark and not films, "--dark", f"applies to --gif, --mp4 and --png only{by_page}"))
    for option, value in {"--width": width, "--camera": camera, "--seconds": seconds, "--fps": fps}.items():
        is_still = option in ("--width", "--camera")
        kinds, found = ("--gif, --mp4 and --png", films) if is_still else ("--gif and --mp4", moving)
        refuse((value is not None and not found, option, f"applies to {kinds} only; add one of them"))
    names = None
    if labels is not None:  # one run alone may have a comma in its label
        names = [labels] if other is None else [label.strip() for label in labels.split(",")]
    target = None if films and out is None else out or Path(f"{run.stem}-view.html")
    inputs = [run] if other is None else [run, other]
    is_odd = names is not None and len(names) != len(inputs)
    refuse((is_odd, "--labels", f"{labels!r} is not two labels, A,B, without other commas"))
    for path in inputs:
        if not path.exists():
            raise FileNotFoundError(f"no such file: {path}")
    given = given_again(ctx, specs(ReadOptions))
    if given:
        refuse((all(map(_is_result, inputs)), given[0], f"applies to recordings only; {run} is a result"))
    require_free(*films, *([] if target is None else [target]), force=force)
    runs = [_read(path, reading, slice(first, last), given) for path in inputs]
    page = nontwist.view(*runs, title=title, labels=names) if target is not None else None
    look: dict[str, Any] = {"width": width, "labels": names, "title": title, "camera": camera, "dark": dark}
    for path in moving:
        save_film(runs, path, seconds=seconds, rate=fps, force=force, **look)
    if png is not None:
        save_still(runs, png, at, force=force, **look)
    for path in films:
        say(f"written: {path} ({path.stat().st_size / 1e3:.0f} kB)")
    if page is not None and target is not None:
        _deliver(page, target, show, force)


def _is_result(path: Path) -> bool:
    return path.suffix.lower() == ".nc"


def _read(path: Path, how: ReadOptions, span: slice, given: list[str]) -> Any:
    """Return a part of a run, of what `nontwist twist` has written, or of the twist of a recording about its z axis.

    A recording is read as `how` says, which was typed as `given`.
    """
    require_readable(path)
    if _is_result(path):
        run = nontwist.open_run(path)
        with about(str(path), ValueError):
            return _smooth_part(path, run, span)
    with about(str(path), ValueError):
        motion = nontwist.read_motion(path, **vars(how))
        found = nontwist.twist(_part(motion, span))
    found.encoding["source"] = str(path)
    say(f"{path}: twist about the z axis; {motion.attrs['notes']}")
    again = shlex.join(["nontwist", "twist", str(path), *given, "--axis", "AXIS"])
    say(f"to choose the axis: {again}, then nontwist view of its result")
    return found


def _part(data: Any, span: slice) -> Dataset:
    part: Dataset = data
    if span == slice(None) or "time" not in data.indexes:
        return part
    part, time = data.sel(time=span), data["time"].values
    if part.sizes["time"] < 2:
        raise ValueError(
            f"--from and --to choose {part.sizes['time']} of {time.size} states, which are from {time[0]:g} s to "
            f"{time[-1]:g} s; at least 2 are needed"
        )
    return part


def _smooth_part(path: Path, run: Dataset, span: slice) -> Dataset:
    """Return a part of a run, its states completed where they are far apart; or warn that they are."""
    from ..viewer.content import FAR, NEEDED, STATES

    has_all = {"quaternion", "material_angular_velocity", *NEEDED} <= {*run.data_vars}
    if "member" in run.dims or "time" not in run.indexes or run.sizes["time"] < 2 or not has_all:
        return _part(run, span)
    time = run["time"].values
    try:
        if float(time[-1] - time[0]) > STEPS * float(run.attrs.get("step", math.inf)):
            raise ValueError(f"it has more than {STEPS} steps")
        ends = (-math.inf if span.start is None else span.start, math.inf if span.stop is None else span.stop)
        part = smooth(run, span=ends, most=STATES)
        return part if part.sizes["time"] > 1 else _part(run, span)
    except (ValueError, SimulationError) as error:
        part = _part(run, span)
        if (turn := largest_turn(part)) > FAR:
            reason = str(error).partition(";")[0]  # its remedy is one for Python
            say(
                f"warning: {path}: the body turns by up to {turn:.2g} rad between stored states, and these cannot be "
                f"completed ({reason}): what is drawn in between is interpolated; run it with more states, times= or "
                "store= of simulate, time.times or time.store of a run file"
            )
        return part


def largest_turn(run: Dataset) -> float:
    """Return the largest rotation from one state of a run to the next, rad."""
    from ..geometry.attitudes import turns

    p = run["quaternion"].transpose("time", ...).values
    return float(turns(p[:-1], p[1:]).max(initial=0.0))


def smooth(
    run: Dataset, load: nontwist.Load | None = None, span: tuple[float, float] | None = None, most: int = DRAWN
) -> Dataset:
    """Return a run, or a span of it, with more states where its own lie far apart; at most about `most`.

    A ValueError or a SimulationError says why there can be none: a load of functions, or one that ends here.
    """
    import numpy as np

    time = run["time"].values
    first, last = (time[0], time[-1]) if span is None else np.clip(span, time[0], time[-1])
    part = run.sel(time=slice(first, last))
    if first == last or len(part["time"]) >= most or largest_turn(run) <= FAR:
        return part
    speed = float(np.linalg.norm(run["material_angular_velocity"], axis=1).max())
    count, own = min(np.ceil((last - first) * speed / FAR), most), np.unique([first, *part["time"].values, last])
    parts = np.ceil(np.diff(own) * (count / (last - first)))  # of each interval between stored states
    ends = np.append(0.0, np.cumsum(parts))
    found = nontwist.resample(run, np.interp(np.arange(ends[-1] + 1), ends, own), load)
    return found.assign({name: one for name, one in run.items() if name not in found and "time" not in one.dims})


def play_command(
    out: Annotated[Path, Opt("Page to write (.html).", "PATH")] = Path("playground.html"),
    show: Show = True,
    force: Force = False,
) -> None:
    """Write and open the playground: two bodies get the same kick, and one of them may not twist.

    The page is one HTML file that works offline, with mouse, touch or keyboard. The browser integrates a standard and a
    non-twisting body, or heavy tops, or a Suslov body live, and copies their inputs as Python or as run files with all
    digits. Exits with status 5 if the file cannot be written, or exists already.
    """
    from ..playground import playground

    require_suffix(out, ".html")
    _deliver(playground(), out, show, force)


def _deliver(page: View, target: Path, show: bool, force: bool) -> None:
    written, size = page.save(target, force=force), len(page.html.encode())
    say(f"written: {written} ({f'{size / 1e6:.1f} MB' if size > 1e6 else f'{size / 1e3:.0f} kB'})")
    if show and not webbrowser.open(written.resolve().as_uri()):
        say(f"no browser was found; open {written} in one")

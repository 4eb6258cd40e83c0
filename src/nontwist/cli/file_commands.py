"""`nontwist example` and `nontwist schema`: how a run file is written."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Annotated

import typer

from .options import Debug, Force, require_suffix
from .outcomes import say
from .summaries import hint, print_rows, typed


def example_names() -> list[str]:
    """Return the names of the run files that come with the package."""
    folder = files("nontwist.runfile").joinpath("examples")
    return sorted(place.name.removesuffix(".toml") for place in folder.iterdir() if place.name.endswith(".toml"))


def example_command(
    name: Annotated[
        str | None,
        typer.Argument(metavar="NAME", help="Example to copy.", show_default="list all", autocompletion=example_names),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            help="File (.toml) or folder to copy to; - for standard output.",
            show_default="NAME.toml here",
        ),
    ] = None,
    force: Force = False,
    debug: Debug = False,
) -> None:
    """List the bundled run files, or copy one to start from."""
    from ..geometry.values import nearest
    from ..io.whole import written

    texts = {name: _text(name) for name in example_names()}
    if name is None:
        return _list(texts)
    if name not in texts:
        raise typer.BadParameter(f"there is no example {name!r}; {nearest(name, texts)}")
    if out is not None and str(out) == "-":
        typer.echo(texts[name], nl=False)
        return None
    target = Path(f"{name}.toml") if out is None else out / f"{name}.toml" if out.is_dir() else out
    require_suffix(target, ".toml")
    with written(target, force=force) as file:
        file.write(texts[name].encode())
    command = "sweep" if "[sweep]" in texts[name] else "run"
    say(f"written: {target}; {hint(f'nontwist check {typed(target)}', f'nontwist {command} {typed(target)}')}")
    return None


def schema_command(debug: Debug = False) -> None:
    """Print the JSON Schema of run files, for editors that complete and validate them."""
    from ..runfile.document import json_schema

    typer.echo(json.dumps(json_schema(), indent=2, ensure_ascii=False))


def _text(name: str) -> str:
    return files("nontwist.runfile").joinpath("examples", f"{name}.toml").read_text(encoding="utf-8")


def _list(texts: dict[str, str]) -> None:
    print_rows("Examples", {name: text.splitlines()[0].removeprefix("# ") for name, text in texts.items()})
    say(hint("nontwist example NAME"))

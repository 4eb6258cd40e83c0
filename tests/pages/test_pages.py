"""What the pages tell a reader to type: Python runs, commands exist with their options, and commands of examples run.

Pages that myst-nb executes run when the site is built; of them only the commands are looked at.
"""

import ast
import re
import shlex
import shutil
import subprocess
import webbrowser
from importlib import import_module
from pathlib import Path
from textwrap import dedent

import click
import pytest
import typer

from conftest import ended
from nontwist.cli import app

ROOT = Path(__file__).parents[2]
TEXTS = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
}
FENCE = re.compile(r"^```([\w{}-]*)[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
NOT_RUN = {
    "docs/contributing/body.md": "test_newcomers runs it, and takes the body out again",
    "docs/gallery.md": "test_examples runs the script that made it and compares the page",
    "docs/howto/autodiff.md": "PyTorch, which is not here",
    "docs/howto/clusters.md": "SLURM, Kubernetes and hosts that are not here",
}
NOT_TYPED = {"docs/howto/clusters.md": "hosts and folders that are not here"}


def blocks(name, *languages):
    return [dedent(code) for language, code in FENCE.findall(TEXTS[name]) if language in languages]


def typed(name):
    """The lines that begin with `nontwist` in what is to be typed, without their comments."""
    lines = [line for code in blocks(name, "", "text", "bash", "{code-cell}") for line in code.splitlines()]
    return [line.removeprefix("!") for line in lines if line.removeprefix("!").startswith("nontwist ")]


def mentioned(name):
    prose = FENCE.sub("", TEXTS[name])
    return [span.replace("\n", " ") for span in re.findall(r"`(nontwist [^`]+)`", prose)]


PYTHON = [name for name in TEXTS if blocks(name, "python")]
RUN = [name for name in TEXTS if typed(name) and "mystnb" not in TEXTS[name][:40] and name not in NOT_TYPED]


@pytest.fixture
def place(tmp_path, monkeypatch):
    """An empty folder with examples/ in it, as in a clone."""
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(webbrowser, "open", lambda address: True)
    return tmp_path


def nontwist(line):
    return ended(0, *shlex.split(line, comments=True)[1:])


def supply(name, path):
    """Make a file that a page speaks of as the reader's own."""
    if path.name == "axes.toml":
        sweep = next(code for code in blocks(name, "toml") if "[sweep]" in code)
        nontwist("nontwist example suslov --out axes.toml")
        run = path.read_text(encoding="utf-8").replace("[time]", "[time]\nstep = 0.05")  # one for all members
        run = run.replace("[start]", "[start]\nproject = true").replace("t_end = 60.0", "t_end = 1.0")
        path.write_text(f"{run}\n{sweep.replace('20_000', '8')}", encoding="utf-8")
    elif path.suffix == ".toml":
        nontwist(f"nontwist example {path.stem}")
        text = path.read_text(encoding="utf-8")
        path.write_text(re.sub(r"^t_end = .*", "t_end = 0.1", text, flags=re.MULTILINE), encoding="utf-8")
    elif path.name in ("run.nc", "other.nc"):
        nontwist("nontwist example suslov --force")
        nontwist(f"nontwist run suslov.toml --out {path}")


def test_reasons_are_of_pages():
    assert {name for name in NOT_RUN if name in TEXTS} <= {*PYTHON}
    assert {"README.md", "docs/run-files.md"} <= {*PYTHON}
    assert "docs/run-files.md" in RUN


def test_python_blocks():
    for name in PYTHON:
        for node in (node for code in blocks(name, "python") for node in ast.walk(ast.parse(code))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "nontwist":
                module = import_module(node.module)
                assert [alias.name for alias in node.names if not hasattr(module, alias.name)] == [], name


@pytest.mark.parametrize("name", [name for name in PYTHON if name not in NOT_RUN])
def test_python_runs(name, place):
    nontwist("nontwist example heavy_top")
    for code in blocks(name, "c"):
        file, command = re.match(r"/\* (\S+): (.*) \*/", code).groups()
        if shutil.which("cc") is None:
            pytest.skip("there is no C compiler")
        Path(file).write_text(code, encoding="utf-8")
        subprocess.run(command.split(), check=True)
    space = {}
    for code in blocks(name, "python"):
        exec(compile(code, name, "exec"), space)


@pytest.mark.parametrize("name", ["README.md", "docs/index.md"])
def test_first_pages_print_this(name, place, capsys):
    exec(compile(blocks(name, "python")[0], name, "exec"), {})
    assert f"`{capsys.readouterr().out.strip()}`" in TEXTS[name]
    result = nontwist("nontwist twist examples/imu/quaternion.csv --inverse --degrees --no-figure")
    stated = re.search(r"−(\S+°), (sampling ± \S+°), (noise ± \S+°)", TEXTS[name])
    assert all(number in result.output for number in (f"-{stated[1]}", *stated.groups()[1:]))


def test_run_files_are_in_order(place):
    for code in (code for name in TEXTS for code in blocks(name, "toml") if "[body]" in code):
        (place / "run.toml").write_text(code, encoding="utf-8")
        nontwist("nontwist check run.toml")


def test_commands_and_their_options_exist():
    group = typer.main.get_command(app)
    for line in (line for name in TEXTS for line in (*typed(name), *mentioned(name))):
        words = shlex.split(re.split(r" [>|] ", line)[0], comments=True)[1:]
        _, words, _ = group.make_parser(click.Context(group)).parse_args(words)
        if words:
            command = group.commands[words[0]]
            _, rest, _ = command.make_parser(click.Context(command)).parse_args(words[1:])
            assert rest == [], line


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("name", RUN)
def test_commands_run(name, place):
    for line in typed(name):
        for word in shlex.split(line, comments=True)[1:]:
            if not Path(word).exists():
                supply(name, Path(word))
        nontwist(line)


def test_targets_of_make_exist():
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    for name, text in TEXTS.items():
        told = re.findall(r"`make ([\w-]+)`", text) + re.findall(r"^make ([\w-]+)", text, re.MULTILINE)
        assert {target for target in told if target not in targets} == set(), name


def test_links_between_files_lead_somewhere():
    for path in ROOT.glob("*.md"):
        for link in re.findall(r"\]\(([^)#\s]+)", path.read_text(encoding="utf-8")):
            assert "://" in link or (ROOT / link).exists(), f"{path.name}: {link}"

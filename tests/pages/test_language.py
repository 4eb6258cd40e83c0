"""Pages, help and messages in plain English: phrases that the style sheet in CONTRIBUTING.md replaces are not there.

`BANNED` is read from the table of the style sheet, so that the two agree. A phrase in italics there, *like this*,
counts in pages, help texts, messages and docstrings of public functions.
"""

import ast
import inspect
import re
from importlib import import_module
from pathlib import Path

from typer.main import get_command

import nontwist
from nontwist.cli import app
from nontwist.cli.shared_options import meaning

ROOT = Path(__file__).parents[2]
SHEET = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
PAGES = {path: path.read_text(encoding="utf-8") for path in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]}
PAGES.pop(ROOT / "docs" / "performance.md", None)  # written by `make bench`, which does not read the style sheet
TABLE = re.search(r"\| instead of \| write \|\n\|[-|]+\|\n((?:\|.*\n)+)", SHEET)[1]
ROWS = [[cell.strip() for cell in line.strip("|").split("|")] for line in TABLE.splitlines()]
BANNED = {phrase: row[1] for row in ROWS for phrase in re.findall(r"\*([^*]+)\*", row[0])}
PATTERN = re.compile("|".join(rf"\b{re.escape(phrase)}\b" for phrase in BANNED), re.IGNORECASE)
SPACES = [name for name in nontwist.__all__ if inspect.ismodule(getattr(nontwist, name))]
NAMESPACES = ("nontwist", *(f"nontwist.{name}" for name in SPACES))


def found(text):
    """The banned phrases of a text, with what to write; code, and quotations of *what not to write*, do not count."""
    plain = re.sub(r"```.*?```|``[^`]+``|`[^`]+`", " X ", text, flags=re.DOTALL)
    return [f"{match[0]!r}: write {BANNED[match[0].lower()]}" for match in PATTERN.finditer(" ".join(plain.split()))]


def messages():
    """Every text in the package that is not a docstring, and where, of modules in which there is a banned phrase."""
    for path in sorted((ROOT / "src" / "nontwist").rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if not PATTERN.search(" ".join(re.sub(r'"\s+f?"', "", text).split())):
            continue
        nodes = list(ast.walk(ast.parse(text)))
        alone = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
        for node in nodes:
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in alone:
                yield f"{path.relative_to(ROOT).as_posix()}:{node.lineno}", node.value


def public_docstrings():
    for name in NAMESPACES:
        package, _, attribute = name.partition(".")
        space = getattr(import_module(package), attribute) if attribute else import_module(package)
        for one in getattr(space, "__all__", [key for key in vars(space) if not key.startswith("_")]):
            thing = getattr(space, one)
            if callable(thing) and (thing.__module__ or "").startswith("nontwist"):
                yield f"{name}.{one}", inspect.getdoc(thing) or ""


def test_the_style_sheet_bans_something():
    assert {"goes on", "leaves with", "holds it against", "left aside"} <= BANNED.keys()
    assert found("It goes on, and *leaves with 1*.") == [
        "'goes on': write resumes, continues",
        "'leaves with': write exits with status",
    ]
    assert found("`goes on` is code; so is\n```\nleaves with\n```") == []


def test_pages():
    assert {page.name: wrong for page, text in PAGES.items() if (wrong := found(text))} == {}


def test_messages():
    assert {place: wrong for place, text in messages() if (wrong := found(text))} == {}


def test_messages_speak_python():
    """Of the library: commands put their own words in the place of ``{option[force=True]}``."""
    both = re.compile(r"--[a-z][\w-]*[^\"]* ?\(?[a-z_]+=")
    for path in (ROOT / "src" / "nontwist").rglob("*.py"):
        if path.parent.name != "cli":
            nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            texts = [node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)]
            assert [text for text in texts if both.search(text) and "\n" not in text] == [], path


def test_docstrings_of_public_functions():
    assert {name: wrong for name, text in public_docstrings() if (wrong := found(text))} == {}


def test_help():
    for name, command in get_command(app).commands.items():
        assert found(command.help) == [], name
        assert [wrong for parameter in command.params for wrong in found(meaning(parameter))] == [], name


def test_text_files_name_their_encoding():
    """Else it is that of the locale: ASCII under ``LC_ALL=C``."""
    unnamed = []
    for path in (path for folder in ("tests", "benchmarks") for path in (ROOT / folder).rglob("*.py")):
        calls = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
        calls = [call for call in calls if getattr(call.func, "attr", "") in ("read_text", "write_text")]
        unnamed += [(path, call.lineno) for call in calls if all(one.arg != "encoding" for one in call.keywords)]
    assert unnamed == []


def test_names_of_tests():
    """At most five words."""
    texts = [path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py")]
    assert [
        name for text in texts for name in re.findall(r"^(?:def )?(test(?:_[^\W_]+){6,})(?:\(| =)", text, re.MULTILINE)
    ] == []

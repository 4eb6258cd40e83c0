"""`.. public:: nontwist.plot` and the names below it: a table with a line for each, and a page for each.

The names of all such directives are collected; the build warns of public names that no page has, and of names that two
pages have.
"""

import inspect
import re
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from docutils.nodes import Node
from sphinx.addnodes import desc_signature
from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

SPACES = "nontwist", "nontwist.results", "nontwist.inertia", "nontwist.split_form"
PAGES = "api"  # the folder of the pages, made before the others are read
LISTED = re.compile(r"^\.\. public:: (\S+)\n\n((?: {3}\S.*\n)+)", re.MULTILINE)
logger = logging.getLogger(__name__)
CLASS = (
    "   :members:",
    "   :special-members: __call__",
    "   :member-order: bysource",
    "   :exclude-members: model_config, model_post_init, linear, motion, needs, stages, text",  # of integrators
)


def namespace_of(module: str) -> Any:
    """Return what ``nontwist.sphere`` and its like name: the package or an attribute of it."""
    package, _, name = module.partition(".")
    return getattr(import_module(package), name) if name else import_module(package)


def public(module: str) -> set[str]:
    """Return the public names of a module, its namespaces left out: `__all__`, or what it defines itself."""
    namespace = namespace_of(module)
    own = [name for name, value in vars(namespace).items() if getattr(value, "__module__", "") == namespace.__name__]
    names = getattr(namespace, "__all__", [name for name in own if not name.startswith("_") and name.islower()])
    here = {name for name in names if not inspect.ismodule(getattr(namespace, name))}
    return here if module == "nontwist" else here - set(import_module("nontwist").__all__)


def comment(namespace: Any, name: str) -> list[str]:
    """Return the string that stands below a constant where it is defined."""
    home = getattr(namespace, "_HOME", {}).get(name, namespace.__name__)
    analyzer = ModuleAnalyzer.for_module(home)
    return [f"   {line}" for line in analyzer.find_attr_docs()["", name]]


class Public(SphinxDirective):
    """List the names in the content, which `module` offers, each with its first sentence and a page of its own."""

    required_arguments = 1
    has_content = True

    def run(self) -> list[Node]:
        """Return a table of the names, and a tree of their pages."""
        module, names = self.arguments[0], " ".join(self.content).split()
        told = getattr(self.env, "public_names", None) or {}
        self.env.public_names = told
        for name in names:
            told.setdefault(module, {}).setdefault(name, set()).add(self.env.docname)
        table = [".. autosummary::", "   :nosignatures:", "", *(f"   ~{module}.{name}" for name in names), ""]
        tree = [".. toctree::", "   :hidden:", "", *(f"   {PAGES}/{module}.{name}" for name in names), ""]
        return self.parse_text_to_nodes("\n".join(table + tree))


class Entry(SphinxDirective):
    """Document a name that a module offers: all that its docstring says."""

    required_arguments = 2

    def run(self) -> list[Node]:
        """Return the entry."""
        module, name = self.arguments
        namespace = namespace_of(module)
        if inspect.isclass(getattr(namespace, name)):
            lines = [f".. autoclass:: {module}.{name}", *CLASS, ""]
        elif callable(getattr(namespace, name)):
            lines = [f".. autofunction:: {module}.{name}", ""]
        else:
            lines = [f".. autodata:: {module}.{name}", "   :no-value:", "", *comment(namespace, name), ""]
        entries = self.parse_text_to_nodes("\n".join(lines))
        for entry in entries:
            for signature in entry.findall(desc_signature):
                for space in SPACES:  # to which pages of sources with names of several lead
                    if (place := f"{space}.{signature['fullname']}") not in self.state.document.ids:
                        signature["ids"].append(place)
                        self.state.document.ids[place] = signature
        return entries


def make_pages(app: Sphinx) -> None:
    """Write a page for each name that a page of the reference lists, and remove those that none lists."""
    reference = Path(app.srcdir) / "reference"
    pages = {}
    for page in reference.glob("*.md"):
        for module, content in LISTED.findall(page.read_text(encoding="utf-8")):
            for name in content.split():
                text = f"{name}\n{'=' * len(name)}\n\n.. entry:: {module} {name}\n"
                pages[reference / PAGES / f"{module}.{name}.rst"] = text
    (reference / PAGES).mkdir(exist_ok=True)
    for old in {*(reference / PAGES).iterdir()} - pages.keys():
        old.unlink()
    for place, text in pages.items():
        if not place.exists() or place.read_text(encoding="utf-8") != text:
            place.write_text(text, encoding="utf-8")


def complain(app: Sphinx, env: object) -> None:
    """Warn of public names that no page has, and of those that are on two."""
    told: dict[str, dict[str, set[str]]] = getattr(env, "public_names", {})
    package = import_module("nontwist")
    spaces = [f"nontwist.{name}" for name in package.__all__ if inspect.ismodule(getattr(package, name))]
    for module in ("nontwist", *spaces):
        for name in sorted(public(module) - told.get(module, {}).keys()):
            logger.warning("no page of the reference has %s.%s", module, name)
        for name, pages in told.get(module, {}).items():
            if len(pages) > 1:
                logger.warning("%s.%s stands on %s", module, name, " and ".join(sorted(pages)))


def merge(app: Sphinx, env: Any, docnames: set[str], other: Any) -> None:
    """Add the names that another process has met to those of this one."""
    told = env.public_names = getattr(env, "public_names", None) or {}
    for module, names in (getattr(other, "public_names", None) or {}).items():
        for name, pages in names.items():
            told.setdefault(module, {}).setdefault(name, set()).update(pages)


def without_factories(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, signature: str | None, returns: str | None
) -> tuple[str | None, str | None] | None:
    """Return the signature of a data class with ``None``, or ``...``, for the defaults that functions make."""
    if what != "class" or not is_dataclass(obj) or "=<factory>" not in (signature or ""):
        return None
    for field in fields(obj):
        if callable(field.default_factory):
            default = "None" if field.default_factory() is None else "..."
            signature = str(signature).replace(f"{field.name}=<factory>", f"{field.name}={default}")
    return signature, returns


def setup(app: Sphinx) -> dict[str, bool]:
    """Offer the directive and check that it has been given every name."""
    app.add_directive("public", Public)
    app.add_directive("entry", Entry)
    app.connect("builder-inited", make_pages)
    app.connect("autodoc-process-signature", without_factories)
    app.connect("env-merge-info", merge)
    app.connect("env-check-consistency", complain)
    return {"parallel_read_safe": True}

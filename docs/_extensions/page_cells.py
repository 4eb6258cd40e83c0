"""Cells of pages run in copies of the process that builds the site, which has loaded and compiled what most runs need.

Of what they print, lines that depend on the machine are left out: what they wait for, and where warnings were raised.
The alternative text of a figure that a cell draws is the title of its section.
"""

import faulthandler
import json
import os
import re
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import matplotlib
import rich
from docutils import nodes
from IPython.core.interactiveshell import InteractiveShell
from IPython.utils.capture import capture_output
from jupyter_client.jsonutil import json_default
from myst_nb.core.execute import NotebookClientDirect
from nbformat import NotebookNode
from nbformat.v4 import new_output
from sphinx.application import Sphinx

import nontwist.cli
import nontwist.fitting  # noqa: F401
from nontwist import nontwisting, plot, simulate, standard

COPY = get_context("fork" if os.name == "posix" else "spawn")
WAITING = re.compile(r"^nontwist: (loading|compiling) .*\.\.\.\n?", re.MULTILINE)
PLACE = re.compile(r"^<ipython-input-\S+: (\w*Warning: .*)\n  .*\n", re.MULTILINE)


def ran(page, cells):
    """Return the cells of a page with what they print and show; raise an error where one fails."""
    os.chdir(page.parent)
    shell = InteractiveShell.instance(colors="nocolor")
    shell.displayhook.write_output_prompt = lambda: None
    shell.displayhook.write_format_data = lambda *shown: shell.display_pub.publish(*shown)
    matplotlib.use("module://matplotlib_inline.backend_inline")
    rich.reconfigure(width=115)  # of tables, as in a notebook
    for cell in (cell for cell in cells if cell.cell_type == "code"):
        faulthandler.dump_traceback_later(900, exit=True, file=sys.__stderr__)  # a cell that does not end
        with capture_output() as said:
            done = shell.run_cell(cell.source, store_history=True)
        if not done.success:
            raise RuntimeError(f"{page}\n{cell.source}\n{said.stdout}{said.stderr}")
        shown = [(json.loads(json.dumps(one.data, default=json_default)), one.metadata or {}) for one in said.outputs]
        cell.outputs = [new_output("display_data", data, metadata=metadata) for data, metadata in shown]
        for name in ("stderr", "stdout"):
            if text := PLACE.sub(r"\1\n", WAITING.sub("", getattr(said, name))).rstrip():
                cell.outputs.insert(0, new_output("stream", name=name, text=text))
    return cells


def run(client):
    """Run the cells of a page."""
    with ProcessPoolExecutor(1, COPY) as copy:
        client.notebook.cells = copy.submit(ran, client.path, client.notebook.cells).result()
    client.notebook.metadata.language_info = NotebookNode(pygments_lexer="ipython3")


def with_texts(app: Sphinx, doctree: nodes.document) -> None:
    """Give the figures of cells a text."""
    for image in doctree.findall(nodes.image):
        section = image.parent
        while section is not None and not isinstance(section, nodes.section):
            section = section.parent
        if section is not None and not image.get("alt"):
            image["alt"] = f"Figure: {section.next_node(nodes.title).astext()}"


def setup(app: Sphinx) -> dict[str, bool]:
    """Run cells in this way, and give figures their texts when a page has been read."""
    for body in (standard([2, 3, 4]), nontwisting([2, 3, 4])):  # for all pages
        plot.path(simulate(body, t_end=1, material_angular_velocity=(1, 1, 0)))._repr_png_()
    NotebookClientDirect.start_client = run
    app.connect("doctree-read", with_texts)
    return {"parallel_read_safe": True}

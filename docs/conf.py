"""The documentation: `make docs`. Pages are MyST Markdown, tutorials run when they are built, nothing is fetched."""

import sys
from pathlib import Path

import nontwist

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))

project = "nontwist"
author = "The nontwist developers"
copyright = "2026, the nontwist developers"
release = version = nontwist.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.viewcode",
    "sphinx_codeautolink",
    "numpydoc",
    "myst_nb",
    "sphinx_design",
    "native_mathml",
    "plain_docstrings",
    "public_names",
    "command_line",
    "equation_numbers",
    "page_cells",
    "playground_page",
    "theory_pictures",
    "glossary_links",
    "name_links",
]
exclude_patterns = ["_build", "_extensions"]
html_theme = "pydata_sphinx_theme"
html_title = "nontwist"
html_theme_options = {
    "show_toc_level": 2,
    "navigation_with_keys": True,
    "footer_start": ["copyright"],
    "footer_end": [],
}
html_context = {"default_mode": "auto"}  # light or dark, as the reader's system is
html_sidebars = {page: [] for page in ("index", "getting-started", "faq", "glossary")}
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = ["playground.js"]
html_show_sourcelink = False
html_domain_indices = False

myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_merge_streams = True
suppress_warnings = ["config.cache"]  # blocks of code have a function among their settings

autosummary_generate = True
autodoc_typehints = "none"
numpydoc_show_class_members = False
python_maximum_signature_line_length = 88
toc_object_entries_show_parents = "hide"
default_role = "py:obj"
codeautolink_custom_blocks = {"ipython3": "sphinx_codeautolink.clean_ipython"}  # cells of pages that run
codeautolink_concat_default = True  # names imported in one cell are known in the next
highlight_language = "none"  # of blocks in docstrings: formulas; examples with >>> are seen as such
smartquotes = False  # quotes and dashes of docstrings and commands are code
nitpicky = False


def tell(app, docname, content):
    """Print the page that is read: several processes read, and Sphinx tells only when a dozen pages are done."""
    print(f"reading {docname}", file=app._status, flush=True)


def setup(app):
    """Print progress."""
    app.connect("source-read", tell)

"""Settings of the site. `docs/build.py` copies this folder, adds what it takes from the code, and builds."""

import contextlib
import enum
import inspect
import os
import re
import sys
from collections import Counter
from functools import cache
from pathlib import Path

from docutils import nodes
from numpydoc.xref import DEFAULT_LINKS
from sphinx.addnodes import pending_xref
from sphinx.transforms import SphinxTransform

import pinmobile

HERE = Path(__file__).parent
ROOT = Path(
    os.environ.get("PINMOBILE_ROOT") or HERE.parents[2]
)  # the build may be elsewhere
sys.path[:0] = [str(HERE / "_ext"), str(ROOT / "docs")]

from public import TOPICS, find, public, spelled  # noqa: E402

project, author, copyright = (
    "pinmobile",
    "The pinmobile developers",
    "The pinmobile developers, BSD-3-Clause",
)
version = release = pinmobile.__version__
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "numpydoc",
    "myst_nb",
    "sphinx_design",
    "sphinx_copybutton",
    "sphinx_codeautolink",
    "sphinx_gallery.gen_gallery",
    "recording",
]
exclude_patterns = [
    "_build",
    "gallery/*.ipynb",
    "**/sg_execution_times.rst",
    "sg_execution_times.rst",
    "reference/backreferences",
]
templates_path = ["_templates"]
default_role = "py:obj"
add_module_names = False
toc_object_entries_show_parents = "hide"
smartquotes = False  # --film is no dash
nitpicky = True
# Read the Docs has no browser that draws the stills of recordings: its previews say so.
suppress_warnings = ["recording.still"] if os.environ.get("READTHEDOCS") else []
nitpick_ignore_regex = [
    (
        r"py:.*",
        r"(pin|pinocchio|scipy|numpy|np|distributed|xarray|matplotlib|sympy|attrs)(\..*)?",
    )
]

# Notebooks show the outputs that are stored in them: the tests execute them.
nb_execution_mode = "off"
nb_merge_streams = True
nb_render_markdown_format = "myst"  # formulas in outputs
myst_enable_extensions = [
    "dollarmath",
    "amsmath",
    "colon_fence",
    "deflist",
    "attrs_inline",
]
myst_heading_anchors = 3
myst_fence_as_directive = ["math"]

# Formulas are drawn by a script of the site: a reader needs no network.
mathjax_path = "mathjax/tex-svg.js"
mathjax3_config = {"svg": {"fontCache": "local"}, "options": {"enableMenu": False}}

autosummary_generate = True
autosummary_imported_members = True
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_xref_param_type = True
numpydoc_xref_ignore = "all"  # only the names below become links
codeautolink_concat_default = True  # the code of a page is one program

sphinx_gallery_conf = {
    "examples_dirs": str(ROOT / "examples"),
    "gallery_dirs": "gallery",
    "filename_pattern": "/plot_",
    "ignore_pattern": "nonlinear_mpc",
    "image_scrapers": ("scraping.scrape",),
    "capture_repr": (),
    "doc_module": ("pinmobile",),
    "backreferences_dir": "reference/backreferences",
    "inspect_global_variables": True,
    "show_memory": False,
    "show_signature": False,
    "download_all_examples": False,
    "remove_config_comments": True,
    "min_reported_time": 1e9,
    "abort_on_example_error": True,
}

html_theme = "pydata_sphinx_theme"
html_title = f"pinmobile {release}"
html_static_path = ["_static"]
html_css_files = ["site.css", "recording.css"]
html_js_files = ["recording.js", "site.js"]
html_show_sourcelink = False
html_copy_source = False
html_context = {"default_mode": "auto"}
html_sidebars = {"index": []}
html_theme_options = {
    "show_toc_level": 2,
    "collapse_navigation": True,
    "navigation_depth": 3,
    "navigation_with_keys": False,
    "header_links_before_dropdown": 8,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "navbar_persistent": [],
    "navbar_end": ["search-button", "theme-switcher"],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}

PUBLIC = find()
MODULES = {module for _, modules in TOPICS.values() for module in modules}
# A class may stand without its module: its last name leads to it, where only one class is called so.
COUNTS = Counter(name.rpartition(".")[2] for name in PUBLIC)
SHORT = {
    name.rpartition(".")[2]: name
    for name in PUBLIC
    if name.rpartition(".")[2][0].isupper() and COUNTS[name.rpartition(".")[2]] == 1
} | {name: name for name in PUBLIC}


def meant(name: str, page: str) -> str | None:
    """Return the public object that a name on a page means: one of the same module first."""
    module = page.rpartition("/")[2].removeprefix("pinmobile.").rpartition(".")[
        0
    ] or OWNERS.get(page.rpartition("/")[2].removeprefix("pinmobile."), "")
    beside = f"{module}.{name}"
    return beside if beside in PUBLIC else SHORT.get(name)


OWNERS = {
    name: module
    for _, modules in TOPICS.values()
    for module in modules
    for name in public(module)
}
numpydoc_xref_aliases = {word: word for word in DEFAULT_LINKS} | {
    short: f"pinmobile.{full}" for short, full in SHORT.items() if short[0].isupper()
}
_NAME = re.compile(r"^(?:pinmobile\.)?([A-Za-z_][\w.]*)(\([^)]*\))?$")


class Linked(SphinxTransform):
    """Make a link of each public name in backticks in the text of pages and notebooks."""

    default_priority = 400

    def apply(self, **kwargs: object) -> None:
        """Replace literals."""
        for literal in list(self.document.findall(nodes.literal)):
            match = _NAME.match(literal.astext())
            if (
                match
                and match[1] in PUBLIC
                and not isinstance(
                    literal.parent, nodes.reference | nodes.title | pending_xref
                )
            ):
                link = pending_xref(
                    "",
                    refdomain="py",
                    reftype="obj",
                    reftarget=f"pinmobile.{match[1]}",
                    refexplicit=True,
                    refwarn=False,
                    refdoc=self.env.docname,
                )
                literal.replace_self(link)
                link += literal


@cache
def words_of(name: str) -> frozenset[str]:
    """Return what backticks may contain in the text of a public object: its parameters, attributes and methods."""
    found = PUBLIC[name]
    words = {word for word in dir(found) if word[0] != "_"}
    members = inspect.getmembers_static(found) if inspect.isclass(found) else []
    for one in (found, *(value for key, value in members if key[0] != "_")):
        one = getattr(one, "fget", getattr(one, "__func__", one))
        with contextlib.suppress(TypeError, ValueError):
            words |= set(inspect.signature(one).parameters)
        for line in re.findall(
            r"^ *([A-Za-z_*][\w, .*]*) : ", inspect.getdoc(one) or "", re.M
        ):
            words |= {word.strip(" *.") for word in line.split(",")}
    return frozenset(words)


def spoken_of(page: str) -> frozenset[str]:
    """Return these words for a page: of its object, or of all objects of its topic."""
    folder, _, name = page.rpartition("/")
    if name.removeprefix("pinmobile.") in PUBLIC:
        return words_of(name.removeprefix("pinmobile."))
    modules = TOPICS.get(name, ("", []))[1] if folder == "reference" else []
    names = [spelled(module, each) for module in modules for each in public(module)]
    return frozenset().union(*map(words_of, names))


def resolve(app, env, node, shown):
    """Return a link to a public object, plain code for a parameter, or None: then Sphinx warns."""
    page = node.get("refdoc", env.docname)
    short = node.get("reftarget", "").partition("(")[0].removeprefix("pinmobile.")
    first, *rest = short.split(".")
    for cut in range(len(rest), -1, -1):
        full = meant(".".join([first, *rest[:cut]]), page)
        if full is not None:
            target = ".".join(["pinmobile", full, *rest[cut:]])
            found = env.domains["py"].resolve_xref(
                env, page, app.builder, "obj", target, node, shown
            )
            return found or (
                shown if set(rest[cut : cut + 1]) <= words_of(full) else None
            )
    if first in spoken_of(page) or short in MODULES:
        return shown
    owners = [
        name
        for name, each in PUBLIC.items()
        if inspect.isclass(each) and first in words_of(name)
    ]
    return shown if owners and "/generated/" in page else None


class Shown:
    """A default value as a reader would write it."""

    def __init__(self, value: object) -> None:
        names = {**vars(pinmobile.loop), **vars(pinmobile.integrators)}
        known = [
            name
            for name, each in names.items()
            if each is value and inspect.isroutine(each) and name[0] != "_"
        ]
        text = getattr(value, "__name__", None) or (known or [repr(value)])[0]
        self.text = (
            str(value)
            if isinstance(value, enum.Enum)
            else text
            if len(text) < 40
            else "..."
        )

    def __repr__(self) -> str:
        return self.text


def show_signature(app, what, name, obj, options, signature, returned):
    """Return the signature of a class or function with defaults that a reader can type."""
    if not signature or not (inspect.isclass(obj) or inspect.isroutine(obj)):
        return None
    with contextlib.suppress(TypeError, ValueError):
        stated = inspect.signature(obj)
        given = [
            each.replace(
                annotation=inspect.Parameter.empty,
                default=each.default
                if each.default is each.empty
                else Shown(each.default),
            )
            for each in stated.parameters.values()
            if each.name not in ("self", "cls") or inspect.isclass(obj)
        ]
        return str(
            stated.replace(parameters=given, return_annotation=inspect.Signature.empty)
        ), returned
    return None


def escape_bars(app, what, name, obj, options, lines):
    """Escape bars: |x| is an absolute value, not a substitution."""
    lines[:] = [re.sub(r"(?<!\\)\|", r"\\|", line) for line in lines]


def leave_gallery(app, docname, content):
    """Leave the links in the code of gallery scripts to sphinx-gallery."""
    if docname.startswith("gallery/plot_"):
        content[0] = ".. autolink-skip:: file\n\n" + content[0]
    if docname == "about/contributing":  # its code is not one program
        content[0] = "```{autolink-skip} file\n```\n\n" + content[0]


def setup(app):
    """Connect what stands above."""
    app.add_transform(Linked)
    app.connect("missing-reference", resolve)
    app.connect("source-read", leave_gallery)
    app.connect("autodoc-process-signature", show_signature)
    app.connect("autodoc-process-docstring", escape_bars, priority=900)
    return {"parallel_read_safe": True}

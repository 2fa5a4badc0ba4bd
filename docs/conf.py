"""Settings of the documentation site, which `make docs` builds."""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
from importlib.metadata import metadata
from pathlib import Path

import fieldbake

DOCS = Path(__file__).parent
BUILD = DOCS / "build"
RESULTS = DOCS.parent / "benches" / "results"
sys.path.insert(0, str(DOCS / "extensions"))
# Pages run the command `fieldbake` of this environment, which need not be activated.
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])

project = "fieldbake"
author = "the fieldbake developers"
copyright = author
release = version = fieldbake.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "generated_pages",
    "mathml",
    "property_text",
]
# A word of a docstring, such as the type "faces", may name several attributes.
# Files of results that are included below a title may skip a level of headings.
suppress_warnings = ["ref.python", "myst.header"]
exclude_patterns = ["build", "notes", "extensions"]

# Docstrings are in NumPy style; the types of their sections are written for people.
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_param = False
napoleon_use_ivar = True
default_role = "code"
smartquotes = False  # it would join the two dashes of options
napoleon_preprocess_types = False
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "inherited-members": "str,tuple,list,Exception"}
add_module_names = False
python_use_unqualified_type_names = True
toc_object_entries_show_parents = "hide"

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

# Pages are executed in a folder that is deleted afterwards, and again only if the page or the package has changed.
nb_execution_mode = "cache"
nb_execution_raise_on_error = True
nb_execution_in_temp = True
nb_execution_timeout = 240
nb_merge_streams = True
nb_ipywidgets_js = {}
nb_mime_priority_overrides = [("html", "text/html", 0)]


def _package_digest() -> str:
    """A digest of the package and of what its pages run, so that no cached output is older than them."""
    digest = hashlib.sha256()
    package = Path(fieldbake.__file__).parent
    own = [DOCS / "extensions" / "kernel_startup.py", *RESULTS.glob("*.json")]
    for path in sorted([*package.rglob("*.py"), *package.rglob("*.js"), *package.glob("_core.*"), *own]):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


nb_execution_cache_path = str(BUILD / "executed" / _package_digest())

# Kernels draw on the CPU, with the formats of pictures in extensions/kernel_startup.py.
_STARTUP = BUILD / "ipython" / "profile_default" / "startup"
_STARTUP.mkdir(parents=True, exist_ok=True)
shutil.copy(DOCS / "extensions" / "kernel_startup.py", _STARTUP / "00-views.py")
# The kernel's warning that it listens on this machine without encryption belongs to no page.
(_STARTUP.parent / "ipython_kernel_config.py").write_text("get_config().IPKernelApp.log_level = 40\n", encoding="utf-8")
os.environ["IPYTHONDIR"] = str(BUILD / "ipython")
os.environ["FIELDBAKE_DEVICE"] = "cpu"
os.environ["BENCH_RESULTS"] = str(RESULTS)
# They import the package that this file has imported.
os.environ["PYTHONPATH"] = os.pathsep.join([str(Path(fieldbake.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
os.environ["PYTHONWARNINGS"] = "ignore::UserWarning"

html_theme = "pydata_sphinx_theme"
html_title = f"fieldbake {release}"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_show_search_summary = False  # a page that is opened as a file cannot fetch the others
# Addresses of the project: Homepage, Source and others, from pyproject.toml.
URLS = dict(line.split(", ", 1) for line in metadata("fieldbake").get_all("Project-URL") or [])
html_theme_options = {
    "icon_links": [{"name": "Source", "url": URLS["Source"], "icon": "fa-solid fa-code"}],
    "navbar_align": "left",
    "navbar_persistent": ["search-button"],
    "header_links_before_dropdown": 7,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "show_prev_next": True,
    "navigation_with_keys": False,
    "pygments_light_style": "default",
    "pygments_dark_style": "github-dark",
}
html_context = {"default_mode": "auto"}
html_sidebars = {"index": []}

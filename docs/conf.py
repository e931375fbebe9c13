"""The site: `pip install -e '.[docs]' && sphinx-build docs site`. Most pages are made from scripts and results.

REPOSITORY_URL, if it is set, is the address of the repository that pages link to, such as GitHub's workflow knows it.
Links to files have the form that they have at GitHub and GitLab.
"""

import os
import sys
import tomllib
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE / "extensions")]  # envs, and the site's own extensions

project = "marl-baselines"
author = "The marl-baselines authors"
copyright = "the marl-baselines authors, MIT license"
version = tomllib.loads((HERE.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
html_title = f"{project} {version}"
repository = os.environ.get("REPOSITORY_URL", "").rstrip("/")

extensions = [
    "myst_parser",
    "sphinx_design",
    "sphinx_copybutton",
    "mathml",
    "papers",
    "algorithm_pages",
    "environment_pages",
    "reference_page",
    "results_pages",
    "notebook_of_pages",
]
source_suffix = {".md": "markdown"}
exclude_patterns = ["data", "films", "extensions"]
myst_enable_extensions = ["attrs_inline", "colon_fence", "dollarmath"]
myst_heading_anchors = 4
myst_html_meta = {"description": "Nine cooperative multi-agent RL algorithms, one readable file each, explained"}
smartquotes = False
copybutton_exclude = ".linenos, .gp"

python_maximum_signature_line_length = 90

html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_js_files = [("charts.js", {"defer": "defer"}), ("tables.js", {"defer": "defer"})]  # charts.js loads vega.js
html_favicon = html_logo = "static/favicon.svg"
html_copy_source = False
html_use_index = False
html_show_sphinx = False
html_show_search_summary = False  # it would fetch the pages that were found, which browsers forbid for file://
html_math_renderer = "mathml"
pygments_style = "a11y-light"
pygments_dark_style = "a11y-dark"
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#1f5f8b", "color-brand-content": "#1f5f8b"},
    "dark_css_variables": {"color-brand-primary": "#8cc4ee", "color-brand-content": "#8cc4ee"},
}
if repository:
    html_theme_options |= {
        "source_view_link": f"{repository}/blob/main/docs/{{filename}}",
        "source_edit_link": f"{repository}/edit/main/docs/{{filename}}",
        "footer_icons": [{"name": "Repository", "url": repository, "html": "Repository"}],
    }


def name_repository(app, docname, source):
    """Puts the repository's address, where it is known, into commands that clone it."""
    if repository:
        source[0] = source[0].replace("git clone REPOSITORY_URL", f"git clone {repository}")


def setup(app):
    """Called by Sphinx."""
    app.connect("source-read", name_repository)

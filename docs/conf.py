"""The site: `pip install -e '.[docs]' && sphinx-build docs site`. Most pages are made from scripts and results."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE / "extensions")]  # envs, and the site's own extensions

project = "marl-baselines"
author = "The marl-baselines authors"
copyright = "the marl-baselines authors"
html_title = "marl-baselines"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "mathml",
    "algorithm_pages",
    "environment_pages",
    "reference_page",
    "results_pages",
]
source_suffix = {".md": "markdown"}
exclude_patterns = ["data", "films", "extensions", "algorithms/common.md"]
myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
autodoc_typehints = "signature"
autodoc_member_order = "bysource"

html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_js_files = [("charts.js", {"defer": "defer"}), ("tables.js", {"defer": "defer"})]  # charts.js loads vega.js
html_copy_source = False
html_show_sphinx = False
html_show_search_summary = False  # it would fetch the pages that were found, which browsers forbid for file://
html_math_renderer = "mathml"
pygments_style = "friendly"
pygments_dark_style = "github-dark"
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#1f5f8b", "color-brand-content": "#1f5f8b"},
    "dark_css_variables": {"color-brand-primary": "#8cc4ee", "color-brand-content": "#8cc4ee"},
}

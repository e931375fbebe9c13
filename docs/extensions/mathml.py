"""Formulas as MathML, which browsers typeset by themselves: no script, no font, no request."""

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError


def to_mathml(latex: str, display: str) -> str:
    """A formula in LaTeX as MathML; display: inline or block."""
    try:
        return convert(latex, display=display)
    except Exception as error:  # latex2mathml raises many kinds
        raise ExtensionError(f"latex2mathml cannot read the formula {latex!r}: {error!r}") from error


def visit_inline(self, node):
    """Writes a formula within a line."""
    self.body.append(to_mathml(node.astext(), "inline"))
    raise nodes.SkipNode


def visit_block(self, node):
    """Writes a formula on a line of its own, which may be wider than a phone."""
    self.body.append(f'<div class="formula">{to_mathml(node.astext(), "block")}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict:
    """Called by Sphinx."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}

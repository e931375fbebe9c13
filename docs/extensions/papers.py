"""Papers: where a page names one, by its title or by its authors and year, the name becomes a link."""

import csv
import itertools
import re
from pathlib import Path
from typing import NamedTuple

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform


class Paper(NamedTuple):
    """authors as the text names them, year, the beginning of the title, address."""

    authors: str
    year: int
    title: str
    address: str

    @property
    def label(self) -> str:
        """Such as Tan (1993)."""
        return f"{self.authors} ({self.year})"


FILE = Path(__file__).resolve().parents[1] / "data" / "papers.csv"
with open(FILE, newline="", encoding="utf-8") as rows:
    PAPERS = [Paper(row["authors"], int(row["year"]), row["title"], row["address"]) for row in csv.DictReader(rows)]


def pattern(paper: Paper) -> str:
    """A regular expression for the paper's title, or for its authors and year."""
    authors, title = (re.escape(text).replace(r"\ ", r"\s+") for text in (paper.authors, paper.title))
    return rf"{title}|{authors},?\s+(?:\({paper.year}\)|{paper.year})"


PATTERNS = [(re.compile(pattern(paper)), paper) for paper in PAPERS]


def cited(text: str) -> list[Paper]:
    """The papers that a text names, in the order of this list."""
    return [paper for expression, paper in PATTERNS if expression.search(text)]


def linked(text: str) -> list[nodes.Node]:
    """Text with the papers that it names as links."""
    matches = [(match, paper) for expression, paper in PATTERNS if (match := expression.search(text))]
    if not matches:
        return [nodes.Text(text)]
    match, paper = min(matches, key=lambda each: each[0].start())
    before, after = text[: match.start()], text[match.end() :]
    return [nodes.Text(before), nodes.reference("", match[0], refuri=paper.address), *linked(after)]


class LinkPapers(SphinxTransform):
    """Links the papers of a page, where they are not in code, in a title or in a link already."""

    default_priority = 600
    kept = (nodes.literal, nodes.literal_block, nodes.reference, nodes.title, nodes.raw, nodes.math, nodes.comment)

    def apply(self, **kwargs: object) -> None:
        """Called by Sphinx, once a page."""
        for element in list(self.document.findall(nodes.TextElement)):
            if not isinstance(element, self.kept):
                children: list[nodes.Node] = []
                for is_text, group in itertools.groupby(element.children, lambda child: isinstance(child, nodes.Text)):
                    # MyST makes a text of each line; a name may begin in one and end in the next
                    found = list(group)
                    children += linked("".join(child.astext() for child in found)) if is_text else found
                element.clear()
                element.extend(children)


def setup(app: Sphinx) -> dict:
    """Called by Sphinx."""
    app.add_transform(LinkPapers)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

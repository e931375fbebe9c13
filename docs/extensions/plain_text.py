"""Our docstrings are plain text, to be read in the script. Here they become paragraphs, lists and tables of a page.

A line that is indented belongs to a block of its own. It is set as it stands if it has columns or formulas, and as a
list where it is prose. A line that begins with `name:`, or with a name and two spaces, begins a new paragraph.
"""

import inspect
import re
from typing import NamedTuple

from docutils import nodes

LEAD = re.compile(r"((?:[A-Z][\w ,+^.-]{0,50}|[a-z_][\w, -]{0,60})(?: \([^)]{1,60}\))?):(?= |$)")
TERM = re.compile(r"(\S(?:.{0,40}?\S)?) {2,}(\S.*)$")  # a name and what it means, in two columns
CONTINUES = re.compile(r"[^.;:!?)]$")  # the line before ends in the middle of a sentence
FLAG = r"(?<![\w`-])--[a-z][\w-]*"
INLINE = re.compile(rf"`([^`]+)`|({FLAG})|arXiv:(\d{{4}}\.\d{{4,5}})|(https?://[^\s)]+)")


class Block(NamedTuple):
    """kind: paragraph, item (of a list) or verbatim. lead: the name before a colon, or nothing."""

    kind: str
    text: str
    lead: str = ""


def parse(text: str) -> list[Block]:
    """The blocks of a docstring. Its first sentence is never a name and what it means."""
    found: list[Block] = []
    for group in re.split(r"\n\s*\n", inspect.cleandoc(text)):
        lines = group.splitlines()
        while lines:
            if term := TERM.match(lines[0]):
                number = next((i for i, line in enumerate(lines) if i and not line.startswith(" " * 8)), len(lines))
                found.append(Block("paragraph", " ".join([term[2], *map(str.strip, lines[1:number])]), term[1]))
                lines = lines[number:]
                continue
            inside = lines[0].startswith("  ")
            ends = (i for i, line in enumerate(lines) if line.startswith("  ") != inside or (i and TERM.match(line)))
            number = next(ends, len(lines))
            found += indented(lines[:number]) if inside else paragraphs(lines[:number])
            lines = lines[number:]
    if found and found[0].lead[:1].isupper():
        found[0] = Block("paragraph", f"{found[0].lead}: {found[0].text}")
    return found


def paragraphs(lines: list[str]) -> list[Block]:
    """Lines of prose: a new paragraph before each name with a colon that stands at the beginning of a sentence."""
    found: list[Block] = []
    for i, line in enumerate(lines):
        starts = i == 0 or not CONTINUES.search(lines[i - 1])
        lead = LEAD.match(line) if starts else None
        if lead:
            found.append(Block("paragraph", line[lead.end() :].strip(), lead[1]))
        elif i == 0 or (starts and line.startswith(("Returns ", "Raises "))):
            found.append(Block("paragraph", line))
        else:
            found[-1] = found[-1]._replace(text=f"{found[-1].text} {line}".strip())
    return found


def indented(lines: list[str]) -> list[Block]:
    """Indented lines: as they stand where they have columns or formulas, else a list."""
    text = inspect.cleandoc("\n".join(["", *lines]))
    own = text.splitlines()
    if any(re.search(r"\S {2,}\S", line) or " = " in line for line in own) or text.startswith("python "):
        return [Block("verbatim", text)]
    found: list[Block] = []
    for i, line in enumerate(own):
        if i == 0 or not CONTINUES.search(own[i - 1]):
            found.append(Block("item", line.strip()))
        else:
            found[-1] = Block("item", f"{found[-1].text} {line.strip()}")
    return found


def inline(text: str) -> list[nodes.Node]:
    """Text with its `code`, --flags, and links."""
    found: list[nodes.Node] = []
    position = 0
    for match in INLINE.finditer(text):
        found.append(nodes.Text(text[position : match.start()]))
        code, flag, paper, url = match.groups()
        if code or flag:
            found.append(nodes.literal("", code or flag, classes=["flag"] if flag else []))
        else:
            target = url or f"https://arxiv.org/abs/{paper}"
            found.append(nodes.reference("", match[0], refuri=target))
        position = match.end()
    return [*found, nodes.Text(text[position:])]


def to_nodes(blocks: list[Block]) -> list[nodes.Node]:
    """The blocks as nodes of docutils."""
    found: list[nodes.Node] = []
    for block in blocks:
        content = inline(block.text)
        if block.lead:
            is_name = re.fullmatch(r"[a-z_]\w*(, [a-z_]\w*)*", block.lead)
            lead = nodes.literal("", block.lead) if is_name else nodes.strong("", block.lead)
            content = [lead, nodes.Text(": "), *content]
        if block.kind == "verbatim":
            found.append(nodes.literal_block("", block.text, language="text"))
        elif block.kind == "item":
            if not found or not isinstance(found[-1], nodes.bullet_list):
                found.append(nodes.bullet_list("", bullet="*"))
            found[-1] += nodes.list_item("", nodes.paragraph("", "", *content))
        else:
            found.append(nodes.paragraph("", "", *content))
    return found


def to_restructured_text(blocks: list[Block]) -> list[str]:
    """The blocks as lines that autodoc understands."""
    lines: list[str] = []
    for block in blocks:
        if block.kind == "verbatim":
            lines += [".. code-block:: text", "", *(f"    {line}" for line in block.text.splitlines()), ""]
            continue
        text = "".join(
            f"``{node.astext()}``"
            if isinstance(node, nodes.literal)
            else re.sub(r"([\\*`_|<>])", r"\\\1", str(node.astext()))
            for node in inline(block.text)
        )
        if block.lead:
            text = f"**{block.lead}**: {text}"
        lines += [f"* {text}" if block.kind == "item" else text, ""]
    return lines

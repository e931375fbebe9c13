"""A script of algos/ as its page shows it: docstring, sections from networks to train, functions, flags, lines."""

import ast
import html
import io
import itertools
import re
import tokenize
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from pygments import highlight
from pygments.formatters import HtmlFormatter
from pygments.lexers import PythonLexer

ROOT = Path(__file__).resolve().parents[2]
ALGORITHMS = ("iql", "ia2c", "ippo", "maddpg", "coma", "maa2c", "mappo", "vdn", "qmix")
SECTION = re.compile(r"# --- (.*?) ---$")
LAST_SECTION = "train"


@dataclass(frozen=True)
class Piece:
    """Lines that belong together: a function, a method, the head of a class, or what stands between them.

    name: such as update or Network.forward, "" for what has none. lines: their numbers, without the docstring's.
    """

    name: str
    section: str
    lines: tuple[int, ...]
    docstring: str


class Script:
    """One of the nine."""

    def __init__(self, name: str, source: str | None = None):
        self.name = name
        self.source = source or (ROOT / "algos" / f"{name}.py").read_text(encoding="utf-8")
        self.lines = self.source.splitlines()
        self.tree = ast.parse(self.source)
        self.docstring = ast.get_docstring(self.tree) or ""

    @cached_property
    def sections(self) -> dict[str, tuple[int, int]]:
        """First and last line of each section that is shown, from networks to train."""
        heads = [(i, match[1]) for i, line in enumerate(self.lines, 1) if (match := SECTION.match(line))]
        found = {}
        for (start, title), (end, _) in itertools.pairwise(heads):
            found[title] = (start + 1, end - 1)
            if title == LAST_SECTION:
                return found
        raise ValueError(f"algos/{self.name}.py has no section '# --- {LAST_SECTION} ---' with another one behind it")

    @cached_property
    def pieces(self) -> list[Piece]:
        """What the page shows, in order; together they are all lines of the sections but blank ends and docstrings."""
        found: list[Piece] = []
        for title, (first, last) in self.sections.items():
            line = first
            for node in self.tree.body:
                if not first <= node.lineno <= last:
                    continue
                for name, start, end, docstring in parts(node):
                    found += self.piece("", title, line, start - 1)
                    found += self.piece(name, title, start, end, docstring)
                    line = end + 1
            found += self.piece("", title, line, last)
        return found

    def piece(self, name: str, section: str, first: int, last: int, docstring: Any = None) -> list[Piece]:
        """The piece of these lines without those of the docstring, a statement; none if they are blank."""
        hidden = range(docstring.lineno, docstring.end_lineno + 1) if docstring else range(0)
        numbers = [i for i in range(first, last + 1) if i not in hidden]
        while numbers and not self.lines[numbers[0] - 1].strip():
            numbers.pop(0)
        while numbers and not self.lines[numbers[-1] - 1].strip():
            numbers.pop()
        if not numbers:
            return []
        text = docstring.value.value if docstring else ""
        return [Piece(name, section, tuple(numbers), text)]

    @cached_property
    def names(self) -> dict[str, tuple[int, ...]]:
        """The lines of each function, class and method that is shown; those of a class have its methods' too."""
        found: dict[str, tuple[int, ...]] = {}
        for piece in self.pieces:
            if piece.name:
                found[piece.name] = piece.lines
                if "." in piece.name:
                    owner = piece.name.split(".")[0]
                    found[owner] = (*found[owner], *piece.lines)
        return found

    def find(self, anchor: str) -> int:
        """The number of the one line that "<name>: <text>" means. ValueError if there is none, or more than one."""
        name, colon, text = anchor.partition(":")
        name, text = name.strip(), text.strip()
        if not colon or not text:
            raise ValueError(f"{anchor!r} is not of the form '<function>: <text of the line>'")
        if name not in self.names:
            raise ValueError(f"algos/{self.name}.py shows no {name!r}")
        found = [number for number in self.names[name] if text in self.lines[number - 1]]
        if len(found) != 1:
            raise ValueError(f"{len(found)} lines of {name} in algos/{self.name}.py contain {text!r}, and not one")
        return found[0]

    @cached_property
    def coloured(self) -> list[str]:
        """Each line in HTML, as Pygments colours it."""
        lines = highlight(self.source, PythonLexer(stripnl=False), HtmlFormatter(nowrap=True)).split("\n")
        return lines[: len(self.lines)]

    def html_lines(self, numbers: tuple[int, ...], anchors: bool = True) -> str:
        """These lines in HTML, numbered. anchors: with an id for each, which an address can name."""
        found = []
        for number in numbers:
            anchor = f'id="L{number}" ' if anchors else ""
            found.append(
                f'<span {anchor}class="row"><a class="number" href="#L{number}" aria-hidden="true" tabindex="-1" '
                f'data-number="{number}"></a>{self.coloured[number - 1]}\n</span>'
            )
        return "".join(found)

    def literal(self, name: str):
        """The value of a constant at the script's top."""
        for node in self.tree.body:
            if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", None) == name:
                return ast.literal_eval(node.value)
        raise ValueError(f"algos/{self.name}.py has no constant {name}")

    @cached_property
    def flags(self) -> dict[str, tuple[str, str]]:
        """Each field of Args: its default, and the comment that explains it."""
        comments = {}
        for token in tokenize.generate_tokens(io.StringIO(self.source).readline):
            if token.type == tokenize.COMMENT:
                comments[token.start[0]] = token.string.lstrip("# ")
        found = {}
        args = next(node for node in self.tree.body if isinstance(node, ast.ClassDef) and node.name == "Args")
        for field in args.body:
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and field.value:
                found[field.target.id] = ast.unparse(field.value), comments.get(field.end_lineno or 0, "")
        return found


def parts(node: ast.stmt) -> list[tuple[str, int, int, ast.stmt | None]]:
    """name, first line, last line and docstring of a top-level statement: a class also has its methods as parts."""
    if not isinstance(node, (ast.FunctionDef, ast.ClassDef)):
        return [("", node.lineno, node.end_lineno or node.lineno, None)]
    first = first_line(node)
    if isinstance(node, ast.FunctionDef):
        return [(node.name, first, node.end_lineno or first, docstring_of(node))]
    methods = [each for each in node.body if isinstance(each, ast.FunctionDef)]
    end = first_line(methods[0]) - 1 if methods else node.end_lineno or first
    found = [(node.name, first, end, docstring_of(node))]
    for method in methods:
        found.append((f"{node.name}.{method.name}", first_line(method), method.end_lineno or 0, docstring_of(method)))
    return found


def first_line(node: ast.FunctionDef | ast.ClassDef) -> int:
    """Where it begins, with its decorators."""
    return min([node.lineno, *(each.lineno for each in node.decorator_list)])


def docstring_of(node: ast.FunctionDef | ast.ClassDef) -> ast.stmt | None:
    """The statement that is its docstring."""
    head = node.body[0]
    is_text = isinstance(head, ast.Expr) and isinstance(head.value, ast.Constant) and isinstance(head.value.value, str)
    return head if is_text and len(node.body) > 1 else None


@lru_cache
def read(name: str) -> Script:
    """The script of that name."""
    return Script(name)


def escape(text: str) -> str:
    """Text for HTML."""
    return html.escape(text, quote=False)

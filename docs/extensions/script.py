"""A script of algos/ as its page shows it: docstring, sections from networks to train, functions, flags."""

import ast
import io
import itertools
import re
import tokenize
from functools import cached_property, lru_cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
NINE = ("ia2c", "ippo", "maa2c", "mappo", "coma", "iql", "vdn", "qmix", "maddpg")  # in the order of reading
PAGES = {path.stem for path in (ROOT / "docs" / "algorithms").glob("*.md")}
NEW = sorted(path.stem for path in (ROOT / "algos").glob("*.py") if path.stem in PAGES.difference(NINE))
ALGORITHMS = (*NINE, *NEW)  # those that have a page
SECTION = re.compile(r"# --- (.*?) ---$")
LAST_SECTION = "train"


class Part(NamedTuple):
    """A function or a class with what stands before it; first and last line."""

    name: str
    section: str
    first: int
    last: int


class Script:
    """A script. Lines are counted from 1."""

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
    def parts(self) -> list[Part]:
        """What the page shows, in order; together they are all lines of the sections but blank ones at ends."""
        found: list[Part] = []
        for title, (first, last) in self.sections.items():
            for node in self.tree.body:
                if first <= node.lineno <= last and isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                    end = node.end_lineno or node.lineno
                    found.append(self.part(node.name, title, first, end))
                    first = end + 1
            if self.text(first, last):  # what follows the last function
                found[-1] = self.part(found[-1].name, title, found[-1].first, last)
        return found

    def part(self, name: str, section: str, first: int, last: int) -> Part:
        """These lines without blank ones at both ends."""
        while not self.lines[first - 1].strip():
            first += 1
        while not self.lines[last - 1].strip():
            last -= 1
        return Part(name, section, first, last)

    def text(self, first: int, last: int) -> str:
        """These lines as one text."""
        return "\n".join(self.lines[first - 1 : last]).strip()

    @cached_property
    def names(self) -> dict[str, tuple[int, int]]:
        """First and last line of each function, class and method that is shown."""
        shown = {part.name for part in self.parts}
        found = {}
        for node in self.tree.body:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and node.name in shown:
                found[node.name] = node.lineno, node.end_lineno or 0
                for method in node.body if isinstance(node, ast.ClassDef) else ():
                    if isinstance(method, ast.FunctionDef):
                        found[f"{node.name}.{method.name}"] = method.lineno, method.end_lineno or 0
        return found

    def find(self, anchor: str) -> int:
        """The number of the one line that "<name>: <text>" means. ValueError if there is none, or more than one."""
        name, colon, text = anchor.partition(":")
        name, text = name.strip(), text.strip()
        if not colon or not text:
            raise ValueError(f"{anchor!r} is not of the form '<function>: <text of the line>'")
        if name not in self.names:
            raise ValueError(f"algos/{self.name}.py shows no {name!r}")
        first, last = self.names[name]
        found = [number for number in range(first, last + 1) if text in self.lines[number - 1]]
        if len(found) != 1:
            raise ValueError(f"{len(found)} lines of {name} in algos/{self.name}.py contain {text!r}, and not one")
        return found[0]

    def literal(self, name: str):
        """The value of a constant at the script's top."""
        for node in self.tree.body:
            if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", None) == name:
                return ast.literal_eval(node.value)
        raise ValueError(f"algos/{self.name}.py has no constant {name}")

    @cached_property
    def flags(self) -> dict[str, tuple[str, str]]:
        """Each field of Args: its default ("" where PAPER or the task gives it), and the comment that explains it."""
        comments = {}
        for token in tokenize.generate_tokens(io.StringIO(self.source).readline):
            if token.type == tokenize.COMMENT:
                comments[token.start[0]] = token.string.lstrip("# ")
        found = {}
        args = next(node for node in self.tree.body if isinstance(node, ast.ClassDef) and node.name == "Args")
        for field in args.body:
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
                default = ast.unparse(field.value) if field.value else ""
                said = comments.get(field.end_lineno or 0, "")
                found[field.target.id] = default, re.sub("^from (PAPER|the task): ", "", said)
        return found


@lru_cache
def read(name: str) -> Script:
    """The script of that name."""
    return Script(name)

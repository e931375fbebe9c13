"""Our docstrings are plain text, to be read in the code. Here they become Markdown for the pages.

A line that is indented belongs to a block of its own: a table where it has two columns, a list where it is prose, and
else it stays as it stands. A line that begins with `name:`, or with a name and two spaces, begins a new paragraph.
"""

import inspect
import re

LEAD = re.compile(r"((?:[A-Z][\w ,+^.-]{0,50}|[a-z_][\w, -]{0,60})(?: \([^)]{1,60}\))?):(?= (?!and )|$)")
TERM = re.compile(r"(\S(?:.{0,58}?\S)?) {2,}(\S.*)$")  # a name and what it means, in two columns
CONTINUES = re.compile(r"[^.;:!?)]$")  # the line before ends in the middle of a sentence
GAP = re.compile(r"(?<=\S) {2,}(?=\S)")
FORMULA = r"(?<![\w`{])(?:pi|mu|rho|[A-Za-z])(?:\*|')?_(?:old|-?[a-z](?:,[a-z](?:\+1)?)?)(?!\w)"
INLINE = re.compile(
    rf"(`[^`]+`)|(?<![\w`-])(--[a-z][\w-]*(?: gru)?)|({FORMULA})|arXiv:(\d{{4}}\.\d{{4,5}})|(https?://[^\s)]+)"
)


def to_markdown(text: str) -> str:
    """A docstring in Markdown. Its first sentence is never a name and what it means."""
    found: list[str] = []
    for number, group in enumerate(re.split(r"\n\s*\n", inspect.cleandoc(text))):
        lines = group.splitlines()
        while lines:
            inside = lines[0].startswith("  ")
            columns = not inside and TERM.match(lines[0]) is not None
            end = 1
            while end < len(lines) and belongs(lines[end], inside, columns):
                end += 1
            if columns or inside:
                found.append(block(lines[:end]))
            else:
                found += paragraphs(lines[:end], first=number == 0)
            lines = lines[end:]
    return "\n\n".join(found)


def belongs(line: str, inside: bool, columns: bool) -> bool:
    """Whether a line goes on with what is indented (inside), with two columns, or with prose."""
    is_indented = line.startswith("  ")
    return is_indented or TERM.match(line) is not None if columns else is_indented == inside


def paragraphs(lines: list[str], first: bool) -> list[str]:
    """Lines of prose: a new paragraph before each name with a colon that stands at the beginning of a sentence."""
    found: list[str] = []
    for i, line in enumerate(lines):
        starts = i == 0 or not CONTINUES.search(lines[i - 1])
        lead = LEAD.match(line) if starts and not (first and i == 0 and line[:1].isupper()) else None
        if lead:
            is_code = re.fullmatch(r"[a-z_]\w*(, [a-z_]\w*)*", lead[1])
            title = f"`{lead[1]}`" if is_code else f"**{inline(lead[1])}**"
            found.append(f"{title}:{inline(line[lead.end() :])}")
        elif i == 0 or (starts and line.startswith(("Returns ", "Raises "))):
            found.append(inline(line))
        else:
            found[-1] += "\n" + inline(line)
    return found


def block(lines: list[str]) -> str:
    """Indented lines: a table, a list, or text as it stands."""
    own = inspect.cleandoc("\n".join(["", *lines])).splitlines()
    gaps = [len(GAP.findall(line)) for line in own if not line.startswith(" ")]
    if any(" = " in line for line in own) or own[0].startswith("python ") or max(gaps) > 2:
        return "\n".join(["```text", *own, "```"])
    if min(gaps) > 0:
        rows: list[list[str]] = []
        for line in own:
            first, *others = re.split(" {2,}", line.strip())
            if line.startswith("   "):  # goes on with the second column of the line before
                rows[-1][1] += f" {first}"
                rows[-1] += others
            else:
                rows.append([first, *others])
        width = max(map(len, rows))
        cells = [[name(first), *map(inline, others), *[""] * (width - 1 - len(others))] for first, *others in rows]
        return "\n".join(f"| {' | '.join(line)} |" for line in [[""] * width, ["---"] * width, *cells])
    found: list[str] = []
    for i, line in enumerate(own):
        if i == 0 or not CONTINUES.search(own[i - 1]):
            found.append(f"* {inline(line.strip())}")
        else:
            found[-1] += f" {inline(line.strip())}"
    return "\n".join(found)


def name(text: str) -> str:
    """What stands in a table's first column: code, if it looks like it."""
    return f"`{text}`".replace("|", "\\|") if re.search(r"[<_\[]", text) else inline(text)


def inline(text: str) -> str:
    """A line with its `code`, --flags, formulas and links; what Markdown would take for its own is escaped."""
    found, position = [], 0
    for match in INLINE.finditer(text):
        found.append(escape(text[position : match.start()]))
        code, flag, formula, paper, url = match.groups()
        address = url or f"https://arxiv.org/abs/{paper}"
        found.append(code or (flag and f"`{flag}`") or (formula and latex(formula)) or f"[{match[0]}]({address})")
        position = match.end()
    return "".join([*found, escape(text[position:])])


def latex(formula: str) -> str:
    """A letter with an index, such as pi_i,t, as a formula."""
    letter, _, index = formula.partition("_")
    letter = re.sub(r"(pi|mu|rho)", r"\\\1", letter).replace("*", "^*")
    index = index.replace("old", r"\mathrm{old}")
    return f"${letter}_{{{index}}}$"


def escape(text: str) -> str:
    """Text in which Markdown finds nothing."""
    return re.sub(r"([\\*_\[\]<$|])", r"\\\1", text)

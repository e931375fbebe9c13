"""Pages of the algorithms: a script and the remarks in docs/algorithms/<name>.md become one page.

The page is written as Markdown when Sphinx reads the remarks, so that they may use all that other pages may.
"""

import difflib
import html
import re

import charts
import pandas as pd
import plain_text
import results_data
import script
import yaml
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective, SphinxRole

REMARKS = script.ROOT / "docs" / "algorithms"
DATA = script.ROOT / "docs" / "data"
COMMON = "common"  # docs/algorithms/common.md has the remarks on what several scripts share
FAMILY_TITLES = results_data.FAMILIES
EXAMPLES = {"matrix": "matrix-climbing", "mpe": "mpe-spread", "smac": "smaclite-3s5z-sc2", "lbf": "lbf-15x15-3p-5f"}
EXAMPLES["rware"] = "rware-tiny-4p"
HEALTH_TITLES = {"healthy": "A healthy run", "sick": "A sick run"}


class Remarks:
    """What docs/algorithms/<name>.md says: its front matter, its sections, and the remarks by name."""

    def __init__(self, text: str):
        front, body = {}, text
        if text.startswith("---\n"):
            head, body = text[4:].split("\n---\n", 1)
            front = yaml.safe_load(head)
        self.title: str = front.get("title", "")
        self.sibling: str | None = front.get("sibling")
        self.sections = split(body, "## ")
        self.remarks = split(self.sections.pop("Remarks", ""), "### ")

    def unknown(self, known: script.Script) -> list[str]:
        """The remarks on what the script does not show."""
        return [name for name in self.remarks if name not in known.names]


def split(text: str, mark: str) -> dict[str, str]:
    """The parts of a text below each line that begins with the mark, by what stands behind it."""
    parts = re.split(rf"^{mark}(.+)$", text, flags=re.MULTILINE)
    return {title.strip().strip("`"): body.strip() for title, body in zip(parts[1::2], parts[2::2])}


def read_remarks(name: str) -> Remarks:
    """The remarks on an algorithm; none where nobody has written any."""
    file = REMARKS / f"{name}.md"
    return Remarks(file.read_text(encoding="utf-8") if file.exists() else "")


def page(name: str, text: str) -> str:
    """The page of an algorithm in Markdown."""
    known, remarks, common = script.read(name), Remarks(text), read_remarks(COMMON).remarks
    if wrong := remarks.unknown(known):
        raise ValueError(
            f"docs/algorithms/{name}.md remarks on {', '.join(wrong)}, which algos/{name}.py does not show"
        )
    parts = [f"---\nhide-toc: true\n---\n\n# {remarks.title or name.upper()}"]
    parts.append(fence("idea", name, remarks.sections.get("Formulas", "")))
    if remarks.sibling:
        parts += ["## Where it stands among its siblings", remarks.sections.get("What the diff teaches", "")]
        parts.append(fence("script-diff", f"{remarks.sibling} {name}"))
    parts += ["## The code", CODE.format(name=name), fence("script-contents", name)]
    section = ""
    for indices in groups(known):
        first = known.pieces[indices[0]]
        if first.section != section:
            section = first.section
            parts.append(f"### {section.capitalize()}")
        names = [known.pieces[i].name for i in indices]
        said = [each.get(piece, "") for piece in names for each in (remarks.remarks, common)]
        parts.append(fence("code-pair", f"{name} {' '.join(map(str, indices))}", "\n\n".join(filter(None, said))))
    if details := remarks.sections.get("Details that matter"):
        parts += ["## Details that matter", details]
    parts += ["## Hyperparameters", hyperparameters(known)]
    parts.append("## What to look at in TensorBoard")
    parts.append(fence("recorded-run", f"{name} healthy"))
    parts.append(remarks.sections.get("What to look at", ""))
    parts.append(fence("recorded-run", f"{name} sick"))
    parts += ["## Learning curves", fence("algorithm-curves", name)]
    parts += ["## A trained team", fence("film", f":{name}")]
    parts += ["## Commands", fence("commands", name)]
    return "\n\n".join(parts) + "\n"


CODE = """\
All of {{download}}`algos/{name}.py <../../algos/{name}.py>` from the networks to the training loop, each function
beside what there is to say about it. The numbers are those of the file's lines. Shapes are written as
`[time, env, agent]`."""


def fence(directive: str, argument: str, content: str = "") -> str:
    """A directive in Markdown."""
    return f"::::::{{{directive}}} {argument}\n{content}\n::::::"


def groups(known: script.Script) -> list[list[int]]:
    """The indices of the pieces that stand in one pair of columns: the head of a class goes with its first method."""
    found: list[list[int]] = []
    for i, piece in enumerate(known.pieces):
        last = known.pieces[found[-1][0]] if found else None
        joins = last and "." not in last.name and piece.name.startswith(f"{last.name}.") and len(found[-1]) == 1
        if last and last.name and joins:
            found[-1].append(i)
        else:
            found.append([i])
    return found


def hyperparameters(known: script.Script) -> str:
    """The paper's hyperparameters as tables in Markdown, a row for each flag."""
    paper, names = known.literal("PAPER"), known.literal("PAPER_FLAGS").split()
    families = [family for family in FAMILY_TITLES if (family, "shared") in paper]
    parts = [
        "These are the defaults for each family of tasks. They are what the search of "
        "[the benchmark paper](https://arxiv.org/abs/2006.07869) chose. All other flags are the same everywhere: "
        f"`python algos/{known.name}.py --help` lists them."
    ]
    for sharing, title in (("shared", "With parameter sharing"), ("independent", "Without parameter sharing")):
        rows = [f"| {title} | " + " | ".join(FAMILY_TITLES[family] for family in families) + " | what it is |"]
        rows.append("|---" * (len(families) + 2) + "|")
        for i, flag in enumerate(names):
            values = [f"{paper[family, sharing][i]}" for family in families]
            rows.append(f"| `--{flag.replace('_', '-')}` | " + " | ".join(values) + f" | {known.flags[flag][1]} |")
        parts.append("\n".join([":::{container} hyperparameters", *rows, ":::"]))
    return "\n\n".join(parts)


class Idea(SphinxDirective):
    """The script's docstring; the formulas, in LaTeX, in the place of those in plain text. Argument: the script."""

    required_arguments = 1
    has_content = True

    def run(self) -> list[nodes.Node]:
        blocks = plain_text.parse(script.read(self.arguments[0]).docstring)
        blocks = [block for block in blocks[1:] if not block.text.startswith("python algos/")]
        formulas = [i for i, block in enumerate(blocks) if block.kind == "verbatim"]
        found = plain_text.to_nodes(blocks)
        if "".join(self.content).strip() and formulas:
            before, after = plain_text.to_nodes(blocks[: formulas[0]]), plain_text.to_nodes(blocks[formulas[0] + 1 :])
            latex = nodes.container("", *self.parse_content_to_nodes(), classes=["formulas"])
            found = [*before, latex, *after]
        return found


class CodePair(SphinxDirective):
    """Code beside its commentary. Arguments: a script, and the numbers of its pieces. Content: the remarks."""

    required_arguments = 2
    final_argument_whitespace = True
    has_content = True

    def run(self) -> list[nodes.Node]:
        known = script.read(self.arguments[0])
        pieces = [known.pieces[int(i)] for i in self.arguments[1].split()]
        said = nodes.container("", classes=["said"])
        for piece in pieces:
            if piece.name and (piece.docstring or piece is pieces[0]):
                name = nodes.literal("", piece.name)
                said += nodes.paragraph("", "", name, classes=["name"], ids=[target_name(piece.name)])
            said += plain_text.to_nodes(plain_text.parse(piece.docstring)) if piece.docstring else []
        said += self.parse_content_to_nodes()
        numbers = tuple(number for piece in pieces for number in piece.lines)
        code = f'<div class="code highlight"><pre tabindex="0">{known.html_lines(numbers)}</pre></div>'
        return [nodes.container("", said, nodes.raw("", code, format="html"), classes=["pair"])]


def target_name(name: str) -> str:
    """The id of a function on its page."""
    return f"code-{name.replace('.', '-')}"


class ScriptContents(SphinxDirective):
    """Links to all functions of a page. Argument: the script."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        known = script.read(self.arguments[0])
        rows = []
        for section in known.sections:
            names = [
                piece.name
                for piece in known.pieces
                if piece.section == section and "." not in piece.name and piece.name
            ]
            links = ", ".join(f'<a href="#{target_name(name)}"><code>{name}</code></a>' for name in names)
            rows.append(f"<li><span>{section}</span><div>{links}</div></li>")
        return [nodes.raw("", f'<ul class="script-contents">{"".join(rows)}</ul>', format="html")]


class ScriptDiff(SphinxDirective):
    """The coloured difference of two scripts, from networks to train, as `diff -b` finds it. Arguments: both names."""

    required_arguments = 2

    def run(self) -> list[nodes.Node]:
        old, new = (script.read(name) for name in self.arguments)
        command = f"diff -b algos/{old.name}.py algos/{new.name}.py"
        text = (
            f'<div class="diff highlight"><div class="title"><code>{command}</code>, '
            f'from the networks to the training loop</div><pre tabindex="0">{diff(old, new)}</pre></div>'
        )
        return [nodes.raw("", text, format="html")]


def diff(old: script.Script, new: script.Script, around: int = 1) -> str:
    """What differs, in HTML: lines that go, lines that come, and so many lines around them."""
    ours, theirs = all_lines(old), all_lines(new)
    matcher = difflib.SequenceMatcher(
        None,
        [" ".join(old.lines[i - 1].split()) for i in ours],
        [" ".join(new.lines[i - 1].split()) for i in theirs],
        autojunk=False,
    )
    found = []
    for number, group in enumerate(matcher.get_grouped_opcodes(around)):
        if number:
            found.append('<span class="skip">⋯</span>')
        for tag, a0, a1, b0, b1 in group:
            if tag == "equal":
                found += [f'<span class="same">  {new.coloured[i - 1]}</span>' for i in theirs[b0:b1]]
                continue
            found += [f'<del><span aria-hidden="true">- </span>{old.coloured[i - 1]}</del>' for i in ours[a0:a1]]
            found += [f'<ins><span aria-hidden="true">+ </span>{new.coloured[i - 1]}</ins>' for i in theirs[b0:b1]]
    return "".join(found)


def all_lines(known: script.Script) -> list[int]:
    """The numbers of the lines that its page shows, with blank ones and docstrings."""
    ends = [*known.sections.values()]
    return [*range(ends[0][0], ends[-1][1] + 1)]


class RecordedRun(SphinxDirective):
    """TensorBoard's curves of a run in docs/data. Arguments: the algorithm, and healthy or sick."""

    required_arguments = 2

    def run(self) -> list[nodes.Node]:
        algorithm, health = self.arguments
        title = HEALTH_TITLES[health]
        runs = pd.read_csv(DATA / "runs.csv", keep_default_na=False)
        run = runs[(runs["algorithm"] == algorithm) & (runs["health"] == health)].iloc[0]
        self.env.note_dependency(str(DATA / "runs.csv"))
        command = f"python algos/{algorithm}.py --env lbf-8x8-2p-2f {run['flags']}"
        text = [nodes.strong("", f"{title}. "), nodes.Text(f"{run['ailment']} " if run["ailment"] else "")]
        head = nodes.paragraph("", "", *text, nodes.literal("", command), classes=["run-title"])
        file = DATA / f"{algorithm}-{health}.csv"
        if not file.exists():
            return [head, nodes.paragraph("", "This run has not been recorded yet.")]
        self.env.note_dependency(str(file))
        table = pd.read_csv(file)
        figures = [
            charts.figure(charts.scalar(rows), f"<code>{tag}</code>", f"{tag} over timesteps, {title.lower()}")
            for tag, rows in table.groupby("tag", sort=False)
            if tag not in UNTOLD and len(rows) > 1
        ]
        return [head, charts.grid(figures)]


UNTOLD = ("training/steps_per_second", "evaluation/return_std", "evaluation/episode_length")


class AlgorithmCurves(SphinxDirective):
    """An algorithm's learning curves on every task with results. Argument: the algorithm."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        name = self.arguments[0]
        found: list[nodes.Node] = [nodes.paragraph("", CURVES)]
        for sharing, words in (("shared", "With parameter sharing"), ("independent", "Without parameter sharing")):
            figures = []
            for task in results_data.paper_tasks():
                chart = charts.learning_curves(task, sharing, [name])
                if chart is not None:
                    described = f"Learning curve of {name.upper()} on {task}, {words.lower()}"
                    figures.append(charts.figure(chart, f"<code>{html.escape(task)}</code>", described))
            if figures:
                found += [nodes.rubric("", words), charts.grid(figures)]
        return found


CURVES = (
    "Evaluation returns, the mean over seeds with its interval 2 s / √n (no band: one seed). "
    "The dashed line is the paper's maximum return. Tasks that are not shown have not been measured yet."
)


class Commands(SphinxDirective):
    """The commands that train, watch and measure. Argument: the algorithm."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        name = self.arguments[0]
        lines = [*commands(name)]
        return [nodes.literal_block("", "\n".join(lines), language="bash")]


def commands(name: str) -> list[str]:
    """Commands with an algorithm, and what they do."""
    found = ["# train on a task of each family, with the paper's hyperparameters and budget"]
    found += [f"python algos/{name}.py --env {task}" for task in EXAMPLES.values()]
    found += [
        "# without parameter sharing, with another seed",
        f"python algos/{name}.py --env {EXAMPLES['lbf']} --no-parameter-sharing --seed 1",
    ]
    found += [
        "# all flags, with their defaults for this task",
        f"python algos/{name}.py --env {EXAMPLES['lbf']} --help",
    ]
    found += [
        "# play and film what was trained",
        f"python algos/{name}.py --watch runs/{EXAMPLES['lbf']}/{name}-shared/seed0",
    ]
    found += ["# its column in the paper's tables: what would run, and how many core hours it takes"]
    found += [f"python benchmark/run.py --algorithms {name} --tasks all --seeds 5 --sharing both --dry-run"]
    return found


class Line(SphinxRole):
    """{line}`update: ratios.clamp`: a link to the one line of the function that contains the text."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        own = self.env.docname.removeprefix("algorithms/")
        try:
            name, number = target(self.text, own if own in script.ALGORITHMS else None)
        except ValueError as error:
            return [], [self.inliner.reporter.error(str(error), line=self.lineno)]
        uri = f"#L{number}"
        if name != own:
            uri = self.env.app.builder.get_relative_uri(self.env.docname, f"algorithms/{name}") + uri
        return [nodes.reference("", f"line {number}", refuri=uri, internal=True, classes=["line-link"])], []


def target(text: str, own: str | None) -> tuple[str, int]:
    """Script and line that a link means; own: the script whose page it stands on. ValueError if there is none."""
    first, dot, rest = text.partition(".")
    if dot and first in script.ALGORITHMS:
        return first, script.read(first).find(rest)
    if own is None:
        raise ValueError(f"{text!r} does not begin with the name of a script")
    return own, script.read(own).find(text)


def write_page(app: Sphinx, docname: str, source: list[str]) -> None:
    """Puts the whole page in the place of the remarks."""
    folder, _, name = docname.partition("/")
    if folder == "algorithms" and name in script.ALGORITHMS:
        source[0] = page(name, source[0])
        for file in (script.ROOT / "algos" / f"{name}.py", REMARKS / f"{COMMON}.md"):
            app.env.note_dependency(str(file), docname=docname)


def setup(app: Sphinx) -> dict:
    """Called by Sphinx."""
    app.connect("source-read", write_page)
    app.add_role("line", Line())
    app.add_directive("idea", Idea)
    app.add_directive("code-pair", CodePair)
    app.add_directive("script-contents", ScriptContents)
    app.add_directive("script-diff", ScriptDiff)
    app.add_directive("recorded-run", RecordedRun)
    app.add_directive("algorithm-curves", AlgorithmCurves)
    app.add_directive("commands", Commands)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

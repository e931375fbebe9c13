"""Pages of the algorithms: a script and the remarks in docs/algorithms/<name>.md become one page.

The page is written as Markdown when Sphinx reads the remarks, so that they may use all that other pages may.
"""

import difflib
import re

import charts
import data_flow
import pandas as pd
import papers
import plain_text
import results_data
import script
import yaml
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective, SphinxRole

REMARKS = script.ROOT / "docs" / "algorithms"
DATA = script.ROOT / "docs" / "data"
FAMILY_TITLES = results_data.FAMILIES
EXAMPLES = {
    "matrix": "matrix-climbing",
    "mpe": "mpe-spread",
    "smac": "smaclite-3s5z-sc2-v2",
    "lbf": "lbf-15x15-3p-5f",
    "rware": "rware-tiny-4p",
}
SHARINGS = {"shared": "With parameter sharing", "independent": "Without parameter sharing"}
STEPS = "In eight lines"  # the section with the algorithm as pseudocode
# Symbols of the formulas where a docstring names them in prose. A alone may be an article.
SYMBOL = re.compile(
    r"(?<![\w'-])([rGHVQec]'?|mu'|A(?= the\s+advantage)|gamma\^k|[nkt](?=,|\s+(?:steps|rewards|\\<=)))(?![\w'-]|\.\w)"
)
NO_PROSE = re.compile(r"(```.*?```|`[^`]*`|\$[^$]*\$|\]\([^)]*\))", re.DOTALL)
RUNS = pd.read_csv(DATA / "runs.csv", keep_default_na=False)  # recorded ones


class Remarks:
    """What docs/algorithms/<name>.md says: its front matter, its sections, and the remarks by name."""

    def __init__(self, text: str):
        _, head, body = text.split("---\n", 2)
        front = yaml.safe_load(head)
        self.title: str = front["title"]
        self.sibling: str | None = front.get("sibling")
        self.in_latex: dict[str, str] = front.get("latex", {})
        self.facts = data_flow.Facts(**front.get("facts", {}))
        self.sections = split(body, "## ")
        self.remarks = split(self.sections.pop("Remarks"), "### ")

    def of(self, part: script.Part) -> str:
        """The remarks on a function, or on a class and its methods."""
        return "\n\n".join(text for name, text in self.remarks.items() if name.split(".")[0] == part.name)

    def unknown(self, known: script.Script) -> list[str]:
        """The remarks on what the script does not show."""
        return [name for name in self.remarks if name not in known.names]


def split(text: str, mark: str) -> dict[str, str]:
    """The parts of a text below each line that begins with the mark, by what stands behind it."""
    parts = re.split(rf"^{mark}(.+)$", text, flags=re.MULTILINE)
    return {title.strip().strip("`"): body.strip() for title, body in zip(parts[1::2], parts[2::2])}


def read_remarks(name: str) -> Remarks:
    """The remarks on an algorithm."""
    return Remarks((REMARKS / f"{name}.md").read_text(encoding="utf-8"))


def page(name: str, text: str) -> str:
    """The page of an algorithm in Markdown."""
    known, remarks = script.read(name), Remarks(text)
    if wrong := remarks.unknown(known):
        raise ValueError(
            f"docs/algorithms/{name}.md remarks on {', '.join(wrong)}, which algos/{name}.py does not show"
        )
    parts = [f"# {remarks.title}", facts(known, remarks.facts), idea(known, remarks)]
    if STEPS in remarks.sections:
        parts += [f"## {STEPS}", remarks.sections[STEPS]]
    if remarks.sibling:
        parts += ["## Where it stands among its siblings", remarks.sections["What the diff teaches"]]
        parts.append(fence("script-diff", f"{remarks.sibling} {name}"))
    parts += ["## The code", CODE.format(name=name), contents(known)]
    section = ""
    for part in known.parts:
        if part.section != section:
            section = part.section
            parts.append(f"### {section.capitalize()}")
        parts.append(shown(known, part, remarks.of(part)))
    parts += ["## Details that matter", remarks.sections["Details that matter"]]
    if "Unlike EPyMARL" in remarks.sections:
        parts += ["## Unlike EPyMARL", remarks.sections["Unlike EPyMARL"]]
    parts += ["## Hyperparameters", hyperparameters(known)]
    parts += ["## What to look at in TensorBoard"]
    if name in {*RUNS["algorithm"]}:
        parts.append(fence("recorded-runs", name))
    parts.append(remarks.sections["What to look at"])
    parts += ["## Learning curves", CURVES]
    measured = results_data.seeds()
    for sharing, title in SHARINGS.items():
        tasks = [task for task in results_data.paper_tasks() if (task, name, sharing) in measured]
        if tasks:
            parts += [f"**{title}**", fence("curves", " ".join(tasks), f":sharing: {sharing}\n:algorithms: {name}")]
    parts += ["## A trained team", fence("film", f":{name}")]
    parts += ["## Commands", "\n".join(["```bash", *commands(name), "```"])]
    return "\n\n".join(parts) + "\n"


CODE = """\
All of {{download}}`algos/{name}.py <../../algos/{name}.py>` from the networks to the training loop, with the numbers of
the file's lines. Shapes are written as `[time, env, agent]`. What has the same text as on an earlier page is folded."""


def fence(directive: str, argument: str, content: str = "") -> str:
    """A directive in Markdown."""
    return f"::::::{{{directive}}} {argument}\n{content}\n::::::"


def facts(known: script.Script, own: data_flow.Facts) -> str:
    """The box at the head of a page: where the algorithm stands, and one command with what it costs and brings."""
    name = known.name
    if own.replay:
        learns = "off-policy: from a replay of old episodes, one gradient step after each new one"
        acts = "drawn from its policy" if own.critic else "its best by value, or with probability epsilon any"
    else:
        steps = "several gradient steps" if own.epochs else "one gradient step"
        learns = f"on-policy: {steps} on a batch of ten new episodes, which is then thrown away"
        acts = "drawn from its policy"
    rows = [["learns", learns]]
    if own.critic:
        rows.append(["its critic sees", f"in training {own.critic}; in play there is no critic"])
    if own.mixed:
        rows.append(["the team's value", f"what {own.mixed} makes of the agents' values"])
    first, last = known.parts[0].first, known.parts[-1].last
    rows += [
        ["an agent sees", "its own observation; with `--network gru` what it saw before, too"],
        ["action", acts],
        ["parameters", "one network for all agents; with `--no-parameter-sharing` one for each"],
        ["papers", ", ".join(paper.label for paper in papers.cited(known.docstring))],
        ["file", f"`algos/{name}.py`: {len(known.lines)} lines, of which {last - first + 1} are on this page"],
        ["try it", results_data.one_command(name)],
    ]
    table = results_data.tables.to_markdown(["", ""], rows)
    return f":::::::{{container}} facts\n{table}\n\n{fence('data-flow', name)}\n:::::::"


def idea(known: script.Script, remarks: Remarks) -> str:
    """The script's docstring; the formulas, in LaTeX, in the place of those in plain text."""
    text = known.docstring
    _, _, text = plain_text.to_markdown(text).partition("\n\n")
    for plain, latex in remarks.in_latex.items():
        if plain_text.escape(plain) not in text:
            raise ValueError(f"the docstring of algos/{known.name}.py does not contain {plain!r}")
        text = text.replace(plain_text.escape(plain), latex)
    text = text.replace(f"docs/algorithms/{known.name}.md", "[Unlike EPyMARL](#unlike-epymarl)")  # that is this page
    prose = NO_PROSE.split(text)  # every second part is code, a formula or an address
    prose[::2] = [re.sub(r"\$(gamma|mu)", r"$\\\1", SYMBOL.sub(r"$\1$", part)) for part in prose[::2]]
    text = "".join(prose)
    blocks = re.split(r"\n*```text\n(.*?)\n```\n*", text, flags=re.DOTALL)
    before, after = blocks[0], "\n\n".join(blocks[2::2])
    return "\n\n".join([before, ":::::{container} formulas", remarks.sections["Formulas"], ":::::", after])


def contents(known: script.Script) -> str:
    """Links to all functions of a page."""
    rows = []
    for section in known.sections:
        names = [part.name for part in known.parts if part.section == section]
        rows.append(f"* {section}: " + ", ".join(f"[`{name}`](#{target_name(known.name, name)})" for name in names))
    return "\n".join(rows)


def target_name(algorithm: str, part: str) -> str:
    """The label of a function on its page."""
    return f"{algorithm}-{part.lower().replace('_', '-')}"


def shown(known: script.Script, part: script.Part, said: str) -> str:
    """A function with its remarks; folded, with a link to them, where an earlier page has the same text."""
    code = fence(
        "literalinclude",
        f"../../algos/{known.name}.py",
        f":lines: {part.first}-{part.last}\n:lineno-match:\n:language: python",
    )
    label = f"({target_name(known.name, part.name)})="
    earlier = first_page(known, part)
    if said or earlier is None:
        return "\n\n".join([label, f"#### `{part.name}`", code, said])
    there = f"[{earlier.upper()}](#{target_name(earlier, part.name)})"
    inside = f"What there is to say about it stands on the page of {there}.\n\n{code}"
    return f"{label}\n:::::::{{dropdown}} `{part.name}`, as on the page of {earlier.upper()}\n{inside}\n:::::::"


def first_page(known: script.Script, part: script.Part) -> str | None:
    """The first algorithm, in the order of reading, whose script has a function with this text; None if it is this."""
    text = known.text(part.first, part.last)
    for name in script.ALGORITHMS[: script.ALGORITHMS.index(known.name)]:
        other = script.read(name)
        if any(text == other.text(each.first, each.last) for each in other.parts):
            return name
    return None


def hyperparameters(known: script.Script) -> str:
    """The paper's hyperparameters as tables in Markdown, a row for each flag."""
    paper, names = known.literal("PAPER"), known.literal("TUNED").split()
    families = [family for family in FAMILY_TITLES if (family, "shared") in paper]
    chosen = "They are what the search of [the benchmark paper](https://arxiv.org/abs/2006.07869) chose. "
    parts = [
        f"These are the defaults for each family of tasks. {chosen if known.name in script.NINE else ''}"
        f"Budget and evaluations belong to the task, and all other flags are the same everywhere: "
        f"`python algos/{known.name}.py --help` lists them."
    ]
    for sharing, title in SHARINGS.items():
        head = [title, *(FAMILY_TITLES[family] for family in families), "what it is"]
        rows = []
        for i, flag in enumerate(names):
            values = (f"{paper[family, sharing][i]}" for family in families)
            rows.append([f"`--{flag.replace('_', '-')}`", *values, known.flags[flag][1]])
        table = results_data.tables.to_markdown(head, rows)
        parts.append(f":::{{container}} hyperparameters\n{table}\n:::")
    return "\n\n".join(parts)


class DataFlow(SphinxDirective):
    """The picture of who sees what in training and in play. Arguments: scripts."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        names = self.arguments[0].split()
        drawn = "".join(data_flow.picture(name, read_remarks(name).facts) for name in names)
        return [nodes.raw("", f'<div class="flows">{drawn}</div>', format="html")]


class ScriptDiff(SphinxDirective):
    """The difference of two scripts, from networks to train, as `diff -b` finds it. Arguments: both names."""

    required_arguments = 2

    def run(self) -> list[nodes.Node]:
        old, new = (script.read(name) for name in self.arguments)
        for known in (old, new):
            self.env.note_dependency(str(script.ROOT / "algos" / f"{known.name}.py"))
        command = f"diff -b algos/{old.name}.py algos/{new.name}.py"
        title = [nodes.literal("", command), nodes.Text(", from the networks to the training loop")]
        block = nodes.literal_block("", diff(old, new), language="diff")
        return [nodes.container("", nodes.paragraph("", "", *title), block, classes=["diff"])]


def diff(old: script.Script, new: script.Script) -> str:
    """Lines that go, lines that come, and one line around them; differences of indentation alone do not count."""
    before, after = (
        [line for first, last in known.sections.values() for line in known.lines[first - 1 : last]]
        for known in (old, new)
    )
    a, b = ([" ".join(line.split()) for line in lines] for lines in (before, after))
    matcher = difflib.SequenceMatcher(None, a, b, autojunk=False)
    found: list[str] = []
    for group in matcher.get_grouped_opcodes(1):
        found += ["@@"] * bool(found)
        for tag, a0, a1, b0, b1 in group:
            if tag == "equal":
                found += [f"  {line}" for line in after[b0:b1]]
            else:
                found += [f"- {line}" for line in before[a0:a1]] + [f"+ {line}" for line in after[b0:b1]]
    return "\n".join(found)


class RecordedRuns(SphinxDirective):
    """TensorBoard's curves of both runs in docs/data, the healthy and the sick one. Argument: the algorithm."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        [algorithm] = self.arguments
        self.env.note_dependency(str(DATA / "runs.csv"))
        heads: list[nodes.Node] = []
        curves = {}
        for health in charts.HEALTH:
            run = RUNS[(RUNS["algorithm"] == algorithm) & (RUNS["health"] == health)].iloc[0]
            file = DATA / f"{algorithm}-{health}.csv"
            self.env.note_dependency(str(file))
            table = pd.read_csv(file)
            curves[health] = {tag: rows for tag, rows in table.groupby("tag", sort=False) if len(rows) > 1}
            key = nodes.inline("", f"A {health} run. ", classes=["key", health])
            command = nodes.literal("", f"python algos/{algorithm}.py --env lbf-8x8-2p-2f {run['flags']}")
            ailment = nodes.Text(f"{run['ailment']} " if run["ailment"] else "")
            heads.append(nodes.paragraph("", "", key, ailment, command, classes=["run-title"]))
        figures = [
            charts.figure(
                charts.scalar({health: own[tag] for health, own in curves.items() if tag in own}),
                f"<code>{tag}</code>",
                f"{tag} over timesteps, of a healthy and a sick run",
            )
            for tag in curves["healthy"]
            if tag not in UNTOLD
        ]
        return [*heads, charts.grid(figures)]


UNTOLD = ("training/steps_per_second", "evaluation/return_std", "evaluation/episode_length")


CURVES = (
    "Evaluation returns, the mean over seeds with its interval 2 s / √n (no band: one seed). "
    "The dashed line is the paper's maximum return. Tasks that are not shown have not been measured yet."
)


def commands(name: str) -> list[str]:
    """Commands with an algorithm, and what they do."""
    task = EXAMPLES["lbf"]
    return [
        "# train on a task of each family, with the paper's hyperparameters and budget",
        *(f"python algos/{name}.py --env {each}" for each in EXAMPLES.values()),
        "# without parameter sharing, with another seed",
        f"python algos/{name}.py --env {task} --no-parameter-sharing --seed 1",
        "# all flags, with their defaults for this task",
        f"python algos/{name}.py --env {task} --help",
        "# play and film what was trained",
        f"python algos/{name}.py --watch runs/{task}/{name}-shared/seed0",
        "# its column in the paper's tables: what would run, and how many core hours it takes",
        f"python benchmark/run.py --algorithms {name} --tasks all --seeds 5 --sharing both --dry-run",
    ]


class Line(SphinxRole):
    """{line}`update: ratios.clamp`: a link to the one line of the function that contains the text."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        own = self.env.docname.removeprefix("algorithms/")
        try:
            name, number = target(self.text, own if own in script.ALGORITHMS else None)
        except ValueError as error:
            return [], [self.inliner.reporter.error(str(error), line=self.lineno)]
        uri = f"#L-{number}"
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
    if docname == "algorithms/index":  # a script beside the nine has its page behind theirs
        others = [name for name in script.ALGORITHMS if name not in script.NINE]
        source[0] = source[0].replace("\n*\n", "".join(f"\n{name}" for name in others) + "\n")
    folder, _, name = docname.partition("/")
    if folder == "algorithms" and name in script.ALGORITHMS:
        source[0] = page(name, source[0])
        for earlier in script.ALGORITHMS[: script.ALGORITHMS.index(name) + 1]:
            app.env.note_dependency(str(script.ROOT / "algos" / f"{earlier}.py"), docname=docname)


def name_lines(app: Sphinx, document: nodes.document) -> None:
    """Gives each line of a script on its own page an id, which an address can name."""
    if app.env.docname.removeprefix("algorithms/") in script.ALGORITHMS:
        for block in document.findall(nodes.literal_block):
            if block.get("linenos"):
                block["highlight_args"]["linespans"] = "L"


def setup(app: Sphinx) -> dict:
    """Called by Sphinx."""
    app.connect("source-read", write_page)
    app.connect("doctree-read", name_lines)
    app.add_role("line", Line())
    app.add_directive("data-flow", DataFlow)
    app.add_directive("script-diff", ScriptDiff)
    app.add_directive("recorded-runs", RecordedRuns)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

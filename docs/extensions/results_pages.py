"""Results on pages: curves, tables, claims, the map of seeds, and the explorer with its data and scripts."""

import html
import json
import shutil
from pathlib import Path
from typing import Any

import charts
import pandas as pd
import results_data
import script
import vl_convert
from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

WORDS = {"shared": "with parameter sharing", "independent": "without parameter sharing"}
FILMS = script.ROOT / "docs" / "films"


def raw(text: str) -> nodes.raw:
    """HTML as it stands."""
    return nodes.raw("", text, format="html")


def algorithms() -> list[str]:
    """The columns of all tables."""
    return [*results_data.ALGORITHMS]


def sharing(argument: str) -> str:
    """An option's value: shared or independent."""
    return directives.choice(argument, tuple(WORDS))


def task_name(task: str) -> str:
    """A task in HTML, with what its rows add to its name."""
    return f"<code>{html.escape(task)}</code>{html.escape(results_data.beside(task))}"


def number(mean: float, interval: float) -> str:
    """A mean, and smaller its interval, in HTML."""
    value, sign, width = results_data.tables.number(mean, interval).partition(" ± ")
    return value + (f' <span class="interval">± {width}</span>' if sign else "")


# What the commands of rows against the paper's opponents need.
FIRST = """<p>These runs play{against}, whose network is not part of this repository.
<a href="{root}environments/mpe.html#the-papers-own-opponents">Where to get it</a>. This converts it, once:</p>
<code>{command}</code><p>Then:</p>"""


def text_of_cell(cell: Any, name: str, root: str) -> str:
    """Our value, as a link to its CSV, and a button that shows the command behind it, with the paper's value below.
    name: the cell's id."""
    value, signs = number(cell.value, cell.interval), results_data.tables.signs(cell).strip()
    path, changed = results_data.tables_of_results()[cell.task, cell.algorithm, cell.sharing]
    file = f"{root}results/{path.parent.name}/{path.name}"
    seeds = int(results_data.seeds()[cell.task, cell.algorithm, cell.sharing])
    command = html.escape(results_data.campaign(cell.algorithm, cell.task, cell.sharing, changed, seeds))
    best = ' class="best"' if cell.mark == "best" else ""
    theirs = ""
    if not pd.isna(cell.paper_mean):
        theirs = f'<span class="paper">{number(cell.paper_mean, cell.paper_interval)}</span>'
    against = results_data.against(cell.task).replace(",", " against")
    first = FIRST.format(against=against, root=root, command=results_data.OPPONENTS_COMMAND) if against else ""
    return (
        f'<a{best} href="{file}.csv">{value}</a>{signs} '
        f'<button class="command" popovertarget="{name}-command">$</button>{theirs}'
        f'<div class="behind" popover id="{name}-command">{first}<code>{command}</code><br>'
        f'<a href="{file}.csv">CSV</a>, <a href="{file}.json">JSON</a>, <a href="#{name}">link to this number</a></div>'
    )


def cell_name(metric: str, task: str, algorithm: str, shared: str) -> str:
    """The id of a cell, which an address can name."""
    return "-".join([task, algorithm, shared] + ["average"] * (metric == "average_return"))


class Directive(SphinxDirective):
    """One that links to other files of the site."""

    def root(self) -> str:
        """The way from this page to the site's first folder."""
        return "../" * self.env.docname.count("/")

    def table(self, metric: str, shared: str) -> str:
        """One of the paper's tables in HTML, sortable by each column; nothing where we have no result for it."""
        cells = results_data.cells(metric)
        cells = cells[~cells["task"].map(results_data.store.has_older_rules).astype(bool)]
        cells = cells[cells["sharing"] == shared].rename(columns={"mean": "value"})
        known = {(cell.task, cell.algorithm): cell for cell in cells.itertuples()}
        rows = []
        for task in results_data.tables.in_order(cells["task"]):
            columns = []
            for name in algorithms():
                cell = known.get((task, name))
                if cell is None:
                    columns.append("<td></td>")
                    continue
                own = cell_name(metric, task, name, shared)
                text = text_of_cell(cell, own, self.root())
                columns.append(f'<td id="{own}" data-value="{cell.value:.6g}">{text}</td>')
            rows.append(f'<tr><th scope="row">{task_name(task)}</th>{"".join(columns)}</tr>')
        if not rows:
            return ""
        head = "".join(f'<th scope="col">{name.upper()}</th>' for name in algorithms())
        return (
            f'<div class="wide"><table class="results sortable"><thead><tr><th scope="col">task</th>{head}</tr></thead>'
            f"<tbody>{''.join(rows)}</tbody></table></div>"
        )


class Curves(Directive):
    """Learning curves of tasks. Arguments: their names. Options: sharing, algorithms."""

    required_arguments = 1
    final_argument_whitespace = True
    option_spec = {"sharing": sharing, "algorithms": directives.unchanged}  # noqa: RUF012

    def run(self) -> list[nodes.Node]:
        shared = self.options.get("sharing", "shared")
        names = self.options.get("algorithms", " ".join(algorithms())).split()
        found: list[str] = []
        missing: list[str] = []
        for task in self.arguments[0].split():
            chart = charts.learning_curves(task, shared, names, legend=len(names) > 1)
            if chart is None:
                missing.append(task)
                continue
            described = f"Learning curves on {task}, {WORDS[shared]}"
            found.append(charts.figure(chart, task_name(task), described))
        text = f"Not measured yet: {', '.join(missing)}." if missing else ""
        return [charts.grid(found), *([nodes.paragraph(text, text)] if text else [])]


class ResultsTable(Directive):
    """One of the paper's tables. Arguments: a metric of report.py, and shared or independent."""

    required_arguments = 2

    def run(self) -> list[nodes.Node]:
        metric = directives.choice(self.arguments[0], tuple(results_data.TITLES))
        shared = sharing(self.arguments[1])
        title = f"{results_data.TITLES[metric]}, {WORDS[shared]}"
        if not (table := self.table(metric, shared)):
            text = f"{title}: nothing has been measured yet."
            return [nodes.paragraph(text, text)]
        return [nodes.rubric("", title), raw(table)]


class Claims(Directive):
    """The paper's claims, judged by its own tables and by our results."""

    def run(self) -> list[nodes.Node]:
        rows: list[str] = []
        counts: dict[str, int] = {}
        for place, sentence, paper, ours, behind in results_data.verdicts():
            counts[ours] = counts.get(ours, 0) + 1
            kinds = [verdict.replace(" ", "-") for verdict in (paper, ours)]
            said = "".join(f'<div class="figures">{html.escape(text)}</div>' for text in behind if text)
            rows.append(
                f"<tr><td>{place}</td><td>{html.escape(sentence)}{said}</td>"
                f'<td class="verdict {kinds[0]}">{paper}</td><td class="verdict {kinds[1]}">{ours}</td></tr>'
            )
        summary = ", ".join(f"{verdict}: {count}" for verdict, count in counts.items())
        text = f"{len(rows)} claims. By our results {summary}."
        head = "".join(
            f'<th scope="col">{title}</th>' for title in ("section", "claim", "by the paper's tables", "by our results")
        )
        table = (
            f'<div class="wide"><table class="claims sortable"><thead><tr>{head}</tr></thead>'
            f"<tbody>{''.join(rows)}</tbody></table></div>"
        )
        return [nodes.paragraph(text, text), raw(table)]


class SeedsMap(Directive):
    """Which of the paper's cells are measured, with how many seeds: tasks, algorithms, with and without sharing."""

    def run(self) -> list[nodes.Node]:
        last = results_data.seeds()
        rows = []
        for task in results_data.paper_tasks():
            columns = []
            for name in algorithms():
                halves = ""
                for shared, word in (("shared", "with sharing"), ("independent", "without")):
                    seeds = int(last.get((task, name, shared), 0))
                    other = seeds and "total_timesteps" in results_data.tables_of_results()[task, name, shared][1]
                    mark = "†" if other else ""
                    title = f"{name.upper()}, {task}, {word}: seeds {seeds}{', another budget' if other else ''}"
                    content = f"{seeds}{mark}" if seeds else "·"
                    if seeds:
                        link = f"{self.root()}tables.html#{cell_name('max_return', task, name, shared)}"
                        content = f'<a href="{link}">{content}</a>'
                    attributes = f'class="seeds" data-seeds="{min(seeds, 5)}" title="{html.escape(title)}"'
                    halves += f"<span {attributes}>{content}</span>"
                columns.append(f"<td>{halves}</td>")
            name = f"<code>{html.escape(task)}</code>{html.escape(results_data.against(task))}"
            rows.append(f'<tr><th scope="row">{name}</th>{"".join(columns)}</tr>')
        head = "".join(f'<th scope="col">{name.upper()}</th>' for name in algorithms())
        measured = int((last.reindex([key for key in last.index if key[0] in results_data.paper_tasks()]) > 0).sum())
        text = (
            f"{measured} of {len(rows) * len(algorithms()) * 2} cells have results. In each the left half is with, the "
            "right half without parameter sharing; the number is that of the seeds (the paper has five), and † means "
            "another budget than the paper's."
        )
        table = (
            f'<div class="wide"><table class="seeds-map"><thead><tr><th scope="col">task</th>{head}</tr></thead>'
            f"<tbody>{''.join(rows)}</tbody></table></div>"
        )
        return [nodes.paragraph(text, text), raw(table)]


class ReportText(Directive):
    """A sentence or a table that report.py writes, by the directive's name."""

    def run(self) -> list[nodes.Node]:
        report = results_data.report()
        text = {
            "coverage": report.coverage,
            "coverage-table": report.coverage_table,
            "agreement": report.agreement,
            "agreement-by-family": report.agreement_table,
            "disagreements": report.differences,
            "cpu-hours": lambda: f"{report.cpu_table()}\n\n{report.cpu_sentence()}",
        }[self.name]()
        found = self.parse_text_to_nodes(text)
        return [
            nodes.container("", node, classes=["wide"]) if isinstance(node, nodes.table) else node for node in found
        ]


def write_data(static: Path) -> None:
    """The kinds of charts, and what static/explorer.js shows: all tasks and algorithms, and a file for each task."""
    curves = results_data.curves()
    tasks = results_data.tables.in_order(curves["task"])
    families = {task: results_data.store.FAMILIES[results_data.store.family(task)] for task in tasks}
    write_script(static / "chart-kinds.js", "window.chartKinds", charts.kinds())
    measured = curves.groupby("task")["sharing"].unique()
    overview = {
        "families": families,
        "algorithms": algorithms(),
        "names": {task: f"{task}{results_data.beside(task)}" for task in tasks},
        "sharings": {task: [sharing for sharing in WORDS if sharing in measured[task]] for task in tasks},
    }
    write_script(static / "explorer-data.js", "window.explorerTasks = {}; window.explorerData", overview)
    (static / "explorer").mkdir(exist_ok=True)
    for task in tasks:
        shown = {sharing: charts.learning_curves(task, sharing, algorithms()) for sharing in WORDS}
        write_script(static / "explorer" / f"{task}.js", f"window.explorerTasks[{json.dumps(task)}]", shown)


def write_script(file: Path, name: str, value: Any) -> None:
    """A script that gives a variable its value: browsers do not fetch JSON from file://."""
    file.write_text(f"{name} = {json.dumps(value, separators=(',', ':'))};\n", encoding="utf-8")


def write_files(app: Sphinx, error: Exception | None) -> None:
    """Puts Vega's scripts, the charts' data, results and films into the site."""
    if error is not None or app.builder.format != "html":
        return
    static = Path(app.outdir, "_static")
    vega = vl_convert.javascript_bundle("window.vegaEmbed = vegaEmbed;")
    (static / "vega.js").write_text(f"(() => {{\n{vega}\n}})();\n", encoding="utf-8")
    write_data(static)
    for path, _ in results_data.tables_of_results().values():
        folder = Path(app.outdir, "results", path.parent.name)
        folder.mkdir(parents=True, exist_ok=True)
        for suffix in ("csv", "json"):
            shutil.copy(f"{path}.{suffix}", folder)
    shutil.copytree(FILMS, Path(app.outdir, "films"), dirs_exist_ok=True)


def add_explorer(app: Sphinx, pagename: str, templatename: str, context: dict, doctree: nodes.document | None) -> None:
    """Gives the explorer's page its script and data."""
    if pagename == "explorer":
        app.add_js_file("explorer-data.js", priority=900, defer="defer")
        app.add_js_file("explorer.js", priority=901, defer="defer")


def setup(app: Sphinx) -> dict:
    """Called by Sphinx."""
    app.add_directive("curves", Curves)
    app.add_directive("results-table", ResultsTable)
    app.add_directive("claims", Claims)
    app.add_directive("seeds-map", SeedsMap)
    for name in ("coverage", "coverage-table", "agreement", "agreement-by-family", "disagreements", "cpu-hours"):
        app.add_directive(name, ReportText)
    app.connect("html-page-context", add_explorer)
    app.connect("build-finished", write_files)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

"""Pages of the environments: rules, observations value by value, tasks, speed, films."""

import csv
import html
import importlib

import observations
import pandas as pd
import plain_text
import results_data
import script
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective, SphinxRole

import envs
from envs.tasks import PAPER_TASKS

FILMS = script.ROOT / "docs" / "films"


def tasks_of(family: str) -> list[str]:
    """The paper's tasks of a family."""
    return [task for task in PAPER_TASKS if task.startswith(family)]


class Rules(SphinxDirective):
    """The docstring of a module, set as a page. Argument: its full name."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        module = importlib.import_module(self.arguments[0])
        self.env.note_dependency(module.__file__ or "")
        return self.parse_text_to_nodes(plain_text.to_markdown(module.__doc__ or ""))


class ObservationBar(SphinxDirective):
    """Which value of an observation is what. Arguments: tasks."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        found: list[nodes.Node] = []
        for task in self.arguments[0].split():
            env = envs.make(task)
            for title, values in observations.kinds(task).items():
                head = f"<code>{task}</code>" + (f", {title}" if title else "") + f": {env.obs_size} values"
                found.append(
                    nodes.raw(
                        "",
                        f'<figure class="observation"><figcaption>{head}</figcaption>{bar(values)}</figure>',
                        format="html",
                    )
                )
        return found


def bar(values: list[observations.Value]) -> str:
    """The bar in HTML: a box for each thing that is observed, in it a field for each value."""
    boxes: list[tuple[str, str, list[str]]] = []
    for index, value in enumerate(values):
        if not boxes or boxes[-1][0] != value.thing:
            boxes.append((value.thing, value.kind, []))
        title = html.escape(f"{index}: {value.thing}, {value.name}")
        boxes[-1][2].append(f'<span title="{title}"><b>{index}</b>{html.escape(value.name)}</span>')
    parts = [
        f'<div class="box {kind}"><div class="of">{html.escape(thing)}</div>'
        f'<div class="values">{"".join(fields)}</div></div>'
        for thing, kind, fields in boxes
    ]
    return f'<div class="bar">{"".join(parts)}</div>'


class TasksTable(SphinxDirective):
    """The paper's tasks of a family with sizes and budgets. Argument: the family."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        sizes = ["agents", "actions", "observation", "state", "longest episode"]
        head = ["task", *sizes, "on-policy steps", "off-policy steps"]
        rows = []
        for name in tasks_of(self.arguments[0]):
            task, env = envs.task(name), envs.make(name)
            numbers = (env.n_agents, env.n_actions, env.obs_size, env.state_size, env.episode_limit)
            budgets = (task.on_policy_timesteps, task.off_policy_timesteps)
            rows.append([f"`{name}`", *(f"{number:,}" for number in (*numbers, *budgets))])
        return wide_table(self, head, rows)


class SpeedTable(SphinxDirective):
    """Steps per second on a family's tasks: the paper's, the original package's, ours. Argument: the family."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        family = self.arguments[0]
        table = results_data.report().speeds
        table = table[table["task"].str.startswith((family, "smac-") if family == "smaclite" else family)]
        wide = table.pivot_table(index="task", columns="whose", values="steps_per_second")[[*table["whose"].unique()]]
        rows = [
            [f"`{task}`", *("" if pd.isna(speed) else f"{speed:,.0f}" for speed in wide.loc[task])]
            for task in results_data.tables.in_order(pd.Series(wide.index))
        ]
        return wide_table(self, ["steps per second", *wide.columns], rows)


def wide_table(directive: SphinxDirective, head: list[str], rows: list[list[str]]) -> list[nodes.Node]:
    """A table of Markdown that may be wider than the page."""
    table = directive.parse_text_to_nodes(results_data.tables.to_markdown(head, rows))
    return [nodes.container("", *table, classes=["wide"])]


def films() -> list[dict[str, str]]:
    """The films that there are: film, task, algorithm, timesteps, return_mean."""
    file = FILMS / "films.csv"
    if not file.exists():
        return []
    with open(file, newline="", encoding="utf-8") as rows:
        return list(csv.DictReader(rows))


class Film(SphinxDirective):
    """The film of a task, or with a colon before its name, of an algorithm. Argument: the name."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        name = self.arguments[0]
        column = "algorithm" if name.startswith(":") else "task"
        own = [film for film in films() if film[column] == name.removeprefix(":")]
        if not own:
            text = f"There is no film of {name.removeprefix(':')} yet."
            return [nodes.paragraph(text, text)]
        root = "../" * self.env.docname.count("/")
        film = max(own, key=lambda film: int(film["timesteps"]))
        caption = (
            f"{film['algorithm'].upper()} on <code>{film['task']}</code> after {int(film['timesteps']):,} timesteps; "
            f"mean return of its last evaluation {float(film['return_mean']):.2f}"
        )
        described = f"Film of a team that {film['algorithm'].upper()} has trained on {film['task']}"
        text = (
            f'<figure class="film"><img src="{root}films/{film["film"]}" alt="{described}" loading="lazy" '
            f'width="{film["width"]}" height="{film["height"]}"><figcaption>{caption}</figcaption></figure>'
        )
        return [nodes.raw("", text, format="html")]


class Source(SphinxRole):
    """{source}`envs/vector.py`: the file's name; a link to it where conf.py knows the address of the repository."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        if not (script.ROOT / self.text).exists():
            return [], [self.inliner.reporter.error(f"there is no file {self.text}", line=self.lineno)]
        code = nodes.literal("", self.text)
        address = self.config.repository
        return [nodes.reference("", "", code, refuri=f"{address}/blob/main/{self.text}") if address else code], []


def setup(app: Sphinx) -> dict:
    """Called by Sphinx."""
    app.add_config_value("repository", "", "env")
    app.add_role("source", Source())
    app.add_directive("rules", Rules)
    app.add_directive("observation-bar", ObservationBar)
    app.add_directive("tasks-table", TasksTable)
    app.add_directive("speed-table", SpeedTable)
    app.add_directive("film", Film)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

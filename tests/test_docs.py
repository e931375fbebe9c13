"""The site: links from pages into scripts, observations value by value, and the built pages in a real browser."""

import dataclasses
import functools
import json
import re
import shlex
import shutil
import subprocess
import sys
import time
import urllib.parse
from collections.abc import Iterator
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pandas as pd
import programs
import pytest
import test_readme
from docutils import nodes
from scipy.stats import t
from scripts import NINE, ROOT, trained
from selenium import webdriver

import envs
from benchmark import measures, plan, run
from envs.runs import Flags
from envs.tasks import PAPER_TASKS

DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS / "extensions"))

import algorithm_pages  # noqa: E402
import data_flow  # noqa: E402
import environment_pages  # noqa: E402
import observations  # noqa: E402
import papers  # noqa: E402
import plain_text  # noqa: E402
import results_data  # noqa: E402
import script  # noqa: E402

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
LARGEST_PAGE, LARGEST_FILM = 1_500_000, 500_000  # bytes


# --- pages and scripts ---
@pytest.mark.parametrize("name", script.ALGORITHMS)
def test_every_line_of_a_script_stands_on_its_page_once(name):
    known = script.read(name)
    shown = [number for part in known.parts for number in range(part.first, part.last + 1)]
    assert shown == sorted(set(shown))
    first, last = known.sections["networks"][0], known.sections["train"][1]
    for number in set(range(first, last + 1)) - set(shown):
        assert re.fullmatch(r"(# --- \w+ ---)?", known.lines[number - 1])


@pytest.mark.parametrize("name", script.ALGORITHMS)
def test_remarks_are_about_what_the_script_shows(name):
    remarks = algorithm_pages.read_remarks(name)
    assert remarks.remarks and remarks.unknown(script.read(name)) == []
    needed = {"Formulas", "Details that matter", "What to look at"} - remarks.sections.keys()
    assert not needed, f"docs/algorithms/{name}.md has no section {', '.join(needed)}"
    if name in NINE:
        steps = remarks.sections[algorithm_pages.STEPS].partition("```text\n")[2].partition("\n```")[0]
        assert len(steps.splitlines()) == 8


def test_what_is_folded_has_the_text_of_an_earlier_page_and_no_remark():
    coma = script.read("coma")
    folded = {part.name: algorithm_pages.first_page(coma, part) for part in coma.parts}
    assert folded["gradient_step"] == "ia2c" and folded["update"] is None and folded["counterfactual_inputs"] is None
    texts = {name: (DOCS / "algorithms" / f"{name}.md").read_text(encoding="utf-8") for name in ("coma", "ia2c")}
    page = algorithm_pages.page("coma", texts["coma"])
    assert "docs/algorithms/coma.md" not in page and "[Unlike EPyMARL](#unlike-epymarl)" in page
    assert "{dropdown} `gradient_step`" in page and "#### `update`" in page and "{dropdown} `update`" not in page
    assert "{dropdown}" not in algorithm_pages.page("ia2c", texts["ia2c"])


@pytest.mark.parametrize("name", script.ALGORITHMS)
def test_the_facts_of_a_page_are_those_of_its_script(monkeypatch, name):
    facts = algorithm_pages.read_remarks(name).facts
    assert facts.critic in ("", *data_flow.INPUTS) and facts.mixed in data_flow.MIXED, f"facts of {name}.md"
    flags, run = script.read(name).flags, trained(monkeypatch, name, 0, "mpe-speaker-listener")
    assert (facts.replay, facts.epochs) == ("buffer_size" in flags, "update_epochs" in flags)
    assert (facts.mixed == "a mixing network") == ("mixer" in run.parts)
    sees = {"the agent's observation": run.env.obs_size, "the state": run.env.state_size}.get(
        facts.critic, run.env.state_size + run.env.n_agents * run.env.n_actions
    )
    critic = run.parts.get("critic")
    seen = next(critic.parameters()).shape[1] - run.env.n_agents if critic else None  # its own number comes beside it
    assert seen == (sees if facts.critic else None)


def test_papers_are_found_by_title_and_by_authors():
    text = 'Tan (1993); Rashid et al., 2018; "Time Limits in\nReinforcement Learning"; Nobody et al. (2018)'
    links = [node.astext() for node in papers.linked(text) if isinstance(node, nodes.reference)]
    assert links == ["Tan (1993)", "Rashid et al., 2018", "Time Limits in\nReinforcement Learning"]
    for name in NINE:
        assert len(papers.cited(script.read(name).docstring)) >= 2, name  # its own, and the benchmark's


def lines_linked():
    """Every {line} of every page: the page, its text."""
    for file in sorted(DOCS.glob("**/*.md")):
        for text in re.findall(r"\{line\}`([^`]+)`", file.read_text(encoding="utf-8")):
            yield file.relative_to(DOCS).with_suffix("").as_posix(), text


def test_links_to_lines_mean_exactly_one_line():
    linked = list(lines_linked())
    assert len(linked) > 50
    for page, text in linked:
        own = page.removeprefix("algorithms/")
        owner = own if own in script.ALGORITHMS else None
        algorithm_pages.target(text, owner)  # raises ValueError where the line is gone, or no longer the only one


def test_a_link_to_a_line_that_is_gone_is_an_error():
    known = script.Script("toy", "# --- train ---\ndef train(a):\n    b = a\n    return a\n\n\n# --- end ---\n")
    assert known.find("train: b = a") == 3
    for wrong in ("train: c = a", "train: a", "trains: b = a", "train"):
        with pytest.raises(ValueError):
            known.find(wrong)


@pytest.mark.parametrize("name", script.ALGORITHMS)
def test_as_many_formulas_in_latex_as_in_the_docstring(name):
    plain = re.findall(r"^ {4}\S.{0,12} = ", script.read(name).docstring, re.MULTILINE)
    formulas = re.findall(r"\$\$(.+?)\$\$", algorithm_pages.read_remarks(name).sections["Formulas"], re.DOTALL)
    assert len(formulas) >= len(plain) > 0


def test_symbols_of_the_formulas_are_mathematics_in_prose_too():
    page = algorithm_pages.page("mappo", (DOCS / "algorithms" / "mappo.md").read_text(encoding="utf-8"))
    prose = " ".join(page.partition("## In eight lines")[0].split())
    assert "$G$ is the n-step return, $A$ the advantage, $H$ the entropy" in prose
    assert "$\\gamma^k$ $V'$ of" in prose and "$r$ is the team's" in prose
    assert (
        "copy of the critic $V$, so" in prose and "follow every step of $V$." in prose and " A critic, needed" in prose
    )
    page = algorithm_pages.page("maddpg", (DOCS / "algorithms" / "maddpg.md").read_text(encoding="utf-8"))
    assert r"and $\mu'$ takes the likeliest action" in page


@pytest.mark.parametrize("name", script.ALGORITHMS)
def test_commands_of_a_page_have_flags_and_tasks_that_exist(name):
    table = pd.read_csv(DOCS / "data" / "runs.csv", keep_default_na=False)
    recorded = [f"python algos/{name}.py {flags}" for flags in table[table["algorithm"] == name]["flags"]]
    commands = [line for line in algorithm_pages.commands(name) if not line.startswith("#")]
    assert len(commands) > 7 and len(recorded) == (2 if name in NINE else 0)
    for command in commands + recorded:
        words = shlex.split(command)
        assert words[0] == "python" and (ROOT / words[1]).exists()
        if words[1].startswith("algos"):
            flags = {word[2:].removeprefix("no-").replace("-", "_") for word in words if word.startswith("--")}
            shared = {field.name for field in dataclasses.fields(Flags)}
            assert flags <= {*script.read(name).flags, *shared, "help"}, command
            if "--env" in words:
                envs.task(words[words.index("--env") + 1])


def test_the_command_of_a_result_has_switches_and_files():
    changed: dict[str, Any] = {"reward_standardisation": False, "parameter_sharing": True}
    command = results_data.campaign("mappo", "mpe-tag", "shared", changed, 1)
    assert command.endswith(" -- --parameter-sharing --no-reward-standardisation")
    command = results_data.campaign("mappo", "mpe-tag", "shared", measures.paper_setting("mpe-tag"), 1)
    assert shlex.split(command)[-2:] == ["--env-kwargs", "opponent='opponents/paper-tag.npz'"]


@pytest.mark.slow
def test_the_command_of_a_result_names_its_runs():
    changed = {"total_timesteps": 3000000}
    command = results_data.campaign("ia2c", "lbf-8x8-2p-2f-c", "independent", changed, 1)
    plan, dashes, flags = command.partition(" -- ")
    words = [sys.executable, *shlex.split(f"{plan} --dry-run{dashes}{flags}")[1:]]
    done = programs.run(words, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert "ia2c" in done.stdout + done.stderr


def test_recorded_runs_are_there_for_each_algorithm():
    for name in NINE:
        for health in ("healthy", "sick"):
            assert (DOCS / "data" / f"{name}-{health}.csv").stat().st_size > 1000


def test_films_are_small_enough():
    films = {film.name: film.stat().st_size for film in (DOCS / "films").glob("*.webp")}
    assert films and max(films.values()) < LARGEST_FILM
    assert sorted(films) == [film["film"] for film in environment_pages.films()]


def test_no_film_is_enlarged():
    """Else it would be blurred."""
    for film in environment_pages.films():
        env = envs.make(film["task"], 1, pictures=True)
        env.reset()
        assert int(film["width"]) <= env.frame(index=0).shape[1]


def test_a_docstring_becomes_markdown():
    text = "It is so.\n\nn: the number, o_i,t at first.\nReturns x [a, b]. See `f` and --flag.\n"
    text += "\n    a  1\n    b_c  2\n       and more\n\nmap  a long\n        name\n\n    y_t = 2  3\n"
    found = plain_text.to_markdown(text).split("\n\n")
    assert found[:3] == [
        "It is so.",
        "`n`: the number, $o_{i,t}$ at first.",
        r"Returns x \[a, b\]. See `f` and `--flag`.",
    ]
    assert found[3].splitlines()[2:] == ["| a | 1 |", "| `b_c` | 2 and more |"]
    assert found[4].splitlines()[2:] == ["| map | a long name |"]
    assert found[5] == "```text\ny_t = 2  3\n```"


# --- observations, value by value ---
def seen(name: str, agent: int = 0, kind: str | None = None, steps: int = 30) -> Iterator[tuple[Any, dict]]:
    """Observations of a task in random play, each as (env, {(thing, value's name): value} of one agent)."""
    env = envs.make(name, num_envs=1, seed=3)
    values = observations.kinds(name)
    labels = [(value.thing, value.name) for value in values[kind or next(iter(values))]]
    assert len(labels) == env.obs_size
    observed, info = env.reset()
    rng = np.random.default_rng(0)
    for _ in range(steps):
        yield env, dict(zip(labels, observed[0, agent].tolist()))
        actions = [[rng.choice(np.flatnonzero(mask)) for mask in masks] for masks in info["action_mask"]]
        observed, _, terminated, truncated, info = env.step(actions)
        if terminated[0] or truncated[0]:
            return


@pytest.mark.parametrize("name", PAPER_TASKS)
def test_every_value_has_a_label(name):
    for values in observations.kinds(name).values():
        assert len(values) == envs.make(name).obs_size


@pytest.mark.parametrize("name", ["lbf-8x8-2p-2f-c", "lbf-15x15-4p-5f"])
def test_labels_of_foraging(name):
    for env, value in seen(name):
        for own, thing in ((0, "the agent itself"), *((k, f"other agent {k}") for k in range(1, env.n_agents))):
            place = [value[thing, part] for part in ("row", "column", "level")]
            assert place == env.game.agent[0, own].tolist()
        foods = [food.tolist() for food in env.game.food[0] if food[2] > 0]
        for k, food in enumerate(foods, 1):
            assert [value[f"food {k}", part] for part in ("row", "column", "level")] == food


CELLS = [
    ("cell 1 up 1 left", -1, -1),
    ("cell 1 up", -1, 0),
    ("cell 1 up 1 right", -1, 1),
    ("cell 1 left", 0, -1),
    ("cell 1 right", 0, 1),
    ("cell 1 down 1 left", 1, -1),
    ("cell 1 down", 1, 0),
    ("cell 1 down 1 right", 1, 1),
]


def test_labels_of_the_warehouse():
    met = set()
    for env, value in seen("rware-tiny-4p", steps=200):
        game = env.game
        row, column, direction, load = game.agent[0, 0].tolist()
        own = {part: value["the agent itself", part] for part in ("row", "column", "carries a shelf")}
        assert own == {"row": row, "column": column, "carries a shelf": load >= 0}
        assert value["the agent itself", ("up", "down", "left", "right")[direction]] == 1
        shelves = {tuple(shelf[:2]): shelf[2] for shelf in game.shelf[0].tolist()}
        agents = {tuple(agent[:2]) for agent in game.agent[0].tolist()}
        for thing, down, across in CELLS:
            place = row + down, column + across
            assert value[thing, "shelf"] == (place in shelves)
            assert value[thing, "requested"] == shelves.get(place, 0)
            assert value[thing, "agent"] == (place in agents)
            met |= {part for part in ("shelf", "requested", "agent") if value[thing, part]}
    assert met == {"shelf", "requested", "agent"}  # the comparison met ones, not only zeros


@pytest.mark.parametrize(
    ("name", "agent", "kind"),
    [
        ("mpe-spread", 0, "agent 0"),
        ("mpe-tag", 0, "the first predator"),
        ("mpe-adversary", 0, "the first good agent"),
        ("mpe-speaker-listener", 1, "agent 1, the listener"),
    ],
)
def test_labels_of_the_particle_environments(name, agent, kind):
    for env, value in seen(name, agent, kind, steps=10):
        game = env.game
        me = {"mpe-adversary": 1, "mpe-speaker-listener": 1}.get(name, 0)
        own, speed = game.agent_position[0, me], game.agent_velocity[0]
        for (thing, part), number in value.items():
            axis = {"x": 0, "y": 1}.get(part)
            if thing == "velocity":
                expected = speed[me, axis]
            elif thing == "position":
                expected = own[axis]
            elif thing == "the prey's velocity":
                expected = speed[3, axis]
            elif thing == "goal":
                expected = game.landmark_position[0, game.goal[0], axis] - own[axis]
            elif thing.startswith("landmark"):
                expected = game.landmark_position[0, int(thing[-1]), axis] - own[axis]
            elif thing == "the symbol said":
                expected = float(game.symbol[0] == int(part))
            elif thing == "zeros":
                expected = 0
            else:
                number_of = 3 if "prey" in thing else int(thing[-1])
                expected = game.agent_position[0, number_of, axis] - own[axis]
            assert number == pytest.approx(expected, abs=1e-6), (thing, part)


def test_labels_of_the_speaker():
    env: Any = envs.make("mpe-speaker-listener", seed=3)
    observed, _ = env.reset()
    labels = observations.kinds("mpe-speaker-listener")["agent 0, the speaker"]
    goal = [value.thing for value, number in zip(labels, observed[0, 0]) if number > 0.6]
    assert goal == [f"landmark {env.game.goal[0]}"]


@pytest.mark.parametrize("name", ["smaclite-3s5z-sc2", "smaclite-MMM2-sc2", "smaclite-2s_vs_1sc-sc2"])
def test_labels_of_the_battles(name):
    met = 0
    for env, value in seen(name, steps=40):
        units, names = env.game.unit[0], env.unit_names
        me = units[0]
        for k in range(1, len(units)):
            side = f"ally {k}" if k < env.n_agents else f"enemy {k - env.n_agents}"
            thing, other = f"{side}, {names[k]}", units[k]
            across, up = other.x - me.x, other.y - me.y
            near = other.hp > 0 and me.hp > 0 and np.hypot(across, up) < 9
            met += near
            for part, expected in (("x", across / 9), ("y", up / 9), ("hp", other.hp / other.max_hp), (names[k], 1)):
                if (thing, part) in value:
                    assert value[thing, part] == pytest.approx(expected if near else 0, abs=1e-5), (thing, part)
        assert value["the unit itself", "hp"] == pytest.approx(me.hp / me.max_hp, abs=1e-6)
    assert met > 20


# --- the built site in a browser ---
@pytest.fixture(scope="session")
def site(made_once):
    """The site, built as the README says."""

    def build(folder):
        command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", str(DOCS), str(folder)]
        built = subprocess.run(command, capture_output=True, text=True)
        assert built.returncode == 0, built.stderr

    return made_once("a folder with spaces", build)


class Page(HTMLParser):
    """The ids and the links of a page."""

    def __init__(self, text):
        super().__init__()
        self.ids, self.links = set(), []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        self.ids.add(found.get("id"))
        self.links += [found[name] for name in ("href", "src") if found.get(name)]


@functools.cache
def parsed(file):
    return Page(file.read_text(encoding="utf-8"))


class Code(HTMLParser):
    """The commands of a page: the lines of its blocks of a shell, and what stands in its text and begins so."""

    def __init__(self, text):
        super().__init__()
        self.commands, self.open, self.text, self.shell = [], "", "", False
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        if tag == "div":
            found = re.match(r"highlight-(\w+)", dict(attributes).get("class") or "")
            self.shell = found[1] in ("bash", "console") if found else self.shell
        if tag in ("pre", "code") and not self.open:
            self.open, self.text = tag, ""

    def handle_data(self, data):
        self.text += data

    def handle_endtag(self, tag):
        if tag != self.open:
            return
        self.open = ""
        lines = self.text.replace("\\\n", "").splitlines() if tag == "code" or self.shell else []
        if any(line.startswith("$ ") for line in lines):  # the others are what the commands print
            lines = [line.removeprefix("$ ") for line in lines if line.startswith("$ ")]
        self.commands += [line.strip() for line in lines if tag == "pre" or re.match(r"python \S+[./]", line)]


# What is a command's form or part of its text, and what only the reader can fill in.
NOT_A_COMMAND = re.compile(r"\.\.\.|<|^#|^[A-Za-z_]+=|^srun")


def shown_commands(site):
    """All commands of the site, by what the shell would read, with a page of each."""
    found: dict[str, str] = {}
    for file in sorted(site.glob("**/*.html")):
        for line in Code(file.read_text(encoding="utf-8")).commands:
            if line and not NOT_A_COMMAND.search(line):
                found.setdefault(line, file.relative_to(site).as_posix())
    return found


@pytest.mark.slow
def test_every_command_that_a_page_shows_can_be_run(site, tmp_path, monkeypatch):
    """Also those that directives make. Campaigns are planned, flags are parsed, programs have what they are called
    with. Only the networks of the paper's opponents, which are not here, are made of ours, as the same pages say how.
    """
    monkeypatch.chdir(tmp_path)
    shown = shown_commands(site)
    assert results_data.OPPONENTS_COMMAND in shown
    (tmp_path / "opponents").mkdir()
    for name in ("adversary", "tag"):
        shutil.copy(ROOT / f"envs/families/opponents/mpe-{name}.npz", tmp_path / f"opponents/paper-{name}.npz")
    wrong = []
    for line, page in shown.items():
        try:
            try_command(line, tmp_path, monkeypatch)
        except (Exception, SystemExit) as error:
            wrong.append(f"{page}: {line}: {error!r}"[:400])
    assert len(shown) > 300 and wrong == [], "\n".join(wrong)


OWN_NAMES = {"mine": "mappo", "mine2": "mappo", "maddpg_ends": "maddpg", "maddpg_epymarl": "maddpg"}  # of copies


def try_command(line, folder, monkeypatch):
    """Raises what speaks against a command."""
    words = shlex.split(line, comments=True)
    own_copies = {"fault1.py": "iql", "fault2.py": "maa2c", "mine.py": "iql", "mappo.py": "mappo"}
    if words[:2] == ["python", "benchmark/run.py"]:
        monkeypatch.setattr(sys, "argv", [OWN_NAMES.get(word, word) for word in words[1:]])
        args = run.parse()
        args.plan = args.plan and ROOT / args.plan
        grid = plan.read_grid(ROOT / args.grid) if args.grid else None
        plan.make_plan(plan.chosen_scripts(args.algorithms), run.seeds_of_rows(args), tuple(args.flags), grid, folder)
    elif words[0] == "python" and words[1] in own_copies:
        test_readme.check_script(own_copies[words[1]], words[2:])
    elif words[:2] == ["python", "tools/paper_run_again.py"]:
        assert words[2] in (ROOT / words[1]).read_text(encoding="utf-8")  # what it prints is compared elsewhere
    elif words[0] == "python" and words[1].startswith(("examples/", "tests/")):
        known = test_readme.help_of(words[1])
        assert all(word.partition("=")[0] in known for word in words[2:] if word.startswith("--"))
    else:
        test_readme.check(words, folder)


@pytest.mark.slow
def test_no_link_and_no_anchor_is_broken(site):
    broken = []
    for file in site.glob("**/*.html"):
        for link in parsed(file).links:
            address = urllib.parse.urlsplit(link)
            if address.scheme:
                assert address.scheme in ("http", "https", "data"), link
                continue
            path = urllib.parse.unquote(address.path)
            target = (file.parent / path).resolve() if path else file
            if not target.exists():
                broken.append((file.name, link))
            elif address.fragment and target.suffix == ".html":
                known = urllib.parse.unquote(address.fragment) in parsed(target).ids
                broken += [] if known else [(file.name, link)]
    assert broken == [], broken[:20]


@pytest.mark.slow
def test_the_terms_of_what_the_numbers_are_stand_out(site):
    text = (site / "how-to" / "what-the-numbers-are.html").read_text(encoding="utf-8")
    assert len(re.findall(r"<p><strong>[A-Z][A-Za-z ]+\.</strong>", text)) >= 10


@pytest.mark.slow
def test_the_map_of_seeds_marks_other_budgets_alone(site):
    """And not the paper's opponents, which are the paper's setting in two tasks."""
    text = (site / "explorer.html").read_text(encoding="utf-8")
    found = re.findall(r'title="(\w+), ([\w-]+), (with sharing|without): seeds [1-9]\d*(, another budget)?"', text)
    words = {"shared": "with sharing", "independent": "without"}
    shown = results_data.report().shown.drop_duplicates(["task", "algorithm", "sharing"])
    expected = [
        (row.algorithm.upper(), row.task, words[row.sharing], ", another budget" if row.other_budget else "")
        for row in shown.itertuples()
        if row.task in PAPER_TASKS
    ]
    assert sorted(found) == sorted(expected) and len({mark for *_, mark in found}) == 2


@pytest.mark.slow
def test_papers_are_links(site):
    """Also where a title begins in one line of the text and ends in the next."""
    for name in NINE:
        links = parsed(site / "algorithms" / f"{name}.html").links
        assert links.count("https://arxiv.org/abs/2006.07869") >= 3, name


@pytest.mark.slow
def test_pages_are_small(site):
    for file in site.glob("**/*.html"):
        own = [link for link in parsed(file).links if link.split("?")[0].endswith((".js", ".css"))]
        parts = [file.parent / link.split("?")[0] for link in own]
        size = file.stat().st_size + sum(part.stat().st_size for part in parts)
        if 'class="chart"' in file.read_text(encoding="utf-8") or file.name == "explorer.html":
            size += (site / "_static" / "vega.js").stat().st_size + (site / "_static" / "chart-kinds.js").stat().st_size
        if file.name == "explorer.html":
            size += max(task.stat().st_size for task in (site / "_static" / "explorer").glob("*.js"))
        assert size < LARGEST_PAGE, (file, size)


@pytest.fixture(scope="module")
def browser():
    """Chromium without a window, which notes errors and requests."""
    if not CHROMIUM or not DRIVER:
        pytest.skip("the browser tests need chromium and chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--window-size=1400,1000"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


def visit(browser, file, query=""):
    """Opens a page of the site; afresh, where only what stands behind # is new."""
    browser.get("about:blank")
    browser.get(file.as_uri() + query)
    return browser


def until(condition, seconds=20):
    """Waits for a condition; returns its value, or what it is after so many seconds."""
    end = time.monotonic() + seconds
    while not (found := condition()) and time.monotonic() < end:
        time.sleep(0.05)
    return found


def complaints(browser):
    """What the console says, and requests that did not stay in the folder."""
    errors = [entry["message"] for entry in browser.get_log("browser")]
    for entry in browser.get_log("performance"):
        message = json.loads(entry["message"])["message"]
        if message["method"] == "Network.requestWillBeSent":
            address = message["params"]["request"]["url"]
            if not address.startswith(("file:", "data:", "blob:")):
                errors.append(f"request: {address}")
    return errors


ALL_DRAWN = """
const figures = [...document.querySelectorAll("figure.chart")];
const next = figures.find((figure) => !figure.querySelector("svg"));
if (next) next.scrollIntoView();
return !next;
"""


@pytest.mark.slow
def test_every_page_loads_without_error_and_without_the_network(site, browser):
    pages = [file for file in sorted(site.glob("**/*.html")) if "_modules" not in file.parts]
    assert len(pages) > 30
    for file in pages:
        visit(browser, file)
        assert until(lambda: browser.execute_script(ALL_DRAWN)), f"charts of {file.name} are not drawn"
        assert complaints(browser) == [], file


@pytest.mark.slow
def test_a_logarithmic_axis_has_labels(site, browser):
    """The divergence of a healthy run is near 0.003, and that of a sick one near 1."""
    visit(browser, site / "algorithms/ippo.html")
    labels = (
        "const charts = [...document.querySelectorAll('figure.chart')];"
        "const chart = charts.find((x) => /approximate_kl/.test(x.textContent));"
        "chart.scrollIntoView();"
        "return [...chart.querySelectorAll('.role-axis-label text')].map((x) => x.textContent)"
    )
    assert until(lambda: {"0", "0.01", "0.1", "1"} <= {*browser.execute_script(labels)})


@pytest.mark.slow
def test_formulas_are_typeset(site, browser):
    for name in script.ALGORITHMS:
        visit(browser, site / "algorithms" / f"{name}.html")
        sizes = browser.execute_script(
            "return [...document.querySelectorAll('.formula math')].map((x) => x.getBoundingClientRect())"
            ".map(({width, height}) => [width, height])"
        )
        assert sizes and all(width > 20 and height > 8 for width, height in sizes)


# What is cut at the right: code that is wider than its block, tables and formulas that are wider than their window and
# do not say so, and lists to choose from that reach beyond the window.
CUT = """
const wide = (x) => x.clientWidth > 0 && x.scrollWidth > x.clientWidth + 1;
const says = (x) => x.closest(".scrolls") && getComputedStyle(x.closest(".scrolls"), "::before").content !== "none";
return [
  ...[...document.querySelectorAll("pre")].filter((x) => wide(x) || wide(x.parentElement)),
  ...[...document.querySelectorAll("table, .formula")].filter((x) => (wide(x) || wide(x.parentElement)) && !says(x)),
  ...[...document.querySelectorAll("select")].filter((x) => x.getBoundingClientRect().right > innerWidth),
].map((x) => x.outerHTML.slice(0, 80));
"""
# The least contrast of code with what is behind it, as WCAG 2 counts it, over all colours of the page's code.
CONTRAST = """
const luminance = (colour) => {
  const [r, g, b] = colour.map((x) => x / 255).map((x) => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const numbers = (text) => text.match(/[\\d.]+/g).map(Number);
const behind = (x) => {
  const [r, g, b, a = 1] = numbers(getComputedStyle(x).backgroundColor);
  return a === 0 ? behind(x.parentElement) : [r, g, b];
};
const found = {};
for (const x of document.querySelectorAll("pre span:not(:has(span)), pre:not(:has(span))")) {
  if (!x.textContent.trim() || x.closest("button")) continue;
  const [front, back] = [numbers(getComputedStyle(x).color).slice(0, 3), behind(x)];
  const [high, low] = [luminance(front), luminance(back)].sort((a, b) => b - a);
  found[`${front} on ${back}`] = (high + 0.05) / (low + 0.05);
}
return found;
"""


@pytest.mark.slow
def test_nothing_is_cut_at_the_right(site, browser):
    """On a telephone and in two windows, of which each page is seen in all: opening it takes the longest."""
    try:
        for file in sorted(site.glob("**/*.html")):
            visit(browser, file)
            page = file.relative_to(site).as_posix()
            browser.execute_script("document.querySelectorAll('details').forEach((x) => { x.open = true; })")
            for width in (390, 1280, 1440):
                size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500}
                browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
                assert until(lambda: browser.execute_script(CUT) == [], 3), (page, width, browser.execute_script(CUT))
                assert browser.execute_script("return document.documentElement.scrollWidth") <= width, (page, width)
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


@pytest.mark.slow
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_code_can_be_read(site, browser, theme):
    feature = {"name": "prefers-color-scheme", "value": theme}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
    try:
        for page in ("algorithms/coma", "how-to/first-steps", "how-to/add-an-environment", "paper-run-again", "about"):
            visit(browser, site / f"{page}.html")
            found = browser.execute_script(CONTRAST)
            assert found and min(found.values()) >= 4.5, (page, found)
    finally:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


@pytest.mark.slow
def test_lines_of_a_folded_function_can_be_reached(site, browser):
    name, number = algorithm_pages.target("n_step_returns: longer = rewards", "mappo")
    visit(browser, site / "algorithms" / f"{name}.html", f"#L-{number}")
    line = browser.find_element("id", f"L-{number}")
    assert "longer = rewards" in line.text and until(line.is_displayed)


@pytest.mark.slow
def test_a_click_in_the_explorer_changes_its_curves(site, browser):
    visit(browser, site / "explorer.html")
    lines = "return [...document.querySelectorAll('#explorer .mark-line path')].map((x) => x.getAttribute('d')).join()"
    before = until(lambda: browser.execute_script(lines))
    assert before
    browser.find_element("css selector", "#explorer input[value=mappo]").click()
    without = until(lambda: (now := browser.execute_script(lines)) and now != before and now)
    assert without and "mappo" not in browser.find_element("id", "explorer").get_attribute("data-shown")
    browser.find_element("css selector", "#explorer input[value=independent]").click()
    assert until(lambda: (now := browser.execute_script(lines)) and now not in (before, without))

    paths = "[...document.querySelectorAll('#explorer .mark-line path')]"
    faint = (
        f"return {paths}.filter((x) => x.getAttribute('opacity') !== null && +x.getAttribute('opacity') < 0.5).length"
    )
    assert browser.execute_script(faint) == 0
    browser.find_element(
        "css selector", "#explorer .role-legend-entry .role-legend-label, #explorer .role-legend-entry text"
    ).click()
    assert until(lambda: browser.execute_script(faint)) > 0
    assert complaints(browser) == []


@pytest.mark.slow
def test_the_explorers_address_is_its_state(site, browser):
    """Also where nothing is ticked, and when only what stands behind # is written anew."""
    visit(browser, site / "explorer.html", "#task=lbf-8x8-2p-2f-c&sharing=independent&axis=steps&algorithms=")
    drawing, note = (browser.find_element("css selector", f"#explorer .{name}") for name in ("drawing", "note"))
    ticked = "return [...document.querySelectorAll('#explorer input:checked')].map((x) => x.value)"
    assert until(lambda: "Nothing to show" in note.text) and not drawing.is_displayed()
    assert browser.execute_script(ticked) == ["independent", "steps"]
    browser.find_element("css selector", "#explorer input[value=maa2c]").click()
    browser.find_element("css selector", "#explorer input[value=ia2c]").click()
    assert browser.current_url.endswith("&algorithms=maa2c,ia2c")
    address = browser.current_url.partition("#")[2]
    visit(browser, site / "explorer.html", f"#{address}")
    assert browser.execute_script(ticked) == ["independent", "steps", "ia2c", "maa2c"]
    note = browser.find_element("css selector", "#explorer .note")
    assert until(lambda: "3M steps: IA2C †, MAA2C †. †: another budget" in note.text), note.text
    browser.execute_script("location.hash = '#task=rware-tiny-4p&sharing=independent'")
    shown = "return document.getElementById('explorer').dataset.shown"
    assert until(lambda: len(browser.execute_script(shown).split()) == 9)
    without = browser.find_element("css selector", "#explorer input[value=independent]")
    assert not without.is_enabled()  # nothing was measured there
    assert browser.execute_script(ticked)[:2] == ["shared", "share"]
    assert complaints(browser) == []


@pytest.mark.slow
def test_a_band_covers_what_the_explorer_says(site, browser):
    visit(browser, site / "explorer.html")
    note = browser.find_element("css selector", "#explorer .note")
    assert until(lambda: "70 % with two seeds, 82 % with three and 88 % with five" in note.text)
    assert [round(100 * (2 * t.cdf(2, seeds - 1) - 1)) for seeds in (2, 3, 5)] == [70, 82, 88]
    ends = (
        "return [...document.querySelectorAll('#explorer .mark-area path')].map((x) => x.getBBox())"
        ".map(({y, height}) => [y, y + height])"
    )
    assert until(lambda: browser.execute_script(ends))
    assert all(top >= -1 and bottom <= 381 for top, bottom in browser.execute_script(ends))  # the chart's height is 380


@pytest.mark.slow
def test_no_return_lies_outside_its_bounds():
    curves = results_data.curves()
    for task in curves["task"].unique():
        low, high = results_data.bounds(task)
        returns = curves.loc[curves["task"] == task, "mean"]
        assert (low is None or returns.min() >= low) and (high is None or returns.max() <= high + 1e-6), task


@pytest.mark.slow
def test_each_number_has_an_address(site, browser):
    names = re.findall(r'<td id="([^"]+)"', (site / "tables.html").read_text(encoding="utf-8"))
    assert len(names) == len(set(names)) > 500
    visit(browser, site / "tables.html", "#mpe-tag-qmix-shared-average")
    cell = browser.find_element("css selector", "td:target")
    seen = (
        "const {top, left} = arguments[0].getBoundingClientRect(); "
        "return 0 < top && top < innerHeight && 0 < left && left < innerWidth"
    )
    assert until(lambda: browser.execute_script(seen, cell))
    assert "mpe-tag, the paper's prey" in cell.find_element("xpath", "..").text
    browser.execute_script("arguments[0].click()", cell.find_element("css selector", "button"))
    behind = cell.find_element("css selector", "[popover]")
    first, second = behind.find_elements("css selector", "code")
    assert first.text == results_data.OPPONENTS_COMMAND and "opponents/paper-tag.npz" in second.text
    link = behind.find_elements("css selector", "a")[-1].get_attribute("href")
    assert link.endswith("tables.html#mpe-tag-qmix-shared-average")


@pytest.mark.slow
def test_curves_against_the_share_of_the_training(site, browser):
    visit(browser, site / "explorer.html", "#task=lbf-8x8-2p-2f-c")
    ends = (
        "return [...document.querySelectorAll('#explorer .mark-line path')].map((x) => "
        "Math.round(x.getBBox().x + x.getBBox().width))"
    )
    assert until(lambda: len(set(browser.execute_script(ends))) == 1)
    browser.find_element("css selector", "#explorer input[value=steps]").click()
    assert until(lambda: len(set(browser.execute_script(ends))) > 1)  # off-policy curves end earlier
    assert "axis=steps" in browser.current_url


@pytest.mark.slow
def test_the_command_behind_a_number(site, browser):
    visit(browser, site / "tables.html")
    cell = browser.find_element("id", "lbf-8x8-2p-2f-c-mappo-shared")
    behind = cell.find_element("css selector", "[popover]")
    assert not behind.is_displayed()
    browser.execute_script("arguments[0].click()", cell.find_element("css selector", "button"))
    assert behind.is_displayed()
    assert "run.py --algorithms mappo --tasks lbf-8x8-2p-2f-c" in behind.text and "JSON" in behind.text


@pytest.mark.slow
def test_tables_are_sorted_by_a_click(site, browser):
    visit(browser, site / "tables.html")
    table = browser.find_element("css selector", "table.results")
    table.find_elements("css selector", "th button")[1].click()
    column = (
        "return [...arguments[0].tBodies[0].rows].map((row) => row.cells[1].dataset.value).filter(Boolean).map(Number)"
    )
    values = browser.execute_script(column, table)
    assert len(values) > 3 and values == sorted(values, reverse=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    "words, page",
    {
        "GPU": "how-to/first-steps",
        "CTDE": "marl",
        "Dec-POMDP": "marl",
        "wandb": "how-to/first-steps",
        "cite": "about",
        "license": "about",
        "save model": "how-to/",
        "custom environment": "how-to/",
        "load": "how-to/evaluate-and-film-a-team",
        "parameter sharing": "marl",
        "glossary": "marl",
    }.items(),
)
def test_search_finds(site, browser, words, page):
    """The page is among the first three that are found."""
    visit(browser, site / "search.html", f"?q={urllib.parse.quote(words)}")
    done = "return document.querySelector('#search-results .search-summary')?.textContent ?? ''"
    assert until(lambda: "found" in browser.execute_script(done) or "match" in browser.execute_script(done))
    found = [link.get_attribute("href") for link in browser.find_elements("css selector", "#search-results li a")]
    assert any(f"/{page}" in link for link in found[:3]), found[:5]
    assert complaints(browser) == []


@pytest.mark.slow
def test_the_repository_is_linked_where_its_address_is_known(monkeypatch, tmp_path):
    """At any server. conf.py takes it from REPOSITORY_URL; without it no address is invented."""
    (tmp_path / "index.md").write_text("# A page\n\n```bash\ngit clone REPOSITORY_URL\n```\n", encoding="utf-8")
    address, links = "https://git.example.org/us/marl-baselines", {}
    for known in (address + "/", ""):
        monkeypatch.setenv("REPOSITORY_URL", known)
        command = [sys.executable, "-m", "sphinx", "-W", "-q", "-E", "-c", str(DOCS)]
        command += ["-D", "extensions=myst_parser,mathml", str(tmp_path), str(tmp_path / "site")]
        built = subprocess.run(command, capture_output=True, text=True)
        assert built.returncode == 0, built.stderr
        page = (tmp_path / "site" / "index.html").read_text(encoding="utf-8")
        links[known] = set(re.findall(r'href="(https://[^"]*marl-baselines[^"]*)"', page))
        assert ("REPOSITORY_URL" in page) != bool(known)
    assert links.pop("") == set()
    [found] = links.values()
    assert found == {address, f"{address}/blob/main/docs/index.md", f"{address}/edit/main/docs/index.md"}


def test_what_is_published_has_no_pickles_of_sphinx():
    """They would be in the site's folder, if -d did not name another."""
    workflow = (ROOT / ".github/workflows/pages.yml").read_text(encoding="utf-8")
    assert re.findall("sphinx-build (.*)", workflow) == ["-W --keep-going -d build/doctrees docs site"]

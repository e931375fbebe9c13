"""What the scripts have in common: names and texts, order, length, the paper's hyperparameters, help."""

import ast
import collections
import csv
import dataclasses
import re
import sys

import pytest
from scripts import INDIVIDUAL, NAMES, NINE, ON_POLICY, ROOT, VALUE_BASED, parse, script

from benchmark import hyperparameters
from envs import InputError
from envs.runs import Flags

MAY_DIFFER = {"Args", "update", "train"}
# Two texts each: policies draw and values choose; and some algorithms learn from agents' own rewards, others only from
# the team's.
OF_TWO_KINDS = {"Team": VALUE_BASED, "Batch": INDIVIDUAL, "new_storage": INDIVIDUAL, "collect": INDIVIDUAL}
SECTIONS = ["networks", "maths", "experience", "update", "train", "load"]
TASK_OF_FAMILY = {
    "matrix": "matrix-climbing",
    "mpe": "mpe-spread",
    "smac": "smaclite-3s5z-sc2-v2",
    "lbf": "lbf-15x15-3p-5f",
    "rware": "rware-tiny-4p",
}
BUDGET = {"matrix": 2_500_000, "mpe": 20_000_000, "smac": 40_000_000, "lbf": 20_000_000, "rware": 40_000_000}


def source(name):
    return (ROOT / "algos" / f"{name}.py").read_text()


def test_same_name_same_text():
    texts: dict[str, dict[str, list[str]]] = collections.defaultdict(lambda: collections.defaultdict(list))
    for name in NAMES:
        text = source(name)
        for node in ast.parse(text).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name not in MAY_DIFFER:
                decorators = "".join(ast.unparse(decorator) for decorator in node.decorator_list)
                kind = f" {name in OF_TWO_KINDS[node.name]}" if node.name in OF_TWO_KINDS else ""
                texts[node.name + kind][decorators + (ast.get_source_segment(text, node) or "")].append(name)
    different = {name: list(variants.values()) for name, variants in texts.items() if len(variants) > 1}
    assert not different


def test_one_order_and_the_same_end():
    ends = set()
    for name in NAMES:
        text = source(name)
        assert re.findall("^# --- (.*) ---$", text, flags=re.MULTILINE) == SECTIONS
        update, train = text.split("# --- train ---")
        assert "def paper_defaults(" in update.split("# --- networks ---")[0] and "def train(" in train
        ends.add(text.split("# --- load ---")[1])
    assert len(ends) == 1


@pytest.mark.parametrize("name", NAMES)
def test_length(name):
    lines, most = source(name).splitlines(), 405 if name == "mappo" else 430
    assert len(lines) <= most, f"algos/{name}.py has more than {most} lines"
    longer = [number for number, line in enumerate(lines, 1) if len(line) > 100]
    assert not longer, f"algos/{name}.py has lines of more than 100 characters: {longer}"


@pytest.mark.parametrize("name", NAMES)
def test_what_comes_with_a_script(name):
    """Its page, which the first line names, and a docstring."""
    page = f"docs/algorithms/{name}.md"
    assert source(name).startswith(f"# {page} "), f"the first line of algos/{name}.py must name its page, {page}"
    assert (ROOT / page).exists(), f"algos/{name}.py has no page; write {page}"
    doc = script(name).__doc__ or ""
    title = f"{name.upper()}: "
    assert doc.startswith(title), f"the docstring of algos/{name}.py must begin with '{title}' and what that means"
    assert re.search("^    .* = ", doc, re.MULTILINE), f"the docstring of algos/{name}.py has no formula"
    run_it = f"python algos/{name}.py --env "
    assert run_it in doc, f"the docstring of algos/{name}.py does not say how to run it: '{run_it}...'"


@pytest.mark.parametrize("name", NINE)
def test_what_to_expect_is_what_a_reference_run_had(name):
    """Of seed 0, in benchmark/results."""
    head = source(name).split('"""')[0].replace("\n# ", " ")
    task, figure, millions, minutes = re.findall(
        r"With seed 0, (\S+) ends at a return of (\S+) \(the most is 1\) after (\d+) million steps and (\d+) minutes",
        head,
    )[0]
    assert f"python algos/{name}.py --env {task}\n" in str(script(name).__doc__)
    with open(ROOT / "benchmark" / "results" / task / f"{name}-shared.csv") as file:
        last = [row for row in csv.DictReader(file) if row["seed"] == "0"][-1]
    assert f"{float(last['return_mean']):.2f}" == figure
    assert round(int(last["timestep"]) / 1e6) == int(millions)
    assert round(float(last["cpu_seconds"]) / 60) == int(minutes)


@pytest.mark.parametrize("name", NAMES)
def test_scripts_import_no_script(name):
    nodes = list(ast.walk(ast.parse(source(name))))
    imported = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    imported |= {str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)}
    assert not imported & {"algos", "benchmark", *NAMES}


@pytest.mark.parametrize("name", NINE)
@pytest.mark.parametrize("family", TASK_OF_FAMILY)
@pytest.mark.parametrize("sharing", [True, False])
def test_defaults_are_the_papers(name, family, sharing):
    args = vars(parse(name, ["--env", TASK_OF_FAMILY[family], f"--{'' if sharing else 'no-'}parameter-sharing"]))
    searched = hyperparameters.searched(name, family, sharing)
    assert searched.keys() == {*script(name).TUNED.split()}
    budget = BUDGET[family]
    expected = searched | {
        "total_timesteps": budget if name in ON_POLICY else budget // 10,
        "time_limit": "bootstrap" if name in ON_POLICY else "terminal",
        "eval_points": 101 if family == "matrix" else 41,
    }
    assert {flag: args[flag] for flag in expected} == expected


@pytest.mark.parametrize("name", NINE)
def test_all_hyperparameters_are_held_against_the_papers(name):
    """Which flags decide what is learned, and that the tables of benchmark/paper have all of these."""
    held = hyperparameters.fixed(name).keys() | hyperparameters.searched(name, "lbf", True).keys()
    others = {field.name for field in dataclasses.fields(Flags)} - {"eval_episodes"}
    assert held == vars(parse(name, [])).keys() - others - {"env", "seed", "parameter_sharing", "total_timesteps"}


@pytest.mark.parametrize("name", NINE)
def test_a_family_that_the_paper_does_not_have(name):
    """Such a task begins with the same values in all scripts, none of them from the table of another family."""
    args = script(name).paper_defaults("own:examples.meeting_numpy")
    assert (args.hidden_dim, args.learning_rate, args.network) == (128, 0.0005, "fc")
    assert (args.reward_standardisation, args.target_update) == (False, "soft")


@pytest.mark.parametrize("name", sorted(set(NAMES) - set(INDIVIDUAL)))
def test_what_learns_from_the_team_has_no_flag_for_individual_rewards(name):
    with pytest.raises(InputError, match="Unrecognized options: --individual-rewards"):
        parse(name, ["--individual-rewards"])
    assert "individual_rewards" not in vars(parse(name, []))


@pytest.mark.parametrize(
    "spelling",
    [
        ["--env", "matrix-climbing", "--no-parameter-sharing"],
        ["--env=matrix-climbing", "--no_parameter_sharing"],
        ["--no-parameter-sharing", "--env", "matrix-climbing"],
    ],
)
def test_every_spelling_of_the_deciding_flags_is_found(spelling):
    args = parse("mappo", [*spelling, "--hidden-dim", "7"])
    assert (args.env, args.parameter_sharing, args.total_timesteps) == ("matrix-climbing", False, 2_500_000)
    assert args.hidden_dim == 7 and args.reward_standardisation is True


@pytest.mark.parametrize("name", NAMES)
def test_help_shows_the_docstring_and_the_values_for_the_chosen_task(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr(sys, "argv", [f"algos/{name}.py"])  # which the line of usage shows
    with pytest.raises(SystemExit) as end:
        parse(name, ["--env", "matrix-climbing", "--help"])
    assert not end.value.code
    text = capsys.readouterr().out
    defaults = vars(script(name).paper_defaults("matrix-climbing"))
    places = [text.index(f"--{flag} ") for flag in ("env", "hidden-dim", "learning-rate", "eval-points", "env-kwargs")]
    assert places == sorted(places)  # task, network and learning before what all scripts share
    assert f"(default: {defaults['total_timesteps']})" in re.sub(r"[\s│]+", " ", text)
    for flag in defaults:
        assert f"--{flag.replace('_', '-')}" in text
    formulas = {line for line in (script(name).__doc__ or "").splitlines() if line.startswith("    ")}
    assert formulas <= set(text.splitlines())
    assert max(len(line) for line in text.splitlines() if line not in formulas) <= 80

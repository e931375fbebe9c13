"""What the scripts have in common: names and texts, length, the paper's hyperparameters, help."""

import ast
import collections
import csv

import pytest
from scripts import NAMES, ON_POLICY, ROOT, script

MAY_DIFFER = {"Args", "PAPER", "update", "train", "main"}
FLAGS = {
    "hidden_dimension": "hidden_dim",
    "learning_rate": "learning_rate",
    "reward_standardisation": "reward_standardisation",
    "network_type": "network",
    "entropy_coefficient": "entropy_coef",
    "target_update": "target_update",
    "n-step": "n_step",
    "evaluation_epsilon": "eval_epsilon",
    "epsilon_anneal": "epsilon_anneal",
    "actor_regularisation": "actor_regularisation",
}
TASK_OF_FAMILY = {"matrix": "matrix-climbing", "lbf": "lbf-15x15-3p-5f"}


def source(name):
    return (ROOT / "algos" / f"{name}.py").read_text()


def test_same_name_same_text():
    texts: dict[str, dict[str, list[str]]] = collections.defaultdict(lambda: collections.defaultdict(list))
    for name in NAMES:
        text = source(name)
        for node in ast.parse(text).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name not in MAY_DIFFER:
                decorators = "".join(ast.unparse(decorator) for decorator in node.decorator_list)
                texts[node.name][decorators + (ast.get_source_segment(text, node) or "")].append(name)
    different = {name: list(variants.values()) for name, variants in texts.items() if len(variants) > 1}
    assert not different


def test_the_run_is_the_same_text_to_the_letter():
    """From `--- the run` to the end, constants and comments too, but for `train`."""

    def plumbing(name):
        text = source(name)
        node = next(node for node in ast.parse(text).body if getattr(node, "name", "") == "train")
        text = text.replace(ast.get_source_segment(text, node) or "", "")
        return text[text.index("# --- the run") :]

    assert len({plumbing(name) for name in NAMES}) == 1


@pytest.mark.parametrize("name", NAMES)
def test_length(name):
    lines = source(name).splitlines()
    assert len(lines) <= 500
    assert lines.index("# --- evaluation ---") <= 320  # what teaches stands above


@pytest.mark.parametrize("name", NAMES)
def test_scripts_import_no_script(name):
    nodes = list(ast.walk(ast.parse(source(name))))
    imported = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    imported |= {str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)}
    assert not imported & {"algos", "benchmark", *NAMES}


def paper_rows(name):
    with open(ROOT / "benchmark" / "paper" / "hyperparameters.csv") as file:
        return [row for row in csv.DictReader(file) if row["algorithm"] == name]


def as_flag(name, value):
    """A value of the paper's table as the scripts write it."""
    if name == "reward_standardisation":
        return {"True": "batch", "False": "none"}[value]
    if name == "network_type":
        return value.lower()
    if name == "target_update":
        return {"200 (hard)": "hard", "0.01 (soft)": "soft"}[value]
    return float(value)


@pytest.mark.parametrize("name", NAMES)
def test_hyperparameters_are_the_papers(name):
    module, rows, seen = script(name), paper_rows(name), set()
    for row in rows:
        column = module.PAPER_ARGS.index(FLAGS[row["name"]])
        values = module.PAPER[row["family"]][row["parameter_sharing"] == "no"]
        assert values[column] == as_flag(row["name"], row["value"]), row
        seen.add((row["family"], row["parameter_sharing"], column))
    assert len(seen) == len(rows) == 10 * len(module.PAPER_ARGS)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("family", TASK_OF_FAMILY)
@pytest.mark.parametrize("sharing", [True, False])
def test_defaults_are_the_papers(name, family, sharing):
    args = vars(script(name).parse(["--env", TASK_OF_FAMILY[family], f"--{'' if sharing else 'no-'}parameter-sharing"]))
    for row in paper_rows(name):
        if row["family"] == family and (row["parameter_sharing"] == "yes") == sharing:
            assert args[FLAGS[row["name"]]] == as_flag(row["name"], row["value"])
    budget = {"matrix": 2_500_000, "lbf": 20_000_000}[family]
    assert args["total_timesteps"] == (budget if name in ON_POLICY else budget // 10)
    assert args["time_limit"] == ("bootstrap" if name in ON_POLICY else "terminal")
    assert args["eval_points"] == {"matrix": 101, "lbf": 41}[family]


@pytest.mark.parametrize(
    "spelling",
    [
        ["--env", "matrix-climbing", "--no-parameter-sharing"],
        ["--env=matrix-climbing", "--no_parameter_sharing"],
        ["--no-parameter-sharing", "--env", "matrix-climbing"],
    ],
)
def test_every_spelling_of_the_deciding_flags_is_found(spelling):
    args = script("mappo").parse([*spelling, "--hidden-dim", "7"])
    assert (args.env, args.parameter_sharing, args.total_timesteps) == ("matrix-climbing", False, 2_500_000)
    assert args.hidden_dim == 7 and args.reward_standardisation == "batch"


@pytest.mark.parametrize("name", NAMES)
def test_help_shows_the_values_for_the_chosen_task(name, capsys):
    with pytest.raises(SystemExit) as end:
        script(name).parse(["--env", "matrix-climbing", "--help"])
    assert end.value.code == 0
    text = capsys.readouterr().out
    budget = script(name).paper_defaults("matrix-climbing").total_timesteps
    assert f"(default: {budget})" in " ".join(text.replace("│", " ").split())
    for flag in vars(script(name).paper_defaults()):
        assert f"--{flag.replace('_', '-')}" in text

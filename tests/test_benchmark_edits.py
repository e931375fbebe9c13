"""Edits of the nine scripts do not pass for the paper's results; scripts of one's own run from anywhere."""

import re
import shutil
import sys

import pytest
from scripts import NINE, ROOT, parse

from benchmark import collect, hyperparameters, plan, run, store


@pytest.fixture
def dry_run(monkeypatch, capsys, tmp_path):
    """run.py --dry-run with the scripts of a folder; gives the exit code and what it says."""
    folder = tmp_path / "algos"
    shutil.copytree(ROOT / "algos", folder, ignore=shutil.ignore_patterns("__pycache__"))
    for name in NINE:
        monkeypatch.setitem(sys.modules, name, None)  # so that afterwards all is as it was
    monkeypatch.setattr(plan, "ALGOS", folder)
    monkeypatch.chdir(tmp_path)

    def here(*words, task="lbf-8x8-2p-2f-c"):
        plan.script.cache_clear()
        command = ["run.py", "--tasks", task, "--seeds", "1", "--results", str(ROOT / "benchmark" / "results")]
        monkeypatch.setattr(sys, "argv", [*command, "--dry-run", "--algorithms", *words])
        with pytest.raises(SystemExit) as end:
            run.main()
        said = capsys.readouterr()
        return end.value.code, said.out + said.err

    yield here
    plan.script.cache_clear()


def edit(path, pattern, text):
    new, found = re.subn(f"(?m){pattern}", text, path.read_text())
    assert found == 1
    path.write_text(new)


@pytest.mark.parametrize(
    "pattern, text, named",
    [
        (
            r'^    \("lbf", "shared"\): +\(128, 0.0003',
            '    ("lbf", "shared"): (128, 0.9',
            "learning_rate 0.9, not 0.0003",
        ),
        ("hidden_dim: int  #", "hidden_dim: int = 512  #", "hidden_dim 512, not 128"),
        ("gamma: float = 0.99", "gamma: float = 0.9", "gamma 0.9, not 0.99"),
        ("num_envs: int = 10", "num_envs: int = 5", "num_envs 5, not 10"),
        ("total_timesteps: int  #", "total_timesteps: int = 500  #", "total_timesteps 500, not 20000000"),
    ],
)
def test_an_edited_value_is_named(dry_run, tmp_path, pattern, text, named):
    edit(tmp_path / "algos" / "mappo.py", pattern, text)
    code, said = dry_run("mappo")
    named = named.replace("not", "where the paper has")
    assert code == 2 and f"mappo on lbf-8x8-2p-2f-c has {named}. Give the value on the command line" in said
    assert said.count("\n") == 1


def test_values_of_the_command_line_and_scripts_of_another_name_are_free(dry_run, tmp_path):
    assert dry_run("mappo")[0] == 0 and dry_run("mappo", "--", "--learning-rate", "0.9")[0] == 0
    shutil.copy(tmp_path / "algos" / "mappo.py", tmp_path / "algos" / "mine.py")
    edit(tmp_path / "algos" / "mine.py", "gamma: float = 0.99", "gamma: float = 0.9")
    code, said = dry_run("mine")
    assert code == 0 and "mine-shared seed 0: new" in said


@pytest.mark.parametrize("name", NINE)
def test_no_table_but_the_paper_s_is_asked_elsewhere(name):
    """A task of a family that the paper lacks has our own values, and still the budget and what is the same for all."""
    args = parse(name, ["--env", "gymnasium:CartPole-v1"])
    hyperparameters.check(name, vars(args), {})
    args.gamma = 0.5
    with pytest.raises(ValueError, match=r"gamma 0.5, where the paper has 0\.99"):
        hyperparameters.check(name, vars(args), {})


def test_collecting_refuses_it_too(tmp_path, monkeypatch, capsys):
    directory = tmp_path / "seed0"
    flags = vars(parse("mappo", ["--env", "matrix-climbing"]))

    def write(changed, **values):
        directory.mkdir(exist_ok=True)
        config = {"algorithm": "mappo", "flags": flags | values, "changed": changed, "seed": 0}
        config["paper_timesteps"] = 2_500_000
        (directory / "config.json").write_text(store.json.dumps(config))
        rows = [f"{k},{k * 25_000},0.5,0.5,{k},0.0,25.0" for k in range(101)]
        (directory / "evaluations.csv").write_text("\n".join([",".join(store.COLUMNS), *rows]) + "\n")

    write({}, entropy_coef=0.5)
    monkeypatch.setattr(sys, "argv", ["collect.py", str(directory), "--results", str(tmp_path / "results")])
    with pytest.raises(SystemExit) as end:
        collect.main()
    said = capsys.readouterr()
    assert end.value.code and "entropy_coef 0.5, where the paper has 0.001" in said.out + said.err
    assert not list((tmp_path / "results").glob("*/*"))
    write({"entropy_coef": 0.5}, entropy_coef=0.5)
    store.collect(directory, tmp_path / "results")
    write({})
    store.collect(directory, tmp_path / "results")
    assert len(list((tmp_path / "results").glob("*/*.json"))) == 2


class TestPaths:
    def test_a_script_elsewhere(self, dry_run, tmp_path):
        (tmp_path / "elsewhere").mkdir()
        mine = tmp_path / "elsewhere" / "mine.py"
        shutil.copy(tmp_path / "algos" / "iql.py", mine)
        code, said = dry_run("elsewhere/mine.py", "iql")
        assert code == 0 and "mine-shared seed 0: new" in said and "iql-shared seed 0: in the results" in said

    @pytest.mark.parametrize(
        "word, named",
        [
            ("elsewhere/iql.py", "algos/ has a iql.py, so the script needs another name"),
            ("mapo", "neither one of coma, ia2c"),
            ("elsewhere/none.py", "neither one of coma, ia2c"),
        ],
    )
    def test_what_cannot_be(self, dry_run, tmp_path, word, named):
        (tmp_path / "elsewhere").mkdir()
        shutil.copy(tmp_path / "algos" / "iql.py", tmp_path / "elsewhere" / "iql.py")
        code, said = dry_run(word)
        assert code == 2 and named in said

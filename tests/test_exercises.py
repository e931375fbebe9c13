"""The exercises: wrong files are found by their check, in words, and the solutions do what the pages say."""

import re
import shlex
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import programs
import pytest
from scripts import ROOT, load_module

check_exercise = load_module(ROOT / "examples/check_exercise.py")
plant_fault = load_module(ROOT / "examples/plant_fault.py")
recordings = load_module(ROOT / "tools/recordings.py")


@pytest.fixture
def checked(monkeypatch, capsys):
    """checked(algorithm, path, ...): the exit code of check_exercise.py and what it says."""

    def here(algorithm, path, *more):
        monkeypatch.setattr(sys, "argv", ["check_exercise.py", algorithm, str(path), *more])
        monkeypatch.setitem(sys.modules, path.stem, None)  # so that afterwards all is as it was
        code: Any = 0
        try:
            check_exercise.main()
        except SystemExit as end:
            code = end.code
        said = capsys.readouterr()
        return code, said.out + said.err

    return here


def changed(path, algorithm, *replacements):
    """A script with other text in some places, each of which it has once."""
    text = (ROOT / "algos" / f"{algorithm}.py").read_text(encoding="utf-8")
    for right, wrong in replacements:
        assert text.count(right) == 1
        text = text.replace(right, wrong)
    path.write_text(text, encoding="utf-8")
    return path


FOUND = {
    1: "fc_shared, update 1 of 5: `loss/value` is ",
    2: "collect: `no_bootstrap` of two episodes is not as it should be.",
    3: "fc_shared, update 1 of 5: after it, the weights are off by up to ",
}


@pytest.mark.parametrize("number", FOUND)
def test_each_planted_fault_is_found(checked, tmp_path, monkeypatch, number):
    fault = plant_fault.FAULTS[number - 1]
    path = tmp_path / "faulty.py"
    monkeypatch.setattr(sys, "argv", ["plant_fault.py", str(number), str(path)])
    plant_fault.main()
    original = ROOT / "algos" / f"{fault['script']}.py"
    assert path.read_text() == changed(tmp_path / "x.py", fault["script"], (fault["right"], fault["wrong"])).read_text()
    monkeypatch.setattr(check_exercise, "wrong_in_training", lambda path: None)  # which takes a while
    assert checked(fault["script"], original)[0] == 0
    code, said = checked(fault["script"], path)
    assert code == 1 and said.startswith(FOUND[number])
    assert number != 3 or "in the agents' target networks" in said
    assert said.endswith("(--hint 1 says where to look.)\n")
    first, second = (checked(fault["script"], path, "--hint", level)[1] for level in "12")
    assert len(said) - 35 < len(first) < len(second) and second.startswith(first.rstrip())
    with pytest.raises(SystemExit, match="2"):  # it exists now
        plant_fault.main()


def test_what_differs_first_is_said(checked, tmp_path, monkeypatch):
    path = tmp_path / "mine.py"
    unclipped = "torch.minimum(ratios * advantages, clipped * advantages)", "ratios * advantages"
    code, said = checked("mappo", changed(path, "mappo", unclipped))
    assert code == 1 and "`loss/actor` is" in said
    code, said = checked("iql", changed(path, "iql", ("    optimiser.step()\n", "    optimiser.step()\n" * 2)))
    assert code == 1 and "the weights are off by up to" in said
    code, said = checked("iql", changed(path, "iql", ("* played.unsqueeze(-1)).sum()", ").mean()")))
    assert code == 1 and "`loss/value` is" in said
    code, said = checked("iql", changed(path, "iql", ("ended = terminated | truncated", "ended = terminated")))
    assert code == 1 and "stops: IndexError" in said
    summed = "unsqueeze(-1)).squeeze(-1)  # [time, env, agent]", "unsqueeze(-1)).squeeze(-1).sum(-1)"
    code, said = checked("vdn", changed(path, "iql", summed))
    line = "`loss = played_mean((targets - values).square(), played)`"
    assert code == 1 and f"({line}), stops: two tensors do not fit, since one has 3 and the other 5 entries" in said
    assert "(fc_shared has 8 steps of 5 episodes with 3 agents" in said and said.endswith("says where to look.)\n")
    monkeypatch.chdir(tmp_path)  # the page's commands have a file here
    assert checked("vdn", Path("mine.py"))[1] == said.replace(str(path), "mine.py")
    code, said = checked("iql", changed(path, "iql", ("(targets - values)", "(targets - values.detach())")))
    assert code == 1 and "stops: the loss does not depend on the network that should learn." in said
    side_by_side = "critic_inputs = batch.observations", "critic_inputs = batch.observations.flatten(2).unsqueeze(2)"
    code, said = checked("maa2c", changed(path, "ia2c", side_by_side))
    assert code == 1 and "a network that was built for 6 inputs is given 21 (gru_shared has " in said
    assert "(`target_values = target_critic(critic_inputs)[0]" in said and "a state of 6, with values of its" in said
    code, said = checked("qmix", ROOT / "algos/vdn.py")
    assert code == 1 and said == f"{ROOT / 'algos/vdn.py'} has no `Mixer`, which this check uses.\n"
    code, said = checked("qmix", tmp_path / "nothing.py")
    assert code == 2 and said == f"check_exercise: {tmp_path / 'nothing.py'} is no Python file.\n"


@pytest.mark.slow
def test_the_whole_script_is_tried(checked, tmp_path):
    """Updates that are right, with a critic that `train` builds for an agent's observation."""
    state = "critic_inputs = batch.observations", "critic_inputs = batch.states.unsqueeze(2)"
    path = changed(tmp_path / "mine.py", "ia2c", state)
    code, said = checked("maa2c", path, "--hint", "2")
    assert code == 1 and "a network that was built for 9 inputs is given 18" in said and "`train`" in said


def test_estimates_by_hand(checked, tmp_path, monkeypatch):
    monkeypatch.setattr(check_exercise, "wrong_in_training", lambda path: None)
    text = (ROOT / "examples/mappo_yu.py").read_text(encoding="utf-8")
    path = tmp_path / "mine.py"
    for right, wrong, told in (
        ("", "", "gae is right, and it trains"),
        (".masked_fill(no_bootstrap.unsqueeze(-1), 0.0)", "", "gae: after a real end the advantages are [0.515625,"),
        ("errors[t] + gamma * lam *", "errors[t] + gamma *", "gae: after a time-out the advantages are [-2.25,"),
        ("rewards + gamma * next_values", "rewards + lam * next_values", "gae: after a time-out the advantages are "),
        (".masked_fill(~played.unsqueeze(-1), 0.0)", "", "gae: after a time-out one step earlier the advantages are "),
        ("return advantages[:-1]", "return advantages[:-1].mean(-1, keepdim=True)", "gae: its shape is [3, 3, 1]"),
        ("    return advantages[:-1]\n", "    return advantages\n", "gae: its shape is [4, 3, 2]"),
    ):
        assert right == "" or text.count(right) == 1
        path.write_text(text.replace(right, wrong) if right else text, encoding="utf-8")
        code, said = checked("mappo_yu", path)
        assert code == (0 if right == "" else 1) and told in said, said


# --- the page ---
PAGE = (ROOT / "docs/exercises/index.md").read_text(encoding="utf-8")


def task(number):
    """A task's text, its solution included."""
    return re.split(r"(?m)^## \d+\. ", PAGE)[number]


def blocks(number, language):
    return re.findall(rf"(?ms)^```{language}\n(.*?)^```", task(number))


def run(words, folder):
    """What a command says that must succeed."""
    words = [sys.executable if word == "python" else word for word in words]
    done = programs.run(words, cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_there_are_ten_tasks_with_all_that_belongs_to_them():
    assert len(re.findall(r"(?m)^## \d+\. ", PAGE)) == 10
    for number in range(1, 11):
        assert all(task(number).count(part) == 1 for part in ("*Book: ", "**Hand in**", "**Check", "<summary>"))


def commands(number):
    """The commands of a task, as lists of words."""
    return [shlex.split(line) for line in "".join(blocks(number, "bash")).replace("\\\n", "").splitlines()]


def at_the_end(folder, figure):
    """A run's last return, or the mean of another figure over the last tenth of the training."""
    if figure == "return":
        return pd.read_csv(folder / "evaluations.csv")["return_mean"].iloc[-1]
    points = [(step, value) for tag, step, value in recordings.scalars(folder) if tag == figure.strip("`")]
    return pd.Series([value for step, value in points if step > 0.9 * points[-1][0]]).mean()


@pytest.mark.nightly
@pytest.mark.parametrize("number", range(1, 1 + len(plant_fault.FAULTS)))
def test_curves_show_each_planted_fault(tmp_path, number):
    """By one seed of each. The task has three."""
    trainings = {words[1]: words for words in commands(3) if words[1].startswith("fault")}
    trainings["fault3.py"] = trainings["fault1.py"]
    script = tmp_path / f"fault{number}.py"
    script.write_text(plant_fault.faulty(number), encoding="utf-8")
    sound = ROOT / "algos" / f"{plant_fault.FAULTS[number - 1]['script']}.py"
    for path, name in (sound, "sound"), (script, "faulty"):
        words = ["python", str(path), *trainings[script.name][2:], "--seed", "0"]
        run([*words, "--run-dir", str(tmp_path / name)], ROOT)
    rows = re.findall(rf"(?m)^\| {number} \| (\S+) \| (.*) \| (.*) \|$", task(3))
    assert len(rows) == 2
    for figure, *told in rows:
        right, faulty = (pd.Series(map(float, numbers.split(", "))) for numbers in told)
        assert len(right) == len(faulty) == 3
        if (number, figure) != (2, "return"):  # which the fault does not change
            apart = abs(right.mean() - faulty.mean())
            assert apart > 5 * max(right.std(), faulty.std())
            assert abs(at_the_end(tmp_path / "sound", figure) - right.mean()) < 0.2 * apart
            assert abs(at_the_end(tmp_path / "faulty", figure) - faulty.mean()) < 0.2 * apart


@pytest.mark.slow
@pytest.mark.parametrize("number, original, algorithm", [(1, "iql", "vdn"), (2, "ia2c", "maa2c")])
def test_a_diff_makes_another_algorithm(checked, tmp_path, number, original, algorithm):
    replacements = []
    for diff in blocks(number, "diff"):
        lines = diff.splitlines(keepends=True)
        old, new = ("".join(line[1:] for line in lines if line[0] != sign) for sign in "+-")
        replacements.append((old, new))
    path = changed(tmp_path / "mine.py", original)
    code, said = checked(algorithm, path)
    assert code == 1 and (number != 1 or "`loss/value` is" in said)
    assert checked(algorithm, changed(path, original, *replacements)) == (
        0,
        f"{path}: collect is right, 5 updates in 4 cases are those of EPyMARL's {algorithm.upper()}, and it trains.\n",
    )


@pytest.mark.slow
def test_the_baseline_changes_the_variance_alone():
    [program] = blocks(4, "python")
    said = run(["python", "-c", program], ROOT)
    (mean, before), (same_mean, after) = re.findall("mean (.*), variance (.*)", said)
    assert mean == same_mean
    assert f"falls from {before} to {after}." in " ".join(task(4).split())


@pytest.mark.slow
def test_what_grows_with_the_number_of_agents():
    [program] = blocks(5, "python")
    found = re.findall(
        r"(\d+) agents: (\d+) joint actions, parameters (\d+) shared, (\d+) not", run(["python", "-c", program], ROOT)
    )
    n, joint, shared, separate = zip(*(map(int, line) for line in found))
    assert n == (2, 3, 4) and joint == (36, 216, 1296)
    assert shared[2] < 1.05 * shared[0] and separate[2] > 1.9 * separate[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "name, expected",
    [("qmix", 8), *(pytest.param(name, 7, marks=pytest.mark.nightly) for name in ("vdn", "iql"))],
)
def test_qmix_solves_the_two_step_game(tmp_path, name, expected):
    words = commands(6)[name != "qmix"]
    folder = tmp_path / "run"
    run([*(word.replace("vdn", name) for word in words), "--run-dir", str(folder)], ROOT)
    assert pd.read_csv(folder / "evaluations.csv")["return_mean"].iloc[-1] == expected
    if name == "iql":  # its values do not make a table
        return
    shown = (ROOT / "docs/credit.md").read_text(encoding="utf-8")
    printed = run(["python", "examples/two_step_values.py", name, str(folder)], ROOT)
    first, *games = ([float(x) for x in re.findall(r"-?\d+\.\d+", line)] for line in printed.splitlines())
    table = shown.partition(f"| game A, {name.upper()}")[2].partition("\n\n")[0]
    rows = [[float(x) for x in re.findall(r"-?\d+\.\d+", line)] for line in table.splitlines()[2:]]
    of_page = [[*rows[0][:2], *rows[1][:2]], [*rows[0][2:], *rows[1][2:]]]
    np.testing.assert_allclose(games, of_page, atol=0.3)
    row = re.search(rf"\| {name.upper()} \| ([\d.]+) \| ([\d.]+) \|", shown)
    assert row and [first[0], first[3]] == pytest.approx([float(row[1]), float(row[2])], abs=0.3)


@pytest.mark.slow
def test_the_search_says_what_the_solution_says():
    [words] = commands(7)
    rows = [line.split(" | ") for line in run(words, ROOT).splitlines() if "IA2C" in line]
    assert ["reward_standardisation False" in row[3] for row in rows] == [False] * 6 + [True] * 6  # the best first
    assert all(row[4] == "3" for row in rows)  # seeds
    averages = [float(row[6].split()[0]) for row in rows]
    smallest = [average for average, row in zip(averages, rows) if "learning_rate 0.0001" in row[3]]
    assert smallest == averages[4:6] + averages[10:] and max(smallest) < min(averages[:4] + averages[6:10])


@pytest.mark.slow
def test_the_failure_is_filmed(tmp_path):
    [[*words, team]] = commands(8)
    shutil.copytree(ROOT / team, tmp_path / "team")
    said = run([*words, str(tmp_path / "team")], ROOT)
    assert said.startswith("return_mean 50.000,") and (tmp_path / "team/film.gif").exists()


@pytest.mark.nightly
def test_mappo_as_yu_et_al_use_it_learns(tmp_path):
    [_, compare, train] = commands(10)
    assert compare[0] == "diff" and all((ROOT / path).exists() for path in compare[1:])
    run([*train, "--run-dir", str(tmp_path / "run")], ROOT)
    assert at_the_end(tmp_path / "run", "return") > 0.95

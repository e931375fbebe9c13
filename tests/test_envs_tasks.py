"""The grammar of names, what the paper says of each task, and the command line."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import envs
from envs.tasks import room_for_foods

PAPER = {
    "matrix": ("matrix", 2_500_000, 250_000, 101),
    "lbf": ("lbf", 20_000_000, 2_000_000, 41),
    "smaclite": ("smac", 40_000_000, 4_000_000, 41),
}


def test_the_papers_tasks() -> None:
    names = envs.task_names()
    assert len(names) == len(set(names)) == 18
    for name in names:
        task = envs.task(name)
        assert task.name == name
        figures = (task.family, task.on_policy_timesteps, task.off_policy_timesteps, task.eval_points)
        assert figures == PAPER[name.split("-")[0]]


def test_names_of_the_papers_table_of_results() -> None:
    table = Path(__file__).parents[1] / "benchmark" / "paper" / "returns.csv"
    with table.open() as lines:
        printed = {line["task"] for line in csv.DictReader(lines)}
    ours = {name for name in envs.task_names() if name.startswith(("lbf-", "matrix-"))}
    assert ours == {name for name in printed if name.startswith(("lbf-", "matrix-"))}
    # Our own simulator stands for StarCraft II.
    stand_ins = {name for name in envs.task_names() if name.startswith("smaclite-")}
    assert stand_ins == {f"smaclite-{name[5:]}-sc2" for name in printed if name.startswith("smac-")}
    assert {envs.task(name).family for name in printed if name.startswith("smac-")} == {"smac"}


@given(
    rows=st.integers(3, 30),
    columns=st.integers(3, 30),
    agents=st.integers(0, 20),
    foods=st.integers(0, 20),
    suffix=st.sampled_from(["", "-2s", "-c", "-2s-c", "-v3", "-2s-v3", "-c-v3", "-2s-c-v3"]),
)
@settings(max_examples=300, deadline=None)
def test_every_size_is_played_or_refused(rows: int, columns: int, agents: int, foods: int, suffix: str) -> None:
    name = f"lbf-{rows}x{columns}-{agents}p-{foods}f{suffix}"
    try:
        task = envs.task(name)
    except envs.InputError as error:
        assert str(error).startswith(f"{name}: ") and str(error).endswith(".")
        crowded = (rows - 2) * (columns - 2) <= agents or 9 * foods > rows * columns
        assert agents == 0 or foods == 0 or crowded
        return
    assert task.name == name
    assert agents >= 1 and foods >= 1
    env = envs.make(name, 2)
    observations, _ = env.reset()
    assert (env.n_agents, env.obs_size, env.n_actions, env.episode_limit) == (agents, 3 * (agents + foods), 6, 50)
    assert (observations[:, :, : 3 * foods].reshape(-1, 3)[:, 2] > 0).any() or "-2s" in suffix
    assert env.observation_space.contains(observations)
    env.step(np.zeros((2, agents), int))


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("lbf-8x8-0p-2f", "at least one agent and one food"),
        ("lbf-8x8-2p-0f", "at least one agent and one food"),
        ("lbf-2x8-1p-1f", "at least 3 rows and 3 columns"),
        ("lbf-8x2-1p-1f-v3", "at least 3 rows and 3 columns"),
        ("lbf-3x3-1p-1f", "may leave no cell off the border free"),
        ("lbf-4x4-4p-1f", "may leave no cell off the border free"),
        ("lbf-5x5-2p-3f", "a 5x5 board is played with up to 2, not 3"),
        ("lbf-5x5-2p-4f-v3", "a 5x5 board is played with up to 2, not 4"),
        ("lbf-99999999x8-2p-2f", r"longer than 2\^24"),
        ("matrix-penalty-99999999", r"larger than 2\^24"),
    ],
)
def test_impossible_sizes(name: str, why: str) -> None:
    with pytest.raises(envs.InputError, match=why):
        envs.task(name)
    with pytest.raises(envs.InputError, match=why):
        envs.make(name)


@pytest.mark.parametrize(
    ("rows", "columns", "room"), [(3, 3, 1), (3, 9, 3), (4, 4, 1), (5, 5, 2), (6, 6, 4), (8, 8, 8)]
)
def test_room_for_foods(rows: int, columns: int, room: int) -> None:
    """Most that fit, found by trying all arrangements row by row (by hand for the smallest)."""
    assert room_for_foods(rows, columns, 99) == room_for_foods(columns, rows, 99) == room
    assert room_for_foods(rows, columns, 1) == 1


@pytest.mark.parametrize(
    ("name", "nearest"),
    [
        ("lbf-15x15-3p-5", "lbf-15x15-3p-5f"),
        ("lbf-8x8-2p-2f-c-2s", "lbf-8x8-2p-2f-2s-c"),
        ("lbf-08x8-2p-2f-c", "lbf-8x8-2p-2f-c"),
        ("lbf-8x8-2p-2f-v2", "lbf-8x8-2p-2f-c"),
        ("matrix-climbin", "matrix-climbing"),
        ("matrix-penalty--25", "matrix-penalty-25"),
        ("matrix-penalty-025", "matrix-penalty-25"),
        ("LBF-15X15-3P-5F", "lbf-15x15-3p-5f"),
        ("", "the nearest are"),
        ("smaclite-mmm2-sc2", "smaclite-MMM2-sc2"),
        ("smaclite-4s5z", "smaclite-3s5z-sc2"),
        ("smac-3s5z-sc2", "smaclite-3s5z-sc2"),
        ("lbf-15x15-3p-5f\n", "lbf-15x15-3p-5f"),
    ],
)
def test_unknown_names_offer_the_nearest(name: str, nearest: str) -> None:
    with pytest.raises(envs.InputError, match="unknown task") as error:
        envs.make(name)
    assert nearest in str(error.value) and "\n" not in str(error.value)
    assert isinstance(error.value, ValueError)


@given(st.text())
def test_any_text_is_a_task_or_a_clear_error(name: str) -> None:
    try:
        assert envs.task(name).name == name
    except envs.InputError as error:
        assert "\n" not in str(error)


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "envs", *arguments], capture_output=True, text=True)


def test_the_command_line() -> None:
    table = run()
    assert table.returncode == 0 and table.stderr == ""
    lines = table.stdout.splitlines()
    assert [line.split()[0] for line in lines[1:]] == envs.task_names()
    assert len({len(line) for line in lines}) == 1
    one = run("lbf-15x15-3p-5f")
    cells = one.stdout.splitlines()[1].split()
    assert " ".join(cells) == "lbf-15x15-3p-5f 3 24 72 6 50 20,000,000 2,000,000"
    unknown = run("lbf-15x15-3p-5")
    assert unknown.returncode == 2 and unknown.stdout == ""
    assert unknown.stderr.count("\n") == 1 and "lbf-15x15-3p-5f" in unknown.stderr

"""The grammar of names, what the paper says of each task, and the command line."""

from __future__ import annotations

import csv
import itertools
import subprocess
import sys
from pathlib import Path

import numpy as np
import programs
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import envs
from envs import tasks
from envs.tasks import lacks_opponent, names_here, room_for_foods, stand_in

PAPER = {
    "matrix": ("matrix", 2_500_000, 250_000, 101),
    "lbf": ("lbf", 20_000_000, 2_000_000, 41),
    "rware": ("rware", 40_000_000, 4_000_000, 41),
    "mpe": ("mpe", 20_000_000, 2_000_000, 41),
    "smaclite": ("smac", 40_000_000, 4_000_000, 41),
}


def test_the_papers_tasks() -> None:
    names = envs.task_names()
    assert len(names) == len(set(names)) == 25 - sum(map(lacks_opponent, ("mpe-adversary", "mpe-tag")))
    for name in names:
        task = envs.task(name)
        assert task.name == name
        figures = (task.family, task.on_policy_timesteps, task.off_policy_timesteps, task.eval_points)
        assert figures == PAPER[name.split("-")[0]]


def test_names_of_the_papers_table_of_results() -> None:
    table = Path(__file__).parents[1] / "benchmark" / "paper" / "returns.csv"
    with table.open() as lines:
        printed = {line["task"] for line in csv.DictReader(lines)}
    # Our own simulator stands for StarCraft II.
    expected = {stand_in(name[5:]) if name.startswith("smac-") else name for name in printed}
    assert {name for name in expected if not lacks_opponent(name)} == set(envs.task_names())
    assert {envs.task(name).family for name in printed if name.startswith("smac-")} == {"smac"}


@pytest.mark.parametrize("scenario", ["speaker-listener", "spread", "adversary", "tag"])
def test_particle_environments(scenario: str) -> None:
    """The package's rules have the paper's budgets; where all agents learn, 25,000 episodes of 25 steps."""
    if lacks_opponent(f"mpe2-{scenario}"):
        pytest.skip("its opponent is not trained yet")
    task = envs.task(f"mpe2-{scenario}")
    assert (task.family, task.on_policy_timesteps, task.off_policy_timesteps, task.eval_points) == PAPER["mpe"]
    for rules in ("mpe", "mpe2"):
        name = f"{rules}-{scenario}-selfplay"
        if scenario in ("adversary", "tag"):
            task = envs.task(name)
            assert (task.family, task.on_policy_timesteps, task.off_policy_timesteps) == ("mpe", 625_000, 625_000)
        else:
            with pytest.raises(envs.InputError, match="unknown task"):
                envs.task(name)


def test_a_task_without_its_opponent_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tasks, "OPPONENTS", tmp_path)
    for name in ("mpe-tag", "mpe2-adversary"):
        with pytest.raises(envs.InputError, match=f"{name} has no opponent yet"):
            envs.make(name)
    assert not {"mpe-adversary", "mpe-tag"} & set(envs.task_names())


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


@pytest.mark.parametrize("size", ["tiny", "small", "medium", "large"])
@pytest.mark.parametrize("agents", range(22))
def test_every_warehouse_is_played_or_refused(size: str, agents: int) -> None:
    shelves = {"tiny": 32, "small": 80, "medium": 144, "large": 224}[size]
    for sight, difficulty in itertools.product(["", "-2s", "-5s"], ["", "-easy", "-hard"]):
        name = f"rware-{size}-{agents}p{sight}{difficulty}"
        requests = {"": agents, "-easy": 2 * agents, "-hard": agents // 2}[difficulty]
        try:
            task = envs.task(name)
        except envs.InputError as error:
            assert str(error).startswith(f"{name}: ") and str(error).endswith(".")
            assert not 1 <= agents <= 20 or not 1 <= requests < shelves
            continue
        assert task.name == name and 1 <= agents <= 20 and 1 <= requests < shelves
        assert task.settings["n_requests"] == requests
        env = envs.make(name)
        observations, _ = env.reset()
        cells = {"": 9, "-2s": 25, "-5s": 121}[sight]
        assert (env.n_agents, env.obs_size, env.n_actions, env.episode_limit) == (agents, 8 + 7 * cells, 5, 500)
        assert env.observation_space.contains(observations)


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("lbf-8x8-0p-2f", "at least one agent and one food"),
        ("lbf-8x8-2p-0f", "at least one agent and one food"),
        ("lbf-2x8-1p-1f", "at least 3 rows and 3 columns"),
        ("lbf-8x2-1p-1f-v3", "at least 3 rows and 3 columns"),
        ("lbf-3x3-1p-1f", "may leave no cell inside the border free"),
        ("lbf-4x4-4p-1f", "may leave no cell inside the border free"),
        ("lbf-5x5-2p-3f", "a 5x5 board is played with at most 2 of them, not 3"),
        ("lbf-5x5-2p-4f-v3", "a 5x5 board is played with at most 2 of them, not 4"),
        ("lbf-99999999x8-2p-2f", r"longer than 2\^24"),
        ("lbf-16777216x3-2p-9999999f", "tries 1,000 places for its foods"),
        ("matrix-penalty-99999999", r"larger than 2\^24"),
        ("rware-tiny-0p", "1 to 20 agents"),
        ("rware-large-21p", "1 to 20 agents"),
        ("rware-tiny-1p-hard", "needs at least 2 agents"),
        ("rware-tiny-16p-easy", "32 requests leave none of the 32 shelves"),
        ("rware-tiny-20p-2s-easy", "40 requests leave none of the 32 shelves"),
        ("rware-tiny-2p-1s", "leave the -1s out"),
        ("rware-tiny-2p-0s", "1 to 5 cells"),
        ("rware-tiny-2p-6s-hard", "1 to 5 cells"),
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
    """The most that fit, found by trying all arrangements row by row (by hand for the smallest boards)."""
    assert room_for_foods(rows, columns, 99) == room_for_foods(columns, rows, 99) == room
    assert room_for_foods(rows, columns, 1) == 1


@pytest.mark.parametrize(
    ("name", "nearest"),
    [
        ("lbf-15x15-3p-5", "lbf-15x15-3p-5f"),
        ("lbf-8x8-2p-2f-c-2s", "lbf-8x8-2p-2f-2s-c"),
        ("lbf-8x8-2p-2f-v2", "lbf-8x8-2p-2f-c"),
        ("matrix-climbin", "matrix-climbing"),
        ("matrix-penalty-025", "matrix-penalty-25"),
        ("LBF-15X15-3P-5F", "lbf-15x15-3p-5f"),
        ("rware-tiny-4ag", "rware-tiny-4p"),
        ("rware-tiny-4p-hard-2s", "rware-tiny-4p"),
        ("rware-huge-4p", "rware-tiny-4p"),
        ("mpe-speaker_listener", "mpe-speaker-listener"),
        ("", "-"),
        ("smaclite-4s5z-sc2", "smaclite-3s5z-sc2-v2"),
        ("smac-3s5z-sc2", "smaclite-3s5z-sc2-v2"),
        ("smaclite-MMM2-sc2-v2", "smaclite-MMM2-sc2"),
        ("lbf-15x15-3p-5f\n", "lbf-15x15-3p-5f"),
    ],
)
def test_unknown_names_offer_the_nearest(name: str, nearest: str) -> None:
    with pytest.raises(envs.InputError, match="unknown task") as error:
        envs.make(name)
    assert nearest in str(error.value) and "\n" not in str(error.value)
    assert "`python -m envs` lists the tasks" in str(error.value)
    assert isinstance(error.value, ValueError)


@pytest.mark.parametrize(
    "name", ["LBF-9x9-2P-2f", "smaclite-3m-SC2", "Rware-Tiny-2p", "Pettingzoo:mpe2.simple_spread_v3"]
)
def test_a_name_in_other_letters_is_meant_exactly(name: str) -> None:
    with pytest.raises(envs.InputError) as error:
        envs.task(name)
    assert str(error.value).startswith(f"unknown task {name!r}; did you mean {name.lower()}? ")


@pytest.mark.parametrize("name", ["", "hello", "lbf", "rware", "8x8", "\ud800", "matrix-penalty-" + "9" * 5000])
def test_unknown_names_far_from_all_offer_none(name: str) -> None:
    with pytest.raises(envs.InputError) as error:
        envs.task(name)
    assert str(error.value) == f"unknown task {name!r}. `python -m envs` lists the tasks."


@pytest.mark.parametrize(
    ("name", "ours"),
    [
        ("Foraging-8x8-2p-2f-coop-v3", "lbf-8x8-2p-2f-c-v3 or lbf-8x8-2p-2f-c"),
        ("lbforaging:Foraging-15x15-3p-5f-v3", "lbf-15x15-3p-5f-v3 or lbf-15x15-3p-5f"),
        ("Foraging-2s-8x8-2p-2f-coop-v2", "lbf-8x8-2p-2f-2s-c"),
        ("Foraging-10x10-3p-3f-v1", "lbf-10x10-3p-3f"),
        ("Foraging-8s-8x7-2p-2f", "lbf-8x7-2p-2f"),  # sees the whole board
        ("climbing", "matrix-climbing"),
        ("penalty-100-nostate", "matrix-penalty-100"),
        ("matrixgames:penalty-25-nostate-v0", "matrix-penalty-25"),
    ],
)
def test_names_of_the_reference_are_translated(name: str, ours: str) -> None:
    with pytest.raises(envs.InputError) as error:
        envs.task(name)
    assert f"unknown task {name!r}; here it is called {ours}. " in str(error.value)
    for task in ours.split(" or "):
        assert envs.task(task).name == task


@pytest.mark.parametrize(
    ("name", "ours"),
    [
        ("rware-tiny-4ag", ["rware-tiny-4p"]),
        ("rware-small-2ag-easy-v2", ["rware-small-2p-easy"]),
        ("simple_spread", ["mpe-spread"]),
        ("SimpleSpread-v0", ["mpe-spread"]),
        ("mpe:SimpleSpeakerListener-v0", ["mpe-speaker-listener"]),
        ("simple_speaker_listener_v4", ["mpe2-speaker-listener", "mpe-speaker-listener"]),
        ("mpe2.simple_tag_v3", ["mpe2-tag", "mpe-tag"]),
        ("pz-mpe-simple-adversary-v3", ["mpe2-adversary", "mpe-adversary"]),
        ("simple_crypto", []),
        ("3s5z", ["smac-3s5z", "smaclite-3s5z-sc2-v2"]),
        ("MMM2", ["smac-MMM2", "smaclite-MMM2-sc2"]),
        ("smaclite/corridor-v0", ["smaclite-corridor"]),
        ("Foraging-3s-8x8-2p-2f-v3", ["lbf-8x8-2p-2f-3s-v3", "lbf-8x8-2p-2f-3s"]),
        ("spread", []),
    ],
)
def test_names_here(name: str, ours: list[str]) -> None:
    assert names_here(name) == ours


def test_a_game_that_is_impossible_here_says_why() -> None:
    for name, why in (("5x5-2p-3f", "foods lie inside the border .*, not 3"), ("5x5-9p-1f", "9 agents may leave .*")):
        with pytest.raises(envs.InputError, match=rf"does not have that game \(lbf-{name}: {why}\)\. `python"):
            envs.task(f"Foraging-{name}-v3")


@given(st.text())
def test_any_text_is_a_task_or_a_clear_error(name: str) -> None:
    try:
        assert envs.task(name).name == name
    except envs.InputError as error:
        assert "\n" not in str(error)


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return programs.run([sys.executable, "-m", "envs", *arguments])


def test_the_command_line() -> None:
    table = run()
    assert table.returncode == 0 and table.stderr == ""
    lines = table.stdout.splitlines()
    assert [line.split()[0] for line in lines[1:]] == envs.task_names()
    assert len({len(line) for line in lines}) == 1
    cells = next(line for line in lines if line.startswith("lbf-15x15-3p-5f ")).split()
    assert " ".join(cells) == "lbf-15x15-3p-5f 3 24 72 6 50 20,000,000 2,000,000"
    unknown = run("lbf-15x15-3p-5f", "lbf-15x15-3p-5")
    assert unknown.returncode == 2 and unknown.stdout == ""
    assert unknown.stderr.count("\n") == 1 and "did you mean lbf-15x15-3p-5f" in unknown.stderr
    wrong = run("check", "matrix-climbing", "--env-workers", "-1")
    assert (
        wrong.returncode == 2 and wrong.stderr == "envs: --env-workers -1: the value must lie between 0 and 10,000.\n"
    )

"""Environments that are not ours, through the adapters: agreement with the packages, and toys with every difficulty."""

from __future__ import annotations

import copy
import os
import pickle
import re
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import ANY

import gymnasium
import lbforaging  # noqa: F401 (registers its environments)
import numpy as np
import programs
import pytest
import rware  # noqa: F401 (registers its environments)
import torch
from mpe2 import simple_speaker_listener_v4, simple_spread_v3
from pettingzoo.sisl import pursuit_v5
from scripts import NAMES, ROOT, args_of, parse, script, trained
from test_algos_families import few_updates
from test_algos_runs import command, evaluations, main
from toys import Queue

import envs
from envs import runs
from envs.adapters.foreign import parse_kwargs
from envs.vector import episode_seed

SPREAD = "pettingzoo:mpe2.simple_spread_v3"
LISTENER = "pettingzoo:mpe2.simple_speaker_listener_v4"
PURSUIT = "pettingzoo:pettingzoo.sisl.pursuit_v5"
FORAGING = "gymnasium:lbforaging:Foraging-5x5-2p-1f-v3"
WAREHOUSE = "gymnasium:rware:rware-tiny-2ag-v2"


# ---------------------------------------------------------------------------------------------------------------------
# Agreement with the packages
# ---------------------------------------------------------------------------------------------------------------------


def padded(vectors: list[Any], size: int) -> np.ndarray:
    return np.array([np.pad(np.ravel(vector), (0, size - np.size(vector))) for vector in vectors], np.float32)


@pytest.mark.parametrize(
    ("name", "make", "options"),
    [
        (SPREAD, lambda: simple_spread_v3.parallel_env(N=2), {"env_kwargs": "N=2"}),
        (LISTENER, simple_speaker_listener_v4.parallel_env, {}),
        (
            PURSUIT,
            lambda: pursuit_v5.parallel_env(max_cycles=20),
            {"env_kwargs": "max_cycles=20", "flatten_images": True},
        ),
    ],
)
def test_parallel_environments(name: str, make: Any, options: dict[str, Any]) -> None:
    """Two episodes, step by step beside the package's own environment with the same seeds."""
    env, theirs = envs.make(name, 2, seed=3, **options), make()
    rng = np.random.default_rng(0)
    for episode in range(2):
        observations, info = env.reset()
        views, _ = theirs.reset(seed=episode_seed(3, 1, episode))
        for _ in range(env.episode_limit):
            np.testing.assert_array_equal(observations[1], padded(list(views.values()), env.obs_size))
            np.testing.assert_array_equal(info["state"][1], np.ravel(theirs.state()).astype(np.float32))
            actions = rng.integers(0, env.choices, (2, env.n_agents))
            observations, rewards, terminated, truncated, info = env.step(actions)
            views, own, ends, time_outs, _ = theirs.step(dict(zip(theirs.agents, actions[1].tolist())))
            np.testing.assert_array_equal(info["agent_rewards"][1], np.array(list(own.values()), np.float32))
            assert rewards[1] == pytest.approx(sum(own.values()), rel=1e-6)
            assert (terminated[1], truncated[1]) == (all(ends.values()), all(time_outs.values()))
        np.testing.assert_array_equal(observations[1], padded(list(views.values()), env.obs_size))  # after the end, too
        assert truncated.all() and not terminated.any()


@pytest.mark.parametrize(("name", "limit"), [(FORAGING, 50), pytest.param(WAREHOUSE, 500, marks=pytest.mark.slow)])
def test_tuple_environments(name: str, limit: int) -> None:
    env, theirs = envs.make(name, 2, seed=3), gymnasium.make(name.removeprefix("gymnasium:"), disable_env_checker=True)
    assert (env.episode_limit, env.teams, env.state_is_observations) == (limit, (0, 0), True)
    rng = np.random.default_rng(0)
    ended = 0
    for episode in range(3):
        observations, _ = env.reset()
        views, _ = theirs.reset(seed=episode_seed(3, 0, episode))
        for step in range(1, limit + 1):
            np.testing.assert_array_equal(observations[0], np.array(views))
            actions = rng.integers(0, env.n_actions, (2, 2))
            observations, rewards, terminated, truncated, info = env.step(actions)
            own: Any
            views, own, done, _, _ = theirs.step(tuple(actions[0].tolist()))
            np.testing.assert_array_equal(info["agent_rewards"][0], np.array(own, np.float32))
            assert rewards[0] == np.float32(sum(own))
            assert (terminated[0] or truncated[0]) == done
            assert not terminated[0] or step < limit  # the packages call the end of their clock a termination
            if done:
                break
        ended += terminated[0]
    assert ended > 0 or name == WAREHOUSE


# ---------------------------------------------------------------------------------------------------------------------
# Toys, from tests/toys.py
# ---------------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", autouse=True)
def toys(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Modules with a parallel_env, in a folder that is the current one."""
    folder = tmp_path_factory.mktemp("toys")
    for name in ("Queue", "Broken", "Odd", "Painted", "Sides", "Reseeds"):
        (folder / f"toy_{name.lower()}.py").write_text(
            f"import sys\nsys.path.append({str(ROOT / 'tests')!r})\nfrom toys import {name} as parallel_env\n"
        )
    (folder / "toy_turns.py").write_text("def env(): pass\n")
    (folder / "toy_nothing.py").write_text("")
    (folder / "toy_import.py").write_text("import a_package_that_nobody_has\n")
    (folder / "toy_moved.py").write_text("raise ImportError('this has moved to another package')\n")
    (folder / "toy_wrong.py").write_text("\n1 / 0\n")
    (folder / "toy_syntax.py").write_text("def (:\n")
    (folder / "toy_empty.py").write_text("class parallel_env: pass\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield


def test_unequal_agents_who_leave_early() -> None:
    env = envs.make("pettingzoo:toy_queue", 2)
    assert (env.n_agents, env.n_actions, env.choices, env.obs_size, env.state_size) == (3, 3, (2, 3, 2), 3, 2)
    assert (env.episode_limit, env.teams) == (6, (0, 1, 0))
    observations, info = env.reset()
    assert observations[0].tolist() == [[0, 0, 0], [0, 1, 7], [0, 2, 0]]
    assert info["state"][0].tolist() == [0, 3]
    for step in range(1, 7):
        masks = {  # of each agent: while it is there, and when it has left
            0: [1, (step - 1) % 2, 0] if step <= 2 else [1, 0, 0],
            1: [1, step % 2, 1] if step <= 3 else [1, 0, 0],
            2: [1, 1, 0],
        }
        assert info["action_mask"][0].astype(int).tolist() == list(masks.values())
        observations, rewards, terminated, truncated, info = env.step([[0, 0, 1]] * 2)
        assert observations[0, 0].tolist() == ([step, 0, 0] if step < 2 else [0, 0, 0])
        assert observations[0, 1].tolist() == ([step, 1, 7] if step < 3 else [0, 0, 0])
        assert observations[0, 2].tolist() == [step, 2, 0]  # after the last step, too
        own = [1 if step <= 2 else 0, 2 if step <= 3 else 0, 3]
        assert info["agent_rewards"][0].tolist() == own
        assert rewards[0] == own[0] + own[2]  # of team 0
        assert not terminated.any() and truncated.tolist() == [step == 6] * 2
    with pytest.raises(ValueError, match="agent 0: action 1 is forbidden"):
        env.step([[1, 0, 0]] * 2)


@pytest.mark.parametrize("limit", [3, 9])
def test_max_episode_steps_cuts_episodes(limit: int) -> None:
    """A limit beyond the environment's own does not lengthen them."""
    env = envs.make("pettingzoo:toy_queue", 1, max_episode_steps=limit)
    assert env.episode_limit == limit
    env.reset()
    length = min(limit, 6)
    results = [env.step([[0, 0, 0]]) for _ in range(length)]
    assert [bool(result[3][0]) for result in results] == [False] * (length - 1) + [True]
    assert not results[-1][2][0]


@pytest.mark.parametrize(
    ("variant", "steps", "reward", "own", "ends"),
    [
        ("", 5, 4, [1, 3], (False, True)),  # cut
        ("one reward", 5, 2.5, [2.5, 2.5], (False, True)),
        ("lists", 3, 4, [1, 3], (True, False)),
        ("clock", 4, 4, [1, 3], (False, True)),  # it says "terminated" in its last step
        ("masks", 5, 4, [1, 3], (False, True)),
        ("one by one", 3, 4, [1, 3], (True, False)),  # it goes on until both are done
    ],
)
def test_tuples(variant: str, steps: int, reward: float, own: list[float], ends: tuple[bool, bool]) -> None:
    env = envs.make("gymnasium:Tuples-v0", 1, env_kwargs={"variant": variant}, max_episode_steps=5)
    assert (env.choices, env.obs_size) == ((2, 3), 10)
    observations, info = env.reset()
    assert observations[0, 1].argmax() == 0 and observations[0, 1].sum() == 1  # one-hot
    for step in range(1, steps + 1):
        assert not (env.terminated | env.truncated).any()
        actions = [[0, 1]] if variant == "masks" and step > 1 else [[1, 0]]
        observations, rewards, terminated, truncated, info = env.step(actions)
        assert (rewards[0], info["agent_rewards"][0].tolist()) == (reward, own)
        assert observations[0, 0, 0] == step and observations[0, 1].argmax() == step
        expected = [[1, 0, 0], [0, 1, 1]] if variant == "masks" else [[1, 1, 0], [1, 1, 1]]
        assert info["action_mask"][0].astype(int).tolist() == expected
    assert (terminated[0], truncated[0]) == ends


def test_an_end_in_the_last_step_of_a_time_limit_of_gymnasiums() -> None:
    """The wrapper then sets both flags; that one of them is the environment's own says that the end is real."""
    for variant, ends in (("lists", (True, False)), ("", (False, True))):
        env = envs.make("gymnasium:ThreeTuples-v0", 1, env_kwargs={"variant": variant})
        env.reset()
        for _ in range(3):
            *_, terminated, truncated, _ = env.step([[1, 0]])
        assert (terminated[0], truncated[0]) == ends


def test_the_last_agents_leave_for_different_reasons(monkeypatch: pytest.MonkeyPatch) -> None:
    """Agent 1 with a termination, agent 2 by the clock: the episode timed out."""
    monkeypatch.setattr(Queue, "max_cycles", 3)
    env = envs.make("pettingzoo:toy_queue", 1)
    env.reset()
    flags = [env.step([[0, 0, 0]])[2:4] for _ in range(3)]
    assert [(bool(terminated[0]), bool(truncated[0])) for terminated, truncated in flags] == [
        *[(False, False)] * 2,
        (False, True),
    ]


def test_one_agent() -> None:
    """Its time-out is Gymnasium's own."""
    env = envs.make("gymnasium:CartPole-v1", 1, seed=1, max_episode_steps=5)
    assert (env.n_agents, env.n_actions, env.obs_size, env.episode_limit) == (1, 2, 4, 5)
    env.reset()
    results = [env.step([[step % 2]]) for step in range(5)]
    assert [result[1][0] for result in results] == [1] * 5 and results[-1][3][0]


# ---------------------------------------------------------------------------------------------------------------------
# Worker processes
# ---------------------------------------------------------------------------------------------------------------------


def test_workers_play_what_one_process_plays() -> None:
    """Five sub-environments in two workers, with a reset of some."""
    here, there = envs.make(FORAGING, 5, seed=2), envs.make(FORAGING, 5, seed=2, env_workers=np.int64(2))  # type: ignore[arg-type]
    rng = np.random.default_rng(0)
    for episode in range(2):
        mask = None if episode == 0 else {"reset_mask": np.array([True, False, True, True, False])}
        np.testing.assert_array_equal(here.reset(options=mask)[0], there.reset(options=mask)[0])
        for _ in range(30):
            actions = rng.integers(0, 6, (5, 2))
            for ours, theirs in zip(here.step(actions)[:4], there.step(actions)[:4]):
                np.testing.assert_array_equal(ours, theirs)
    there.close()


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ("error", r"fails in step \(.*toys.py, line \d+\) with ZeroDivisionError: the toy"),
        ("killed", "worker process 0 was killed, perhaps since memory ran out"),
    ],
)
def test_a_worker_that_dies_ends_the_run(how: str, message: str) -> None:
    env = envs.make("pettingzoo:toy_broken", 3, env_kwargs={"how": how}, env_workers=2)
    env.reset()
    env.step([[0, 0, 0]] * 3)
    with pytest.raises((envs.InputError, RuntimeError), match=message):
        env.step([[0, 0, 0]] * 3)


def test_a_worker_that_is_busy_when_another_dies_says_nothing(capfd: Any) -> None:
    seed = next(s for s in range(99) if [episode_seed(s, e, 0) % 2 for e in range(2)] == [0, 1])
    env = envs.make("pettingzoo:toy_broken", 2, seed, env_kwargs={"how": "one is slow"}, env_workers=2)
    env.reset()
    env.step([[0, 0, 0]] * 2)
    with pytest.raises(envs.InputError, match="ZeroDivisionError: the toy is broken"):
        env.step([[0, 0, 0]] * 2)
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="Windows has no timers")
def test_after_an_interrupted_call_the_workers_have_ended() -> None:
    """What the slow one answers later must not be taken for the answer to the next call."""
    seed = next(s for s in range(99) if episode_seed(s, 0, 0) % 2)
    env = envs.make("pettingzoo:toy_broken", 1, seed, env_kwargs={"how": "one is slow"}, env_workers=1)
    env.reset()
    env.step([[0, 0, 0]])

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, 0.2)
    try:
        with pytest.raises(KeyboardInterrupt):
            env.step([[0, 0, 0]])
    finally:
        signal.signal(signal.SIGALRM, before)
    for _ in range(2):
        with pytest.raises(RuntimeError, match="it was closed, or a call to its worker processes was interrupted"):
            env.reset()
    env.close()


@pytest.mark.skipif(not hasattr(os, "setsid"), reason="Windows has no groups of processes")
@pytest.mark.parametrize("number", ["SIGTERM", "SIGHUP", "SIGINT"])
@pytest.mark.slow
def test_what_stops_a_run_does_not_stop_its_workers(number: str) -> None:
    """To the group (`timeout`, a closed terminal) and to every process (systemd): at the start and in the middle."""
    play = f"""
import multiprocessing, os, signal, envs
def stop():
    os.killpg(0, signal.{number})
    for worker in multiprocessing.active_children():
        os.kill(worker.pid, signal.{number})
if __name__ == "__main__":
    received = []
    signal.signal(signal.{number}, lambda *_: received.append(1))
    env = envs.make({FORAGING!r}, 4, env_workers=2)
    stop()
    env.reset()
    stop()
    env.step([[0, 0]] * 4)
    env.close()
    print(len(received))
"""
    done = subprocess.run([sys.executable, "-c", play], capture_output=True, text=True, start_new_session=True)
    assert done.stdout == "2\n", done.stderr


HANGS = """
import os, signal, sys, envs
if __name__ == "__main__":
    env = envs.make("pettingzoo:toy_broken", 2, env_kwargs={"how": HOW}, env_workers=1)
    env.reset()
    env.step([[0, 0, 0]] * 2)
    signal.signal(signal.SIGALRM, lambda *_: END)
    signal.alarm(1)
    env.step([[0, 0, 0]] * 2)
"""


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="Windows has no timers")
@pytest.mark.parametrize(
    ("how", "end", "code", "closed"),
    [
        ("hangs", "sys.exit(7)", 7, 3),  # the worker closes two games, one told its sizes before
        ("hangs and is deaf", "sys.exit(7)", 7, 1),
        ("hangs", "os.kill(os.getpid(), signal.SIGKILL)", -9, 1),
    ],
)
@pytest.mark.slow
def test_a_worker_that_hangs_ends_with_its_program(how: str, end: str, code: int, closed: int) -> None:
    """Without `close`, as after the third Ctrl-C."""
    play = HANGS.replace("HOW", repr(how)).replace("END", end)
    paths = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    # The worker's output is the program's: this waits for both.
    done = subprocess.run([sys.executable, "-c", play], capture_output=True, text=True, env=paths, timeout=60)
    assert (done.returncode, done.stdout) == (code, "closed\n" * closed), done.stderr


# ---------------------------------------------------------------------------------------------------------------------
# What cannot work
# ---------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("gymnasium:Pendulum-v1", {}, "these algorithms need discrete ones"),
        ("pettingzoo:toy_odd", {"env_kwargs": "kind='continuous'"}, "these algorithms need discrete ones"),
        ("pettingzoo:toy_odd", {"env_kwargs": "kind='nobody'"}, "has no agents"),
        (
            "pettingzoo:toy_odd",
            {"env_kwargs": "kind='image'"},
            r"observations of the shape \(4, 4, 3\), not vectors; `flatten_images`",
        ),
        ("pettingzoo:toy_odd", {"env_kwargs": "kind='sequence'"}, "observations without a fixed size"),
        ("pettingzoo:toy_odd", {"env_kwargs": "kind='no limit'"}, "says nowhere how long .*; `max_episode_steps` does"),
        ("pettingzoo:toy_odd", {"env_kwargs": "sort='image'"}, "unexpected keyword argument 'sort'"),
        ("pettingzoo:toy_odd", {"env_kwargs": "kind='short'"}, "does not fit its space .* it has 1 values"),
        ("pettingzoo:toy_odd", {"env_kwargs": "kind='short mask'"}, r"agent 1 has 3 actions and the action mask \[1\]"),
        ("pettingzoo:toy_odd", {"env_kwargs": "kind='newcomer'"}, "'d'.* are not among its possible_agents"),
        ("pettingzoo:toy_odd", {"env_kwargs": "kind='named teams'"}, "are not a number for each agent"),
        ("gymnasium:Tuples-v0", {"env_kwargs": "variant='teams from 1'"}, r"its teams \(1, 2\) are not a number"),
        (
            "pettingzoo:toy_odd",
            {"env_kwargs": "kind='wrong value'"},
            r"own code fails when it is built \(.*toys.py, line \d+\) with KeyError: 'wrong value'; it was given",
        ),
        (
            "pettingzoo:toy_odd",
            {"env_kwargs": "kind='asserts'"},
            r"fails when it is built \(.*, line \d+\) with AssertionError; it",
        ),
        (
            "pettingzoo:toy_odd",
            {"env_kwargs": "kind='reset fails'"},
            r"fails in reset \(.*toys.py, line \d+\) with ZeroDivisionEr",
        ),
        (
            "pettingzoo:toy_odd",
            {"env_kwargs": "kind='reset without infos'"},
            "observations and infos, .*; reset returns dict",
        ),
        (
            "pettingzoo:toy_odd",
            {"env_kwargs": "kind='spaces as attributes'"},
            "must be functions that return a space; TypeError",
        ),
        ("pettingzoo:toy_odd", {"env_kwargs": "kind='a flag as a limit'"}, "says nowhere how long"),
        ("pettingzoo:toy_wrong", {}, r"fails when it is imported \(.*toy_wrong.py, line 2\) with ZeroDivisionError"),
        ("pettingzoo:toy_syntax", {}, r"fails when it is imported \(.*toy_syntax.py, line 1\) with SyntaxError"),
        (
            "gymnasium:OldGym-v0",
            {"env_kwargs": "variant='no info'"},
            "must return observations and a dictionary, .*; reset retu",
        ),
        (
            "gymnasium:ByAgent-v0",
            {},
            "a dictionary of actions by agent, as PettingZoo's .* played as pettingzoo:<module>",
        ),
        (
            "gymnasium:FrozenLake-v1",
            {"env_kwargs": "map_name='9x9'"},
            "fails when it is built .*frozen_lake.py, line .*KeyError: '9x9'; it was given {'map_name': '9x9'}",
        ),
        ("pettingzoo:toy_moved", {}, "toy_moved: this has moved to another package"),
        ("pettingzoo:toy_empty", {}, "has no possible_agents"),
        ("pettingzoo:toy_queue", {"max_episode_steps": -1}, "it must be a whole number from 0 on"),
        ("pettingzoo:.toy_queue", {}, "is not the name of a module"),
        ("pettingzoo:toy_turns", {}, "agents that act in turn"),
        ("pettingzoo:toy_nothing", {}, "no function parallel_env"),
        ("pettingzoo:toy_import", {}, "needs the module a_package_that_nobody_has"),
        ("pettingzoo:toy_missing", {}, "there is no module toy_missing"),
        ("pettingzoo:pettingzoo.sisl.pursuit_v4", {}, "use pursuit_v5 instead"),
        ("gymnasium:Nothing-v0", {}, "doesn't exist"),
        ("gymnasium:nothing:Nothing-v0", {}, "No module named 'nothing'"),
        ("own:toy_nothing", {}, "toy_nothing has no class Env"),
        ("own:toy_missing", {}, "there is no module toy_missing"),
        ("own:examples.meeting_numpy", {"env_kwargs": "N=2"}, "unexpected keyword argument 'N'"),
        ("lbf-8x8-2p-2f", {"env_workers": 2}, "`env_workers` is for environments of PettingZoo and Gymnasium"),
        ("lbf-8x8-2p-2f", {"max_episode_steps": 2}, "`max_episode_steps` is for"),
        ("lbf-8x8-2p-2f", {"env_kwargs": "sight=2"}, "`env_kwargs` is for .*, or of your own"),
        (FORAGING, {"env_kwargs": "sight"}, "is not like the arguments in a call"),
    ],
)
def test_one_clear_sentence(name: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(envs.InputError, match=message) as error:
        envs.make(name, **options)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("variant", ["one mask", "masks by number", "flags by number", "one observation"])
def test_what_is_not_one_thing_for_each_agent(variant: str) -> None:
    """Taken for it, it would change the game in silence."""
    env = envs.make("gymnasium:Tuples-v0", env_kwargs={"variant": variant}, max_episode_steps=5)
    env.reset()
    with pytest.raises(envs.InputError, match=r"is not one thing for each|neither one flag nor one for each agent"):
        env.step([[0, 0]])


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("growing state", "its state has 2 values now, and had 1"),
        ("late state", "its state has 2 values now, and had 0"),  # it would overwrite the observations
        ("state fails", r"fails in state \(.*toys.py, line \d+\) with ValueError: need at least one array"),
        ("four values", "infos, and step.* five: .*; step returns 4 values"),
        ("mask at first", "agent 1 has no action mask after step 1 of the episode, and had one before"),
        ("blind", r"the agents \['b'\] play on without an observation"),
        ("two rewards", r"\[1, 2\] is no reward"),
        ("unpaid", r"the agents \['b'\] have acted and get no reward"),
        ("no number as a reward", "None is no reward"),
    ],
)
def test_what_goes_wrong_in_a_step(kind: str, message: str) -> None:
    env = envs.make("pettingzoo:toy_odd", env_kwargs={"kind": kind})
    env.reset()
    with pytest.raises(envs.InputError, match=message):
        env.step([[0, 0, 0]])


@pytest.mark.parametrize("workers", [0, 2])
def test_an_observation_that_is_not_a_number(workers: int) -> None:
    """It is found before anybody learns from it, in the one sub-environment that has got so far."""
    env = envs.make("pettingzoo:toy_odd", 3, env_kwargs={"kind": "no number"}, env_workers=workers)
    env.reset()
    env.step([[0, 0, 0]] * 3)
    env.reset(options={"reset_mask": np.array([True, False, True])})
    with pytest.raises(envs.InputError, match=r"sub-environment 1 gives an observation that is not .* in step 2 of"):
        env.step([[0, 0, 0]] * 3)
    env.close()


@pytest.mark.parametrize("kind", ["rewards in arrays", "no infos"])
def test_what_others_return_otherwise(kind: str) -> None:
    env = envs.make("pettingzoo:toy_odd", env_kwargs={"kind": kind})
    env.reset()
    assert env.step([[0, 0, 0]])[4]["agent_rewards"].tolist() == [[1, 2, 3]]


@pytest.mark.parametrize("kind", ["no state", "state is an array", "state within"])
def test_without_a_function_for_the_state(kind: str) -> None:
    assert envs.make("pettingzoo:toy_odd", env_kwargs={"kind": kind}).state_is_observations


def test_pictures_that_cannot_be_had() -> None:
    env = envs.make("pettingzoo:toy_odd", env_kwargs={"kind": "picture"}, pictures=True)
    assert not env.can_draw and env.reset()[0].shape == (1, 3, 3)
    env = envs.make("pettingzoo:toy_odd", env_kwargs={"kind": "picture of fractions"}, pictures=True)
    env.reset()
    with pytest.raises(envs.InputError, match=r"float64 \(4, 4, 3\), and no picture .* of integers from 0 to 255"):
        env.frame()


@pytest.mark.parametrize(
    ("kind", "why"),
    [
        ("render fails", r"fails in render \(.*toys.py, line \d+\) with ZeroDivisionError: no screen"),
        ("render is None", "its render gives NoneType, and no picture"),
        ("pictures grow", "must be of one size, and these have 4 x 4 and 4 x 5 and"),
    ],
)
def test_a_film_that_cannot_be_made(tmp_path: Path, kind: str, why: str) -> None:
    env = envs.make("pettingzoo:toy_odd", env_kwargs={"kind": kind}, pictures=True)
    team = SimpleNamespace(reset=lambda: None, act=lambda observations, info: info["action_mask"].argmax(2))
    assert re.search(f"There is no film: .*{why}", envs.film(env, team, 0, tmp_path / "film.gif"))


@pytest.mark.parametrize(("id", "variant"), [("OldGym-v0", "four values"), ("Unseeded-v0", "")])
def test_interfaces_of_gym(id: str, variant: str) -> None:
    """Gymnasium's wrappers stumble over them first."""
    with pytest.raises(
        envs.InputError, match=r"reset\(seed=..., options=...\) must return observations and a dict.*Error"
    ):
        env = envs.make(f"gymnasium:{id}", env_kwargs={"variant": variant})
        env.reset()
        env.step([[0, 0]])


def test_limits_of_other_types() -> None:
    assert envs.make("pettingzoo:toy_odd", env_kwargs='kind="numpy\'s limit"').episode_limit == 6


def test_images_of_bytes_become_fractions() -> None:
    """Bytes from 0 to 255, in three dimensions or two; neither other numbers nor vectors."""
    seen, spaces = {}, {}
    for kind in ("bytes", "fractions", "binary", "table", "high vector"):
        env = envs.make(
            "pettingzoo:toy_painted", env_kwargs={"kind": kind}, flatten_images=kind not in ("table", "high vector")
        )
        seen[kind], spaces[kind] = env.reset(seed=3)[0][0, 0], env.single_observation_space
    np.testing.assert_allclose(seen["bytes"], seen["fractions"])
    assert set(seen["bytes"].tolist()) == {0, 1}
    assert (seen["binary"] == 1).all() and (seen["table"] == 0.5).all() and (seen["high vector"] == 900).all()
    assert [float(space.high.max()) for space in spaces.values()] == [1, 1, 1, 1, 1000]  # type: ignore[attr-defined]


def test_the_wrapper_that_divides(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the how-to shows it."""
    page = (ROOT / "docs" / "how-to" / "use-pettingzoo-or-gymnasium.md").read_text(encoding="utf-8")
    block = re.search(r"```python\n(.*?)```", page, re.S)
    assert block
    (tmp_path / "a_divided_game.py").write_text(block[1])
    monkeypatch.chdir(tmp_path)
    options: Any = {"flatten_images": True, "env_kwargs": "max_cycles=5"}
    divided, plain = (envs.make(name, seed=1, **options) for name in ("pettingzoo:a_divided_game", PURSUIT))
    np.testing.assert_allclose(divided.reset()[0], plain.reset()[0] / 30, rtol=1e-6)
    step = [[1] * 8]
    np.testing.assert_allclose(divided.step(step)[0], plain.step(step)[0] / 30, rtol=1e-6)
    assert divided.episode_limit == plain.episode_limit == 5


@pytest.mark.slow
def test_a_team_learns_from_images_of_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    """In an episode of 20 steps, guessing earns 10 and the best team 20. Undivided bytes stay at 10 for so long."""
    options: Any = {"env_kwargs": "kind='bytes'", "flatten_images": True}
    learnt = trained(monkeypatch, "ippo", 100, "pettingzoo:toy_painted", learning_rate=0.001, **options)
    env = envs.make("pettingzoo:toy_painted", 50, seed=9, **options)
    team = script("ippo").Team(learnt.args, learnt.parts["agents"], torch.Generator().manual_seed(0))
    figure = runs.evaluate(env, team, 1)["return_mean"]
    print(f"mean return {figure:.1f}")
    assert figure > 15


def test_sides_without_teams_are_pointed_out() -> None:
    """Once; and not where the sides are known, or where all earn the same."""
    for options, warned in (({}, 1), ({"teams": True}, 0), ({"cooperative": True}, 0)):
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            env = envs.make("pettingzoo:toy_sides", 2, env_kwargs=options)
            for _ in range(2):
                env.reset()
                env.step([[0, 0, 0]] * 2)
        texts = [str(each.message) for each in said if "the number of each agent's team" in str(each.message)]
        assert len(texts) == warned and all("red_0 and blue_0 do not earn the same" in text for text in texts)


@pytest.mark.parametrize("workers", [0, 1])
def test_what_a_game_reports_at_the_end(workers: int) -> None:
    """Numbers only, of team 0, by names that a table of results does not have, and nothing of earlier episodes."""
    env = envs.make("pettingzoo:toy_odd", 2, env_kwargs={"kind": "reports"}, env_workers=workers)
    for _ in range(2):
        _, info = env.reset()
        assert info["statistics"] == {}
        totals = envs.EpisodeTotals(env)
        while not totals.ended.all():
            _, rewards, terminated, truncated, info = env.step([[0, 0, 0]] * 2)
            totals.add(rewards, terminated, truncated, info)
        means = totals.means()
        assert {name: means[name] for name in list(means)[-3:]} == {"won": 1, "score": 3, "info_seed": 5}
    env.close()


def test_bounds_wider_than_our_numbers() -> None:
    """Ours have 32 bits."""
    space = envs.make("pettingzoo:toy_odd", env_kwargs={"kind": "wide"}).single_observation_space
    assert isinstance(space, gymnasium.spaces.Box) and space.dtype == np.float32
    assert [float(space.low.min()), float(space.high.max())] == [-np.finfo(np.float32).max, np.finfo(np.float32).max]


def test_observations_are_neither_cut_nor_left_out() -> None:
    """Fractions in a space of integers, and a goal beside the observation."""
    observations, _ = envs.make("pettingzoo:toy_odd", env_kwargs={"kind": "half"}).reset()
    assert observations[0, 1].tolist() == [0.5, 1.5, 7.5]
    observations, _ = envs.make("pettingzoo:toy_odd", env_kwargs={"kind": "goal"}).reset()
    assert sorted(observations[0, 1].tolist()) == [0, 1, 7, 8]


def test_an_environment_that_goes_on_longer_than_it_seemed_to_say() -> None:
    env = envs.make("pettingzoo:toy_odd", env_kwargs={"kind": "wrong limit"})
    assert env.episode_limit == 3
    env.reset()
    env.step([[0, 0, 0]])
    env.step([[0, 0, 0]])
    with pytest.raises(envs.InputError, match="goes on after 3 steps"):
        env.step([[0, 0, 0]])
    cut = envs.make("pettingzoo:toy_odd", env_kwargs={"kind": "no limit"}, max_episode_steps=4)
    cut.reset()
    assert [bool(cut.step([[0, 0, 0]])[3][0]) for _ in range(4)] == [False, False, False, True]


@pytest.mark.parametrize(
    ("text", "kwargs"),
    [("", {}), ("N=2", {"N": 2}), ("a=1.5, b='x y',c=[1, 2], d=None", {"a": 1.5, "b": "x y", "c": [1, 2], "d": None})],
)
def test_keyword_arguments(text: str, kwargs: dict[str, Any]) -> None:
    assert parse_kwargs(text) == kwargs


@pytest.mark.parametrize("text", ["2", "N", "N=x", "N=2)+f(M=1", "**{}", "N=2; M=1", "N=__import__('os')"])
def test_what_is_no_keyword_argument(text: str) -> None:
    with pytest.raises(envs.InputError, match="is not like the arguments"):
        parse_kwargs(text)


# ---------------------------------------------------------------------------------------------------------------------
# The scripts
# ---------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("task", [SPREAD, LISTENER, PURSUIT, FORAGING, WAREHOUSE])
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.slow
def test_a_few_updates(monkeypatch: pytest.MonkeyPatch, name: str, task: str) -> None:
    few_updates(monkeypatch, name, task, True, max_episode_steps=10, flatten_images=task == PURSUIT)


@pytest.mark.parametrize("task", ["pettingzoo:toy_queue", "gymnasium:CartPole-v1"])
@pytest.mark.parametrize("name", NAMES)
def test_agents_who_leave_and_a_single_agent(monkeypatch: pytest.MonkeyPatch, name: str, task: str) -> None:
    """In the toy, teams oppose each other, unless they are told not to."""
    monkeypatch.setattr(Queue, "teams", {"a": 0, "b": 0, "c": 0})
    few_updates(monkeypatch, name, task, False)


@pytest.mark.parametrize(
    ("env", "family"),
    [(SPREAD, "mpe"), (FORAGING, "lbf"), (WAREHOUSE, "rware"), (PURSUIT, ""), ("own:examples.meeting_numpy", "")],
)
def test_hyperparameters_of_known_families(env: str, family: str) -> None:
    example = {"mpe": "mpe-spread", "lbf": "lbf-8x8-2p-2f-c", "rware": "rware-tiny-2p"}.get(family)
    assert envs.task(env).family == family
    ours, plain = parse("mappo", ["--env", env]), script("mappo").paper_defaults()
    if example is None:
        assert (ours.hidden_dim, ours.network, ours.total_timesteps) == (plain.hidden_dim, plain.network, 20_000_000)
    else:
        assert vars(ours) | {"env": example} == vars(parse("mappo", ["--env", example]))


@pytest.mark.slow
def test_killed_and_resumed_through_an_adapter(monkeypatch: pytest.MonkeyPatch, capsys: Any, tmp_path: Path) -> None:
    """kill -9 in the middle, with workers; the end is that of a run without workers which nothing interrupted."""
    flags: list[Any] = [
        "--env",
        SPREAD,
        "--total-timesteps",
        2500,
        "--eval-points",
        11,
        "--eval-episodes",
        4,
        "--hidden-dim",
        16,
    ]
    with monkeypatch.context() as patch:
        patch.setattr(signal, "signal", lambda number, handler: None)
        script("ippo").train(parse("ippo", [*flags, "--run-dir", str(tmp_path / "whole")]))
    process = programs.start(command("ippo", *flags, "--env-workers", 2, "--run-dir", tmp_path / "run"))
    table = tmp_path / "run" / "evaluations.csv"
    while not table.exists() or len(table.read_text().splitlines()) < 5:
        assert process.poll() is None
        time.sleep(0.02)
    process.kill()
    process.wait()
    assert len(evaluations(tmp_path / "run")) < 11
    assert main(monkeypatch, capsys, "ippo", *flags, "--run-dir", tmp_path / "run", "--resume") == (0, ANY)
    assert evaluations(tmp_path / "run") == evaluations(tmp_path / "whole")


@pytest.mark.skipif(not hasattr(os, "setsid"), reason="Windows has no SIGTERM for other processes")
@pytest.mark.slow
def test_a_run_whose_environment_hangs_can_be_stopped(tmp_path: Path) -> None:
    """By a second SIGTERM; the first one says so, and the workers end as well."""
    flags = ["--env", "pettingzoo:toy_broken", "--env-kwargs", "how='hangs'", "--env-workers", 2]
    flags += ["--individual-rewards", "--no-parameter-sharing", "--total-timesteps", 100, "--run-dir", tmp_path / "run"]
    with programs.start(command("ippo", *flags)) as process:
        assert process.stderr is not None
        assert "This run is kept in" in process.stderr.readline()
        time.sleep(1)
        process.send_signal(signal.SIGTERM)
        assert process.stderr.readline() == "Stopping after this batch; once more ends the process at once.\n"
        time.sleep(3.5)
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=30)  # the workers', too
    assert (process.returncode, said) == (143, "")


def test_flags_are_kept_and_watched(monkeypatch: pytest.MonkeyPatch, capsys: Any, tmp_path: Path) -> None:
    """--watch plays the environment with the keyword arguments of the run, and films the environment's own pictures."""
    flags: list[Any] = [
        "--env",
        SPREAD,
        "--env-kwargs",
        "N=2, max_cycles=5",
        "--total-timesteps",
        50,
        "--eval-points",
        2,
    ]
    flags += ["--eval-episodes", 2, "--run-dir", tmp_path / "run"]
    assert main(monkeypatch, capsys, "ippo", *flags)[0] == 0
    watch = ["--watch", tmp_path / "run", "--eval-episodes", 2]
    code, said = main(monkeypatch, capsys, "ippo", *watch)
    assert code == 2 and f"plays {SPREAD}, which is code of others; if you trust it, add --env {SPREAD}." in said
    assert main(monkeypatch, capsys, "ippo", *watch, "--env", SPREAD)[0] == 0
    assert (tmp_path / "run" / "film.gif").stat().st_size > 1000
    flags[3] = "N=3"
    code, said = main(monkeypatch, capsys, "ippo", *flags, "--resume")
    assert code == 2 and "was begun with --env-kwargs N=2, max_cycles=5" in said


def test_what_a_game_reports_becomes_columns(monkeypatch: pytest.MonkeyPatch, capsys: Any, tmp_path: Path) -> None:
    monkeypatch.setattr(Queue, "teams", {"a": 0, "b": 0, "c": 0})
    flags = ["--env", "pettingzoo:toy_odd", "--env-kwargs", "kind='reports'", "--total-timesteps", 60]
    flags += ["--eval-points", 2, "--eval-episodes", 2, "--run-dir", tmp_path / "run"]
    assert main(monkeypatch, capsys, "ippo", *flags)[0] == 0
    table = (tmp_path / "run" / "evaluations.csv").read_text().splitlines()
    assert table[0].endswith(",won,score,info_seed") and table[1].endswith(",1.0,3.0,5.0") and len(table) == 3


def untrained_team(name: str, env: envs.VectorEnv, sharing: bool = True) -> Any:
    """A team of a script with a GRU, as in its first step."""
    module = script(name)
    args = args_of(module, network="gru", hidden_dim=8, parameter_sharing=sharing)
    torch.manual_seed(0)
    agents = module.MultiAgentNetwork(args, env.n_agents, env.obs_size, env.n_actions, "gru")
    return module.Team(args, agents, torch.Generator().manual_seed(1))


@pytest.mark.parametrize("name", NAMES)
def test_a_team_takes_what_environments_give(name: str) -> None:
    """Masks of PettingZoo are int8, and many observations float64."""
    env = envs.make("smaclite-3m", 4)
    observations, info = env.reset()
    actions = untrained_team(name, env).act(observations, info)
    others = untrained_team(name, env).act(
        observations.astype(np.float64), {"action_mask": info["action_mask"].astype(np.int8)}
    )
    np.testing.assert_array_equal(actions, others)


@pytest.mark.parametrize("sharing", [True, False])
@pytest.mark.parametrize("name", NAMES)
def test_a_team_forgets_some_episodes(name: str, sharing: bool) -> None:
    """Those of a mask, in environments that reset by themselves."""
    env = envs.make("lbf-8x8-2p-2f", 3)
    observations, info = env.reset()
    team, fresh = untrained_team(name, env, sharing), untrained_team(name, env, sharing)
    team.reset(np.array([True, False, True]))  # there is nothing to forget yet
    for _ in range(3):
        team.act(observations, info)
    before = [state.unflatten(1, (3, -1)) for state in team.hidden]
    team.reset(np.array([False, True, False]))
    after = [state.unflatten(1, (3, -1)) for state in team.hidden]
    for old, new in zip(before, after):
        assert torch.equal(old[:, [0, 2]], new[:, [0, 2]]) and not new[:, 1].any() and old[:, 1].any()
    team.act(observations, info)
    fresh.act(observations, info)
    for mine, first in zip(team.hidden, fresh.hidden):
        torch.testing.assert_close(mine.unflatten(1, (3, -1))[:, 1], first.unflatten(1, (3, -1))[:, 1])


def change(observations: Any, info: Any, what: str) -> Any:
    """What a team is given, wrong in one way."""
    mask = info["action_mask"].copy()
    if what == "no numbers":
        observations = observations.copy()
        observations[2, 0, 1] = np.nan
    if what == "nothing allowed":
        mask[1, 0] = False
    if what == "additive":
        mask = np.where(mask, 0.0, -1e9)
    return {
        "no environments": (observations[0], {"action_mask": mask[0]}),
        "one mask for all": (observations, {"action_mask": mask[:1]}),
        "no axis of a mask": (observations, {"action_mask": mask[0]}),
        "an agent less": (observations[:, 1:], {"action_mask": mask[:, 1:]}),
        "other sizes": (observations[..., 1:], {"action_mask": mask}),
        "a list": (observations.tolist(), {"action_mask": mask}),
        "texts": (observations.astype(str), {"action_mask": mask}),
        "no mask": (observations, {}),
        "no info": (observations, mask),
        "other environments": (observations[:2], {"action_mask": mask[:2]}),
    }.get(what, (observations, {"action_mask": mask}))


@pytest.mark.parametrize("name", ["ippo", "iql"])
@pytest.mark.parametrize("sharing", [True, False])
@pytest.mark.parametrize(
    "what, said",
    [
        ("no environments", r"observations as an array of numbers, \[env, 3, 30\], and is given \[3, 30\]"),
        ("one mask for all", "observations of 4 environments and masks of 1"),
        ("no axis of a mask", r"\[env, 3, 9\], and is given \[3, 9\]"),
        ("an agent less", r"\[env, 3, 30\], and is given \[4, 2, 30\]"),
        ("other sizes", r"\[env, 3, 30\], and is given \[4, 3, 29\]"),
        ("a list", "and is given list"),
        ("texts", "and is given ndarray"),
        ("no mask", "and is given NoneType"),
        ("no info", "and is given NoneType"),
        ("no numbers", "observations that are no finite numbers"),
        ("nothing allowed", "must have 1 for what is allowed"),
        ("additive", "must have 1 for what is allowed"),
        ("other environments", r"has begun to play 4 environments, and is given 2; reset\(\) begins anew"),
    ],
)
def test_what_a_trained_team_is_given(name: str, sharing: bool, what: str, said: str) -> None:
    """One clear ValueError where actions would mean nothing."""
    env = envs.make("smaclite-3m", 4)
    observations, info = env.reset()
    network = (env.n_agents, env.obs_size, env.n_actions, "gru")
    team = runs.careful(untrained_team(name, env, sharing), {"network": network})
    team.act(observations, info)
    with pytest.raises(ValueError, match=said):
        team.act(*change(observations, info, what))
    np.testing.assert_array_equal(team.act(observations, info).shape, (4, 3))
    team.reset()
    team.act(observations[:2], {"action_mask": info["action_mask"][:2]})


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda team: pickle.loads(pickle.dumps(team))])
def test_a_copied_team_remembers_by_itself(duplicate: Any) -> None:
    env = envs.make("lbf-8x8-2p-2f", 2)
    observations, info = env.reset()
    network = (env.n_agents, env.obs_size, env.n_actions, "gru")
    team = runs.careful(untrained_team("iql", env), {"network": network})
    team.act(observations, info)
    before = team.hidden[0].clone()
    other = duplicate(team)
    other.act(observations, info)
    assert torch.equal(team.hidden[0], before) and not torch.equal(other.hidden[0], before)


def test_wrong_input_ends_with_code_2(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    code, said = main(monkeypatch, capsys, "qmix", "--env", "pettingzoo:toy_turns")
    assert code == 2 and "act in turn" in said and len(said.strip().splitlines()) == 1
    code, said = main(monkeypatch, capsys, "qmix", "--env", "lbf-8x8-2p-2f", "--env-workers", "4")
    assert code == 2 and "--env-workers" in said


@pytest.mark.parametrize("name", ["qmix", "ippo"])
def test_episodes_larger_than_the_memory(
    monkeypatch: pytest.MonkeyPatch, capsys: Any, tmp_path: Path, name: str
) -> None:
    """They are refused before anything is stored."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "toy_long.py").write_text("from toys import Painted as parallel_env\n")
    flags = ["--env", "pettingzoo:toy_long", "--env-kwargs", "kind='table'", "--max-episode-steps", 10**9]
    code, said = main(monkeypatch, capsys, name, *flags)
    assert code == 2 and "more than the free memory" in said and "--max-episode-steps makes" in said
    assert len(said.strip().splitlines()) == 1 and not (tmp_path / "runs").exists()


@pytest.mark.slow
def test_the_table_of_tasks() -> None:
    """It takes the flags that its sentences name."""

    def table(*words: str) -> Any:
        return programs.run([sys.executable, "-m", "envs", *words], cwd=ROOT)

    done = table(SPREAD, PURSUIT, "--flatten-images")
    assert done.returncode == 0 and SPREAD in done.stdout and PURSUIT in done.stdout
    done = table(PURSUIT)
    assert done.returncode == 2 and "--flatten-images makes vectors of them" in done.stderr

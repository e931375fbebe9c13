"""Games of others that misbehave: each works, or ends in one sentence. See tests/strangers.py."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from importlib.metadata import distributions
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import programs
import psutil
import pytest
import strangers
import torch
from gymnasium import spaces
from scripts import ROOT
from scripts import main as script_main

import envs.__main__
from envs import workers
from envs.adapters.observations import flattened
from envs.check import hints, problems
from envs.settings import Settings

SETTINGS = ["double", "no gradients", "folder", "raises"]  # that games make
SHORT = ["--total-timesteps", "20", "--eval-points", "2", "--eval-episodes", "2", "--hidden-dim", "8"]


@pytest.fixture(scope="module", autouse=True)
def games(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Modules with a parallel_env, in a folder that is the current one."""
    folder = tmp_path_factory.mktemp("games")
    for name in "Simulator Settles Exits Masked Sees Codes Continuous Odd Varied Hands Lingers".split():
        (folder / f"{name.lower()}.py").write_text(
            f"import sys\nsys.path.append({str(ROOT / 'tests')!r})\nfrom strangers import {name} as parallel_env\n"
        )
    reads = (
        "import argparse\nparser = argparse.ArgumentParser()\nparser.add_argument('--drones')\nparser.parse_args()\n"
    )
    (folder / "reads.py").write_text(reads + "import settles\nfrom strangers import Line as parallel_env\n")
    (folder / "leaves.py").write_text("import sys\nsys.exit()\n")
    for name in ("envs", "benchmark", "iql"):
        (folder / f"namesake_{name}.py").write_text(f"from {name} import world\n")
        (folder / f"namesake_{name}_world.py").write_text(f"import {name}.world\n")
    deaf = f"import sys\nsys.path.append({str(ROOT / 'tests')!r})\nimport signal\nfrom strangers import Line\n"
    deaf += "class parallel_env(Line):\n    def reset(self, seed=None, options=None):\n"
    deaf += "        signal.signal(signal.SIGTERM, signal.SIG_IGN)\n        return super().reset()\n"
    (folder / "deaf.py").write_text(deaf)
    quits = "import sys\nfrom envs.families.matrix import Env as Matrix\nclass Env(Matrix):\n"
    quits += "    def __init__(self, *given):\n        super().__init__(*given, payoffs=((0, 1), (1, 0)))\n"
    (folder / "quits.py").write_text(quits + "    def step(self, actions):\n        sys.exit()\n")
    moves = "import os, tempfile\nfrom envs import VectorEnv\nclass Env(VectorEnv):\n    def __init__(self, *_):\n"
    (folder / "moves.py").write_text(f"{moves}        os.chdir(tempfile.mkdtemp())\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(signal, "signal", lambda number, handler: None)
        yield


def command(name: str, game: str, *flags: object) -> list[str]:
    return [sys.executable, str(ROOT / "algos" / f"{name}.py"), "--env", f"pettingzoo:{game}", *SHORT, *map(str, flags)]


def run(name: str, game: str, *flags: object) -> subprocess.CompletedProcess[str]:
    return programs.run(command(name, game, *flags), timeout=120)


def play(game: str, steps: int = 1, num_envs: int = 1, **options: Any) -> envs.VectorEnv:
    """An environment after some steps with the first allowed actions."""
    env = envs.make(f"pettingzoo:{game}", num_envs, **options)
    env.reset()
    for _ in range(steps):
        env.step(env.action_mask.argmax(axis=2))
    return env


def refusal(game: str, **options: Any) -> str:
    with pytest.raises(envs.InputError) as refused:
        play(game, **options)
    return str(refused.value)


class TestClosing:
    @pytest.fixture
    def file(self, tmp_path: Path) -> Path:
        return tmp_path / "said"

    def all_closed(self, file: Path) -> bool:
        words = file.read_text().split()
        return words.count("built") == words.count("closed") > 0

    @pytest.mark.parametrize("name", [pytest.param("ippo", marks=pytest.mark.slow), "iql"])
    def test_a_training_and_watching(self, file: Path, tmp_path: Path, name: str) -> None:
        flags = ["--env-kwargs", f"file={str(file)!r}"]
        done = run(name, "simulator", *flags, "--run-dir", tmp_path / "run")
        assert done.returncode == 0 and self.all_closed(file), done.stderr
        assert done.stderr.splitlines()[-1].endswith(f"--watch {tmp_path / 'run'} --env pettingzoo:simulator")
        file.unlink()
        watched = [word for word in command(name, "simulator") if word not in SHORT]
        done = programs.run([*watched, "--eval-episodes", 2, "--watch", tmp_path / "run"], timeout=120)
        assert done.returncode == 0 and "film: " in done.stdout and self.all_closed(file), done.stderr

    @pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
    def test_after_an_error(self, file: Path, tmp_path: Path, workers: int) -> None:
        Path(f"{file}.fail").touch()
        flags = ["--env-kwargs", f"file={str(file)!r}", "--env-workers", workers, "--run-dir", tmp_path / "run"]
        done = run("ippo", "simulator", *flags)
        assert done.returncode == 2 and done.stderr.splitlines()[-1].startswith(
            "ippo: pettingzoo:simulator: the game's"
        )
        assert self.all_closed(file) and "Traceback" not in done.stderr

    def test_after_a_signal(self, file: Path, tmp_path: Path) -> None:
        flags = ["--env-kwargs", f"file={str(file)!r}", "--total-timesteps", "10000000", "--run-dir", tmp_path / "run"]
        with programs.start(command("ippo", "simulator", *flags)) as process:
            assert process.stderr is not None
            while "step 0" not in process.stderr.readline():
                assert process.poll() is None
            process.send_signal(signal.SIGTERM)
            process.communicate(timeout=60)
        assert process.returncode == 143 and self.all_closed(file)

    @pytest.mark.slow
    def test_check(self, file: Path) -> None:
        def make(num_envs: int, seed: int, copy: bool) -> envs.VectorEnv:
            return envs.make("pettingzoo:simulator", num_envs, seed, copy, env_kwargs={"file": str(file)})

        assert not problems(make) and hints(make) and self.all_closed(file)  # a hint that the two differ

    def test_a_game_that_cannot_be_played(self, file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(strangers.Simulator, "possible_agents", [])
        assert "has no agents" in refusal("simulator", env_kwargs={"file": str(file)}) and self.all_closed(file)

    @pytest.mark.slow
    def test_processes_of_games_in_workers(self, file: Path) -> None:
        """They may start some, and what a killed worker's games have started ends with it."""
        env = play("simulator", 2, 2, env_kwargs={"file": str(file), "how": "spawn"}, env_workers=2)
        env.close()
        assert self.all_closed(file)
        env = play("simulator", 2, 2, env_kwargs={"file": str(file)}, env_workers=2)
        Path(f"{file}.die").touch()
        with pytest.raises(envs.vector.WorkerLost, match=r"worker process \d was killed, perhaps since memory ran out"):
            for _ in range(4):
                env.step(np.zeros((2, 2), np.int64))

    @pytest.mark.slow
    def test_a_killed_worker_ends_a_run_with_its_own_code(self, file: Path, tmp_path: Path) -> None:
        """By which a campaign knows that it should try again."""
        Path(f"{file}.die").touch()
        flags = ["--env-kwargs", f"file={str(file)!r}", "--env-workers", 2, "--run-dir", tmp_path / "run"]
        done = run("ippo", "simulator", *flags)
        assert done.returncode == 137 and "Traceback" not in done.stderr
        assert done.stderr.splitlines()[-1].endswith("was killed, perhaps since memory ran out.")

    @pytest.mark.slow
    @pytest.mark.parametrize("what", ["thread", "process"])
    def test_what_a_game_leaves_behind(self, tmp_path: Path, what: str) -> None:
        """It does not keep a program from its end, nor from its exit code."""
        done = run("ippo", "lingers", "--env-kwargs", f"what={what!r}", "--run-dir", tmp_path / "run")
        assert done.returncode == 0 and "has started has not ended by itself: " in done.stderr.splitlines()[-1]

    def test_what_ends_in_time_is_not_named(self, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
        """A thread of a game that ends just before the program would be ended: the program ends by itself."""
        monkeypatch.setattr(workers, "PATIENCE", 0)
        monkeypatch.setattr(os, "_exit", lambda _: pytest.fail("the program was ended"))
        workers.wait_no_longer({*threading.enumerate()}, 1)
        assert capsys.readouterr().err == ""

    @pytest.mark.parametrize("how", ["exit", "close"])
    def test_check_says_how_an_own_environment_ends(self, how: str) -> None:
        from envs.families.matrix import Env

        class Ends(Env):
            def step(self, actions: Any) -> Any:
                return sys.exit() if how == "exit" else super().step(actions)

            def close_extras(self, **kwargs: Any) -> None:
                if how == "close":
                    raise RuntimeError("cannot close")

        found = problems(lambda n, seed, copy: Ends("own", n, seed, copy, payoffs=((0, 1), (1, 0))))
        assert len(found) == 1 and ("SystemExit" if how == "exit" else "RuntimeError: cannot close") in found[0]


class TestSettings:
    """Of the whole program: a game's hold while it plays, and ours outside."""

    @pytest.mark.parametrize("what", SETTINGS)
    @pytest.mark.parametrize("workers", [0, pytest.param(1, marks=pytest.mark.slow)])
    def test_they_are_the_games_own(self, what: str, workers: int) -> None:
        before = Settings.now()
        env = play("settles", 3, 2, env_kwargs={"what": what}, env_workers=workers)
        assert Settings.now() == before
        env.close()

    @pytest.mark.parametrize("what", SETTINGS)
    def test_also_where_a_step_sets_them(self, what: str) -> None:
        """Not all are looked at in each step, but all at the end of an episode."""
        before = Settings.now()
        env = play("settles", 5, env_kwargs={"what": what, "when": "step"})
        assert Settings.now() == before
        env.reset()
        env.step(np.zeros((1, 2), np.int64))
        assert Settings.now() == before

    @pytest.mark.parametrize("name", ["ippo", "iql"])
    @pytest.mark.parametrize("what", SETTINGS[:3])
    def test_a_run_goes_on_with_ours(self, tmp_path: Path, name: str, what: str) -> None:
        place = os.path.relpath(tmp_path / "run")
        done = run(name, "settles", "--env-kwargs", f"what={what!r}", "--run-dir", place)
        assert done.returncode == 0 and (tmp_path / "run" / "evaluations.csv").exists(), done.stderr

    def test_an_own_environment_may_not_move(self) -> None:
        before = os.getcwd()
        with pytest.raises(envs.InputError, match="own:moves changes the working directory"):
            envs.make("own:moves")
        assert os.getcwd() == before

    def test_check_looks_at_an_own_environment(self) -> None:
        from envs.families.matrix import Env

        class Silent(Env):
            def step(self, actions: Any) -> Any:
                torch.set_grad_enabled(False)
                return super().step(actions)

        found = problems(lambda n, seed, copy: Silent("own", n, seed, copy, payoffs=((0, 1), (1, 0))))
        assert torch.is_grad_enabled() and len(found) == 1 and "changes settings of the whole program" in found[0]


class TestEnds:
    """The program ends when the user, or the training, says so."""

    @pytest.mark.parametrize(
        "words, said", [(None, "SystemExit"), (0, "SystemExit: 0"), ("closed", "SystemExit: closed")]
    )
    @pytest.mark.parametrize("when", ["built", "reset", "step"])
    def test_a_game_that_ends_the_program(self, words: Any, said: str, when: str) -> None:
        sentence = refusal("exits", env_kwargs={"words": words, "when": when})
        assert "the game's own code fails" in sentence and f"with {said}" in sentence

    @pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
    def test_a_run_ends_with_2(self, tmp_path: Path, workers: int) -> None:
        done = run("iql", "exits", "--env-workers", workers, "--run-dir", tmp_path / "run")
        assert done.returncode == 2 and done.stderr.splitlines()[-1].endswith("with SystemExit")

    def test_a_module_that_ends_the_program(self) -> None:
        assert "fails when it is imported" in refusal("leaves")

    def test_a_module_that_reads_the_command_line(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """It finds nothing there."""
        monkeypatch.setattr(sys, "argv", ["mappo.py", "--env", "pettingzoo:reads"])
        play("reads").close()
        assert len(sys.argv) == 3

    def test_an_own_environment_that_ends_the_program(self, tmp_path: Path) -> None:
        done = run("ippo", "", "--env", "own:quits", "--run-dir", tmp_path / "run")
        assert done.returncode == 2 and "own:quits: its code ends the program (" in done.stderr

    @pytest.mark.slow
    def test_a_signal_that_a_game_takes_is_taken_back(self, tmp_path: Path) -> None:
        flags = ["--total-timesteps", 10**7, "--run-dir", tmp_path / "run"]
        with programs.start(command("ippo", "deaf", *flags)) as process:
            assert process.stderr is not None
            while "step 0" not in process.stderr.readline():
                assert process.poll() is None
            while process.poll() is None:  # it is deaf from a reset to the end of the batch
                process.send_signal(signal.SIGTERM)
                time.sleep(0.1)
            process.communicate(timeout=60)
        assert process.returncode == 143


class TestWhatIsHandedOn:
    @pytest.mark.parametrize("mask", [[0.0, -1e9], [2, 0], [0.5, 1], [np.nan, 1]])
    def test_numbers_that_are_no_mask(self, mask: Any) -> None:
        said = "must have 1 for what is allowed and 0 for what is not"
        assert said in refusal("masked", env_kwargs={"mask": mask})

    @pytest.mark.parametrize("mask", [[0, 1], [0.0, 1.0], [False, True], (0, 1)])
    def test_masks_of_any_type(self, mask: Any) -> None:
        env = play("masked", env_kwargs={"mask": mask})
        assert env.action_mask[0].tolist() == [[False, True]] * 2

    @pytest.mark.parametrize(
        "kind, value",
        [
            *(("discrete", value) for value in (0, 4, 1.5, "x")),
            *(("multi", value) for value in ([3, -1], [0, 4], [0.5, 0], [0], [np.nan, 0])),
            *(("binary", value) for value in ([0, 2], [0.5, 0], [1])),
            *(("nested", {"place": [0], "target": value}) for value in ([-1], [4], [1, 2], [])),
            ("nested", {"place": [0]}),
            ("tensor", None),
        ],
    )
    def test_values_outside_their_space(self, kind: str, value: Any) -> None:
        assert "an observation does not fit its space" in refusal("sees", env_kwargs={"kind": kind, "value": value})

    @pytest.mark.parametrize(
        "kind, value, seen",
        [
            ("discrete", 3.0, [0, 0, 1]),
            ("multi", [2.0, 0], [0, 0, 1, 1, 0, 0, 0]),
            ("multi", np.array([0, 3], np.int8), [1, 0, 0, 0, 0, 0, 1]),
            ("binary", [True, False], [1, 0]),
            ("nested", {"target": (np.float32(2),), "place": [0.5]}, [0.5, 0, 0, 1, 0]),
        ],
    )
    def test_values_count_and_not_their_types(self, kind: str, value: Any, seen: list[float]) -> None:
        env = play("sees", env_kwargs={"kind": kind, "value": value})
        assert env.observations[0].tolist() == [seen] * 2

    def test_the_order_is_gymnasiums(self) -> None:
        space = spaces.Dict(
            b=spaces.Tuple([spaces.MultiDiscrete([2, 3]), spaces.Box(-1, 1, (2, 2))]),
            a=spaces.MultiBinary([2, 2]),
            c=spaces.Discrete(4, start=-1),
            d=spaces.Text(3),
        )
        space.seed(1)
        for _ in range(20):
            value = space.sample()
            np.testing.assert_array_equal(flattened(space, value), np.asarray(spaces.flatten(space, value), np.float32))

    @pytest.mark.parametrize("most, warns", [(5, True), (20, True), (200, False), (0, False)])
    def test_images_of_codes(self, most: int, warns: bool) -> None:
        """They keep their values with a flag; `check` and a training say so."""
        options: Any = {"env_kwargs": {"most": most}, "flatten_images": True}
        found = hints(lambda n, seed, copy: envs.make("pettingzoo:codes", n, seed, copy, **options))
        assert any("`no_divide_images` leaves them" in hint for hint in found) == warns
        assert play("codes", divide_images=False, **options).observations.max() == most

    @pytest.mark.parametrize(
        "what, said",
        [
            ("same names", "has agents of the same name"),
            ("nobody plays", "has no agents in `agents` after its reset"),
            ("no list of agents", "must return two dictionaries by agent"),
            ("words as infos", "must return two dictionaries by agent"),
            ("nothing seen", "play on without an observation"),
            ("complex numbers", "it is of the type complex128"),
            ("texts", "it is of the type <U1"),
            ("texts as rewards", "'1' is no reward"),
            ("many actions", "are 2,097,152, and these algorithms choose among at most 1,048,576."),
        ],
    )
    def test_what_nobody_expects(self, what: str, said: str) -> None:
        assert said in refusal("hands", env_kwargs={"what": what})

    def test_observations_larger_than_the_memory(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Before their space is made."""
        monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=2**28))
        monkeypatch.setattr(spaces, "flatten_space", None)
        assert "does not fit into this machine's memory" in refusal("hands", env_kwargs={"what": "large observations"})

    @pytest.mark.parametrize("what", ["no close", "no metadata", "an empty dictionary", "its main program"])
    def test_what_is_no_obstacle(self, what: str) -> None:
        play("hands", env_kwargs={"what": what}).close()

    def test_numbers_and_names_that_results_cannot_have(self) -> None:
        env = play("hands", 5, env_kwargs={"what": "odd infos"})
        assert env.statistics == {"?": 1, "lost": 2}

    def test_a_warning_that_is_an_error(self) -> None:
        with warnings.catch_warnings(), pytest.raises(envs.InputError, match="`no_divide_images` leaves them"):
            warnings.simplefilter("error")
            play("codes", 5, flatten_images=True)

    def test_actions_are_numpys(self) -> None:
        assert play("odd", env_kwargs={"what": "items"}).rewards.tolist() == [0]

    def test_a_state_of_several_arrays(self) -> None:
        env = play("odd", env_kwargs={"what": "state"})
        assert env.state[0].tolist() == [1, 2, 3, 4] and not env.state_is_observations

    def test_a_state_that_is_none(self) -> None:
        with pytest.warns(UserWarning, match="its state is not an array of numbers, so the agents' observations take"):
            env = play("odd", env_kwargs={"what": "text"})
        assert env.state_is_observations

    def test_names_that_results_have(self, tmp_path: Path) -> None:
        done = run("ippo", "odd", "--env-kwargs", "what='infos'", "--run-dir", tmp_path / "run")
        assert done.returncode == 0, done.stderr
        with open(tmp_path / "run" / "evaluations.csv") as file:
            last = [*csv.DictReader(file)][-1]
        assert int(last["timestep"]) >= 20
        values = {"info_timestep": "7.0", "info_info_timestep": "8.0", "info_return": "9.0"}
        values |= {"info_commit": "1.0", "info_": "5.0", "won": "1.0", "a,b": "2.0"}
        assert values.items() <= last.items()


class TestSpaces:
    def test_combinations(self) -> None:
        """The last part changes first; each is what the game's space has."""
        env = envs.make("pettingzoo:masked", env_kwargs={"mask": None, "nvec": [2, 3]})
        assert env.choices == (6, 6)
        env.reset()
        for choice in range(5):
            env.step(np.array([[choice, 5 - choice]]))
        game: Any = env.games._here[0].env  # type: ignore[attr-defined]
        assert [action.tolist() for action in game.acted[:4]] == [[1, 1], [2, 3], [1, 2], [2, 2]]
        assert all(action in game.action_space("a") for action in game.acted)

    @pytest.mark.parametrize("mask", [([1, 0], [0, 1, 1]), [1, 0, 0, 1, 1], [0, 1, 1, 0, 0, 0], [[1, 0], [0, 1, 1]]])
    def test_masks_of_parts_are_multiplied_out(self, mask: Any) -> None:
        kept = mask if isinstance(mask[0], int) else tuple(mask)
        env = play("masked", env_kwargs={"mask": kept, "nvec": [2, 3]})
        assert env.action_mask[0].tolist() == [[False, True, True, False, False, False]] * 2

    def test_a_mask_that_may_be_of_two_kinds(self) -> None:
        said = refusal("masked", env_kwargs={"mask": [1, 1, 0, 1], "nvec": [2, 2]})
        assert "can be of 4 combinations or of as many values of their parts; a tuple with a mask for each part" in said
        env = play("masked", env_kwargs={"mask": ([1, 1], [0, 1]), "binary": 2})
        assert env.action_mask[0, 0].tolist() == [False, True, False, True]

    @pytest.mark.parametrize("mask", [[1], [1, 0, 1], ([1, 0], [1]), 3, "x", {"a": 1}])
    def test_masks_of_other_sizes(self, mask: Any) -> None:
        kept = mask if isinstance(mask, tuple) else np.array(mask)
        assert "has 6 actions and the action mask" in refusal("masked", env_kwargs={"mask": (kept,), "nvec": [2, 3]})

    def test_too_many(self) -> None:
        assert "are 2,048 combinations, and" in refusal("masked", env_kwargs={"mask": None, "binary": 11})
        assert "are about 10^30 combinations" in refusal("masked", env_kwargs={"mask": None, "binary": 100})
        said = refusal("continuous", env_kwargs={"dims": 5}, action_bins=5)
        assert "are 3,125 combinations, and these algorithms choose among at most 1,024; fewer `action_bins`" in said

    def test_continuous_actions_in_bins(self) -> None:
        env = play("continuous", 5, action_bins=3)
        env.reset()
        env.step(np.array([[0, 5]]))
        game: Any = env.games._here[0].env  # type: ignore[attr-defined]
        assert env.n_actions == 9
        assert [action.tolist() for action in game.acted[-2:]] == [[-1, -1], [0, 1]]
        assert game.acted[-1].dtype == np.float32

    def test_bins_where_they_make_no_sense(self) -> None:
        assert "has continuous actions" in refusal("continuous") and "`action_bins` makes of" in refusal("continuous")
        assert "finite bounds" in refusal("continuous", env_kwargs={"high": np.inf}, action_bins=2)
        assert "nothing to choose" in refusal("continuous", action_bins=1)
        assert "has no continuous actions" in refusal("odd", env_kwargs={"what": ""}, action_bins=2)

    @pytest.mark.parametrize("bins, choices", [(2, 32), (3, 243)])
    def test_simple_spread_in_bins(self, bins: int, choices: int) -> None:
        """Beside the package's own game: the same values lead to the same observations and rewards."""
        from mpe2 import simple_spread_v3

        kwargs = {"N": 2, "continuous_actions": True}
        env = envs.make("pettingzoo:mpe2.simple_spread_v3", env_kwargs=kwargs, action_bins=bins)
        observations, _ = env.reset(seed=3)
        theirs = simple_spread_v3.parallel_env(**kwargs)
        theirs.reset(seed=envs.vector.episode_seed(3, 0, 0))
        rng = np.random.default_rng(0)
        assert env.n_actions == choices
        for _ in range(10):
            chosen = rng.integers(choices, size=2)
            observations, _, _, _, info = env.step(chosen[None])
            digits = [[choice // bins**place % bins for place in range(4, -1, -1)] for choice in chosen.tolist()]
            values = np.array(digits, np.float32) / (bins - 1)
            seen, rewards, *_ = theirs.step(dict(zip(theirs.agents, values)))
            np.testing.assert_array_equal(observations[0], np.stack([*seen.values()]))
            np.testing.assert_array_equal(info["agent_rewards"][0], np.array([*rewards.values()], np.float32))

    def test_messages_of_a_warehouse(self) -> None:
        env = envs.make("gymnasium:rware:rware-tiny-2ag-v2", env_kwargs={"msg_bits": 1})
        env.reset()
        assert env.choices == (10, 10)
        env.step(np.array([[3, 9]]))


SPREAD, WAREHOUSE = "pettingzoo:mpe2.simple_spread_v3", "gymnasium:rware:rware-tiny-2ag-v2"
WHOLE: list[tuple[str, str, list[str]]] = [  # games, their arguments and flags
    *(("varied", f"what={what!r}", []) for what in ("one agent", "fifty agents", "one step", "one action")),
    *(("varied", f"what={what!r}", []) for what in ("many actions", "large rewards", "no observation", "starts at 1")),
    *(("varied", f"what={what!r}", []) for what in ("prints", "forks")),
    *(("settles", f"what={what!r}", []) for what in SETTINGS),
    *(("odd", f"what={what!r}", []) for what in ("items", "state", "text", "infos")),
    ("masked", "mask=([0, 1], [1, 0, 1]), nvec=[2, 3]", []),
    ("codes", "", ["--flatten-images", "--no-divide-images"]),
    ("sees", "kind='nested', value={'place': [0], 'target': [3]}", []),
]
REFUSED = [
    ("varied", "what='no number at last'", "is not a finite number"),
    ("masked", "mask=[0.0, -1e9]", "must have 1 for what is allowed and 0 for what is not"),
    ("exits", "", "with SystemExit"),
    ("sees", "kind='multi', value=[3, -1]", "does not fit its space"),
]


@pytest.mark.slow
class TestWholeRuns:
    """Short ones, in this process."""

    def run(self, monkeypatch: pytest.MonkeyPatch, name: str, *flags: object) -> object:
        """The exit code."""
        monkeypatch.setattr(sys, "argv", [f"{name}.py", *map(str, flags)])
        try:
            script_main(name)
        except SystemExit as end:
            return end.code
        return 0

    @pytest.mark.parametrize("how", ["check", "ippo", "iql"])
    @pytest.mark.parametrize("game, kwargs, flags", WHOLE)
    def test_what_is_odd(
        self,
        monkeypatch: pytest.MonkeyPatch,
        capsys: Any,
        tmp_path: Path,
        game: str,
        kwargs: str,
        flags: list[str],
        how: str,
    ) -> None:
        """The contract is kept, and a run comes to its end; that of IQL with worker processes."""
        words = [f"pettingzoo:{game}", "--env-kwargs", kwargs, *flags]
        if how == "check":
            assert envs.__main__.main(["check", *words]) == 0, capsys.readouterr().out
            return
        workers = 2 if how == "iql" else 0
        place = ["--run-dir", tmp_path / "run", "--env-workers", workers]
        code = self.run(monkeypatch, how, "--env", *words, *SHORT, "--total-timesteps", 500, *place)
        assert code == 0 and len((tmp_path / "run/evaluations.csv").read_text().splitlines()) == 3

    @pytest.mark.parametrize("name, workers", [("ippo", 0), ("ippo", 2), ("iql", 0), ("iql", 2)])
    @pytest.mark.parametrize("game, kwargs, said", REFUSED)
    def test_what_cannot_be_played(
        self,
        monkeypatch: pytest.MonkeyPatch,
        capsys: Any,
        tmp_path: Path,
        game: str,
        kwargs: str,
        said: str,
        name: str,
        workers: int,
    ) -> None:
        """One sentence and 2."""
        words = ["--env", f"pettingzoo:{game}", "--env-kwargs", kwargs, *SHORT, "--total-timesteps", 2000]
        place = ["--run-dir", tmp_path / "run", "--env-workers", workers]
        assert self.run(monkeypatch, name, *words, *place) == 2
        last = capsys.readouterr().err.splitlines()[-1]
        assert last.startswith(f"{name}: pettingzoo:{game}: ") and said in last

    @pytest.mark.parametrize("name", ["ippo", "iql"])
    @pytest.mark.parametrize(
        "task, kwargs, flags",
        [
            (SPREAD, "N=2, continuous_actions=True", ["--action-bins", 2]),
            (SPREAD, "N=2, continuous_actions=True", ["--action-bins", 3]),
            (WAREHOUSE, "msg_bits=1", ["--max-episode-steps", 20]),
        ],
    )
    def test_discretised_actions(
        self,
        monkeypatch: pytest.MonkeyPatch,
        tmp_path: Path,
        name: str,
        task: str,
        kwargs: str,
        flags: list[Any],
    ) -> None:
        """The name of the directory says how many values they have; --watch keeps them."""
        monkeypatch.chdir(tmp_path)
        words = ["--env", task, "--env-kwargs", kwargs, *SHORT, "--total-timesteps", 500, *flags]
        assert self.run(monkeypatch, name, *words) == 0
        found = next(tmp_path.glob("runs/*/*/seed0"))
        assert (f"action-bins={flags[1]}" in found.parent.name) == (task == SPREAD)
        assert self.run(monkeypatch, name, "--watch", found, "--env", task, "--eval-episodes", 2) == 0


class TestNames:
    @pytest.mark.parametrize("name", ["envs", "benchmark", "iql"])
    @pytest.mark.parametrize("how", ["", "_world"])
    def test_a_game_with_a_package_of_our_name(self, monkeypatch: pytest.MonkeyPatch, name: str, how: str) -> None:
        monkeypatch.syspath_prepend(ROOT / "algos")  # as for a script
        said = refusal(f"namesake_{name}{how}")
        assert f"the name `{name}` is this project's, so a package of the game needs another one" in said

    @pytest.mark.slow
    @pytest.mark.skipif(not list(distributions(name="marl-baselines")), reason="of an installation (pip install -e .)")
    @pytest.mark.parametrize("init", [True, False])
    def test_a_folder_envs_where_a_program_starts(self, tmp_path: Path, init: bool) -> None:
        """An installation finds our `envs.runs` also where their `envs` comes first, and that says what is wrong."""
        (tmp_path / "envs").mkdir()
        if init:
            (tmp_path / "envs" / "__init__.py").touch()
        script = tmp_path / "mine.py"
        script.write_text((ROOT / "algos" / "ippo.py").read_text())
        for words in (["-m", "envs", "check", "matrix-climbing"], [str(script), "--help"]):
            done = subprocess.run([sys.executable, *words], cwd=tmp_path, capture_output=True, text=True)
            if not init:  # ours is found first, since PYTHONPATH names it
                assert done.returncode == 0
                continue
            assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
            assert "takes the place of this project's package envs: rename it, or start elsewhere." in done.stderr


@pytest.mark.parametrize(
    "task, num_envs",
    [("'rware-large-20p-5s'", 10_000), ("'pettingzoo:varied', env_kwargs=\"what='many actions'\"", 10**7)],
)
def test_many_environments_take_no_memory_before_they_play(task: str, num_envs: int) -> None:
    """Observations have 650 MB and their spaces would have twice as much; or masks would fill any memory."""
    code = f"import envs\ntry:\n    envs.make({task}, num_envs={num_envs})\nexcept envs.InputError: pass\n"
    code += "print(open('/proc/self/status').read().split('VmHWM:')[1].split()[0])"  # `ru_maxrss` has its parent's, too
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(done.stdout) * 1024 < 2**30


def test_options_of_a_reset_that_are_none() -> None:
    env = envs.make("matrix-climbing")
    options: Any = [1]
    with pytest.raises(TypeError, match=r"options must be a dictionary"):
        env.reset(options=options)
    with pytest.raises(ValueError, match="at most 2"):
        envs.make("matrix-climbing", 2**63)

"""The random generator, the compiler's cache, and the rules without the compiler."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import envs
from envs.families.kernels import compiled, episode_state, forbidden_action, mix, random_below

PACKAGE = Path(envs.__file__).parent


def test_splitmix64_gives_the_published_numbers() -> None:
    """The first outputs for seed 1234567, as in the reference implementation's test vectors."""
    state, outputs = 1234567, []
    for _ in range(3):
        state = (state + 0x9E3779B97F4A7C15) % 2**64
        outputs.append(int(mix(np.uint64(state))))
    assert outputs == [6457827717110365317, 3203168211198807973, 9817491932198370423]


@pytest.mark.parametrize("bound", [1, 2, 5, 13, 100])
def test_integers_are_uniform(bound: int) -> None:
    random = np.zeros(1, np.uint64)
    random[0] = episode_state(np.uint64(1), 2, 3)
    number = 200_000
    drawn = np.array([random_below(random, 0, bound) for _ in range(number)])
    counts = np.bincount(drawn, minlength=bound)
    assert len(counts) == bound
    statistic = ((counts - number / bound) ** 2 / (number / bound)).sum()
    assert abs(statistic - (bound - 1)) <= 5 * np.sqrt(2 * (bound - 1))
    if bound > 1:  # no memory: neighbours in the stream are uncorrelated
        assert abs(np.corrcoef(drawn[:-1], drawn[1:])[0, 1]) < 5 / np.sqrt(number)


def test_episodes_start_at_states_of_their_own() -> None:
    states = {
        int(episode_state(np.uint64(seed), index, episode))
        for seed in (0, 1, 2, 2**63)
        for index in range(30)
        for episode in range(30)
    }
    assert len(states) == 4 * 30 * 30


def test_the_first_forbidden_action_is_found() -> None:
    mask = np.ones((2, 3, 4), np.bool_)
    actions = np.array([[0, 1, 3], [3, 2, 0]])
    assert forbidden_action(actions, mask) == -1
    mask[1, 1, 2] = False
    assert forbidden_action(actions, mask) == 4
    for wrong in (-1, 4):
        actions[0, 2] = wrong
        assert forbidden_action(actions, mask) == 2


def run(code: str, folder: Path, **environment: str) -> str:
    """What a fresh process prints that runs the code and imports the package from that folder."""
    inherited = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA_")}
    command = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(
        command, cwd=folder, env={**inherited, "PYTHONPATH": str(folder), **environment}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


STEP = """
import numpy as np, envs
env = envs.make("matrix-climbing", 1)
env.reset()
try:
    print("reward", *env.step([[1, 1]])[1])
except ValueError as error:
    print("refused", error)
"""


@pytest.mark.slow
def test_an_edited_rule_answers_in_the_next_process(tmp_path: Path) -> None:
    """Even if the file of the compiled loop that calls the rule stays the same."""
    shutil.copytree(PACKAGE, tmp_path / "envs", ignore=shutil.ignore_patterns("__pycache__"))
    home = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "HOME": str(tmp_path), "LOCALAPPDATA": str(tmp_path / "cache")}
    assert run(STEP, tmp_path, **home) == "reward 7.0\n"
    assert run(STEP, tmp_path, **home) == "reward 7.0\n"
    assert len(list(tmp_path.rglob("matrix.step_all*.nbc"))) == 1
    kernels = tmp_path / "envs" / "families" / "kernels.py"
    text = kernels.read_text()
    assert text.count("if action < 0 or") == 1
    kernels.write_text(text.replace("if action < 0 or", "if action == 1 or action < 0 or"))
    assert run(STEP, tmp_path, **home).startswith("refused")
    kernels.write_text(text)
    assert run(STEP, tmp_path, **home) == "reward 7.0\n"
    assert len(list(tmp_path.rglob("matrix.step_all*.nbc"))) == 2


@pytest.mark.slow
def test_only_an_edited_rule_is_compiled_again(tmp_path: Path) -> None:
    """A battle's loop and its walking are in two files. The mechanics of runs have nothing to do with either."""
    shutil.copytree(PACKAGE, tmp_path / "envs", ignore=shutil.ignore_patterns("__pycache__"))
    caches = "from envs.families import lbf\nfrom envs.families.smaclite import rules\n"
    caches += "print(lbf.step_all.stats.cache_path, rules.step_all.stats.cache_path)"

    def folders_after_an_edit(name: str) -> list[str]:
        with open(tmp_path / "envs" / name, "a") as file:
            file.write("# edited\n")
        home = {"XDG_CACHE_HOME": str(tmp_path), "HOME": str(tmp_path), "LOCALAPPDATA": str(tmp_path)}
        return run(caches, tmp_path, **home).split()

    lbf, battles = folders_after_an_edit("runs/log.py")
    for name in ("tasks.py", "vector.py", "adapters/foreign.py"):
        assert folders_after_an_edit(name) == [lbf, battles]
    lbf_again, battles_again = folders_after_an_edit("families/smaclite/walking.py")
    assert lbf_again == lbf and battles_again != battles
    lbf_again, battles = folders_after_an_edit("families/kernels.py")
    assert lbf_again != lbf and battles != battles_again


@pytest.mark.slow
def test_a_rule_of_ones_own_answers_in_the_next_process(tmp_path: Path) -> None:
    """The rule is in one file, the compiled loop that calls it in another."""
    loop = "from envs.families.kernels import compiled\nimport rule\nf = rule.f\n"
    loop += "@compiled\ndef loop(x):\n    return f(x) + 1\n"
    (tmp_path / "loop.py").write_text(loop)
    paths = os.pathsep.join([str(tmp_path), str(PACKAGE.parent)])
    for factor in (10, 100):
        text = f"from envs.families.kernels import compiled\n@compiled\ndef f(x):\n    return {factor} * x\n"
        (tmp_path / "rule.py").write_text(text)
        said = run(
            "import loop; print(loop.loop(2))", tmp_path, PYTHONPATH=paths, XDG_CACHE_HOME=str(tmp_path / "cache")
        )
        assert said == f"{2 * factor + 1}\n"


@pytest.mark.slow
def test_damaged_cache_files_are_replaced(tmp_path: Path) -> None:
    """As a power cut leaves them. An editor's lock file, which is a link to nowhere, does not matter either."""
    shutil.copytree(PACKAGE, tmp_path / "envs", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "envs" / "families" / ".#lbf.py").symlink_to("nobody@nowhere.1")
    home = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "HOME": str(tmp_path), "LOCALAPPDATA": str(tmp_path / "cache")}
    assert run(STEP, tmp_path, **home) == "reward 7.0\n"
    for ending in ("nbi", "nbc"):
        damaged = list(tmp_path.rglob(f"matrix.step_all*.{ending}"))
        assert len(damaged) == 1
        damaged[0].write_bytes(b"")
        assert run(STEP, tmp_path, **home) == "reward 7.0\n"
        assert damaged[0].stat().st_size > 0


@pytest.mark.skipif(sys.platform == "win32", reason="needs resource limits")
@pytest.mark.slow
def test_a_full_disk_costs_only_the_time_to_compile(tmp_path: Path) -> None:
    limit = "import resource, signal\nsignal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
    limit += "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
    assert run(limit + STEP, PACKAGE.parent, XDG_CACHE_HOME=str(tmp_path)) == "reward 7.0\n"
    assert not list(tmp_path.rglob("matrix.step_all*.nbc"))


def test_where_numba_finds_no_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    def njit(function: Any, cache: bool = False, **_: Any) -> Any:
        if cache:
            raise RuntimeError("cannot cache function 'f': no locator available for file 'f.py'")
        return "compiled"

    monkeypatch.setattr("envs.families.kernels.numba.njit", njit)
    assert compiled(lambda x: x) == "compiled"


@pytest.mark.slow
def test_the_users_own_cache_folder_is_respected(tmp_path: Path) -> None:
    run(STEP, PACKAGE.parent, NUMBA_CACHE_DIR=str(tmp_path / "own"), XDG_CACHE_HOME=str(tmp_path / "cache"))
    assert list((tmp_path / "own").rglob("matrix.step_all*.nbc"))
    assert not (tmp_path / "cache" / "marl-baselines").exists() or not list((tmp_path / "cache").rglob("*.nbc"))


@pytest.mark.skipif(sys.platform != "linux", reason="needs a folder that not even root can write")
@pytest.mark.slow
def test_a_home_that_cannot_be_written() -> None:
    assert run(STEP, PACKAGE.parent, XDG_CACHE_HOME="/proc/none", HOME="/proc/none") == "reward 7.0\n"


PLAY = """
import numpy as np, envs
for name in {names}:
    env = envs.make(name, 2, seed=9)
    env.reset()
    env.game.steps[:] = env.episode_limit - {steps} // 2
    rng = np.random.default_rng(0)
    for _ in range({steps}):
        actions = (rng.random(env.action_mask.shape) * env.action_mask).argmax(axis=2)
        observations, rewards, terminated, truncated, info = env.step(actions)
        sums = [array.sum(axis=-1).round(4).tolist() for array in (observations, info["state"], info["agent_rewards"])]
        flags, statistics = (terminated.tolist(), truncated.tolist()), list(info["statistics"].values())
        print(name, sums, rewards.round(4), flags, statistics)
        if (terminated | truncated).any():
            env.reset(options={{"reset_mask": terminated | truncated}})
try:
    env.step(np.full(actions.shape, 99))
except ValueError as error:
    print(error)
"""


@pytest.mark.parametrize(
    "names, steps",
    [
        (["lbf-6x7-3p-2f-2s", "rware-tiny-3p-2s", "mpe-speaker-listener", "mpe2-spread", "mpe2-tag-selfplay"], 60),
        (["mpe-adversary-selfplay", "mpe-adversary", "mpe-tag"], 4),  # networks in plain Python are slow
        (["smaclite-2s_vs_1sc", "smaclite-2s3z-sc2", "smaclite-MMM2"], 6),
    ],
)
@pytest.mark.slow
def test_the_rules_are_the_same_without_the_compiler(names: list[str], steps: int) -> None:
    """Half of the steps come before an end, half after a reset."""
    code = PLAY.format(names=names, steps=steps)
    plain = run(code, PACKAGE.parent, NUMBA_DISABLE_JIT="1")
    assert "sub-environment 0, agent 0: action 99 does not exist" in plain
    assert plain == run(code, PACKAGE.parent)

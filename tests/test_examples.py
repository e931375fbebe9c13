"""The programs of examples/ do what they say."""

import re
import subprocess
import sys
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import VectorWrapper
from scripts import ROOT, load_module

EXAMPLES = ROOT / "examples"


def test_gymnasium_ppo_learns(capsys):
    returned = load_module(EXAMPLES / "ppo_gymnasium.py").main(task="lbf-5x5-2p-1f", seed=1)
    printed = capsys.readouterr().out.splitlines()
    returns = [float(line.split()[-1]) for line in printed]
    assert returns[0] < 0.85 and returns[-1] == round(returned, 3) >= 0.95  # random agents return 0.71
    assert len(printed) < 100  # of 488 updates


def test_gymnasium_ppo_uses_up_its_budget(capsys):
    """In a task with forbidden actions."""
    returned = load_module(EXAMPLES / "ppo_gymnasium.py").main(task="mpe-speaker-listener", total_timesteps=3000)
    assert returned < 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["1,024", "2,048"]


class Misleading(VectorWrapper):
    """Pays a fortune in each step that does nothing but reset."""

    finished: Any = False

    def step(self, actions):
        observations, rewards, terminated, truncated, info = self.env.step(actions)
        rewards = rewards + 1000 * np.float32(self.finished)
        self.finished = terminated | truncated
        return observations, rewards, terminated, truncated, info


def test_gymnasium_ppo_learns_nothing_from_steps_that_reset(capsys, monkeypatch):
    example = load_module(EXAMPLES / "ppo_gymnasium.py")
    example.main(total_timesteps=5000, goal=2)
    expected = capsys.readouterr().out
    make_vec = gymnasium.make_vec
    monkeypatch.setattr(gymnasium, "make_vec", lambda *args, **options: Misleading(make_vec(*args, **options)))
    example.main(total_timesteps=5000, goal=2)
    assert capsys.readouterr().out == expected


@pytest.mark.parametrize("name", ["ppo_gymnasium"])
@pytest.mark.slow
def test_wrong_input_ends_in_one_sentence(name):
    command = [sys.executable, str(EXAMPLES / f"{name}.py"), "--task", "nothing"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == f"{name}: unknown task 'nothing'. `python -m envs` lists the tasks.\n"


def test_all_examples_compile():
    paths = sorted(EXAMPLES.glob("*.py"))
    assert {"ippo_torchrl.py", "ppo_gymnasium.py"} <= {path.name for path in paths}
    for path in paths:
        compile(path.read_text(), path, "exec")


def test_torchrl_for_a_few_steps(capsys):
    """Needs the library, which this project does not install."""
    pytest.importorskip("torchrl")
    main = load_module(EXAMPLES / "ippo_torchrl.py").main
    returned = main(task="lbf-5x5-2p-1f", total_timesteps=2048, eval_episodes=3)
    printed = capsys.readouterr().out
    assert re.fullmatch(rf"random team: mean return [01]\.\d+\ntrained team: mean return {returned:.3f}\n", printed)

"""The programs of examples/ do what they say."""

import re
import subprocess
import sys
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import VectorWrapper
from scripts import ROOT, load_module
from torch import nn

from envs.families import mpe

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


class Policy(nn.Module):
    """The policies of the paper's opponents, by the names that their files have."""

    def __init__(self, inputs: int, hidden: int):
        super().__init__()
        self.in_fn = nn.BatchNorm1d(inputs)
        self.fc1, self.fc2, self.fc3 = nn.Linear(inputs, hidden), nn.Linear(hidden, hidden), nn.Linear(hidden, 5)

    def forward(self, x):
        return self.fc3(self.fc2(self.fc1(self.in_fn(x)).relu()).relu())


def test_the_papers_opponents_are_converted(tmp_path, monkeypatch, capsys):
    """Files of the same keys as the authors'; the networks that come out act as those that went in."""
    torch.manual_seed(0)
    policies = {"adversary": [Policy(8, 12), *(Policy(10, 12) for _ in range(2))], "tag": [Policy(16, 20)] * 3}
    policies["tag"].append(Policy(14, 20))
    files = {}
    for scenario, agents in policies.items():
        for policy in agents:
            for _ in range(50):  # makes the normalisation matter
                policy(3 * torch.randn(100, policy.fc1.in_features) + 1)
            nn.init.normal_(policy.in_fn.weight)
            nn.init.normal_(policy.in_fn.bias)
        params = [{"policy": policy.eval().state_dict(), "critic": {}} for policy in agents]
        files[scenario] = tmp_path / f"{scenario}.pt"
        torch.save({"init_dict": {"gamma": 0.95}, "agent_params": params}, files[scenario])
    example = load_module(EXAMPLES / "paper_opponents.py")
    command = ["x", str(files["adversary"]), str(files["tag"]), "--output", str(tmp_path / "made")]
    monkeypatch.setattr(sys, "argv", command)
    example.main()
    printed = capsys.readouterr().out
    for scenario, agent in (("adversary", 0), ("tag", 3)):
        network = mpe.read_network(tmp_path / f"made/paper-{scenario}.npz", scenario)
        assert f"paper-{scenario}.npz: in results it is called {mpe.fingerprint(network)}" in printed
        policy = policies[scenario][agent]
        seen = torch.randn(200, policy.fc1.in_features)
        padded = nn.functional.pad(seen, (0, len(network.first_weight) - seen.shape[1])).numpy()
        hidden = np.maximum(padded @ network.first_weight + network.first_bias, 0)
        hidden = np.maximum(hidden @ network.core_weight + network.core_bias, 0)
        outputs = hidden @ network.last_weight + network.last_bias
        np.testing.assert_allclose(outputs, policy(seen).detach().numpy(), rtol=1e-4, atol=1e-5)
    monkeypatch.setattr(sys, "argv", [*command[:2], __file__, *command[3:]])
    with pytest.raises(SystemExit, match="2"):
        example.main()
    assert "is not the authors' file for tag, or is damaged." in capsys.readouterr().err


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

"""examples/mappo_yu.py: its GAE and its normalisation by hand, and what it has in common with algos/mappo.py."""

import ast
import sys
from dataclasses import replace

import pytest
import torch
from scripts import ROOT, load_module, script

PATH = ROOT / "examples/mappo_yu.py"
mappo_yu = load_module(PATH)

REWARDS = torch.tensor([[1.0], [2.0], [3.0]]).unsqueeze(-1).expand(-1, 3, -1)  # [time, env, 1]
VALUES = torch.tensor([10.0, 20.0, 30.0, 40.0])[:, None, None].expand(-1, 3, 1)
PLAYED = torch.tensor([[True, True, True], [True, True, True], [True, True, False]])
NO_BOOTSTRAP = torch.tensor([[False, False, False], [False, False, True], [False, True, True]])


def test_gae_by_hand():
    """gamma and lambda 1/2. A time-out after three steps, a real end after three, a real end after two."""
    advantages = mappo_yu.gae(REWARDS, VALUES, PLAYED, NO_BOOTSTRAP, 0.5, 0.5).squeeze(-1)
    last = 3 + 0.5 * 40 - 30
    assert advantages[:, 0].tolist() == [1 + 0.25 * (-3 + 0.25 * last), -3 + 0.25 * last, last]
    last = 3 - 30
    assert advantages[:, 1].tolist() == [1 + 0.25 * (-3 + 0.25 * last), -3 + 0.25 * last, last]
    assert advantages[:, 2].tolist() == [1 + 0.25 * (2 - 20), 2 - 20, 0]


@pytest.mark.parametrize("lam, n", [(0.0, 1), (1.0, 3)])
def test_gae_ends_in_the_returns_of_mappo(lam, n):
    """With lambda 0 those of one step, with 1 those of as many as there are."""
    returns = script("mappo").n_step_returns(REWARDS, VALUES, PLAYED, NO_BOOTSTRAP, 0.9, n)
    advantages = mappo_yu.gae(REWARDS, VALUES, PLAYED, NO_BOOTSTRAP, 0.9, lam)
    torch.testing.assert_close(advantages[PLAYED], (returns - VALUES[:-1])[PLAYED])


def test_values_are_normalised_by_the_returns_so_far():
    norm = mappo_yu.ValueNorm("cpu")
    assert [float(x) for x in norm.moments()] == [0, 1]
    norm.add(torch.tensor([2.0, 4.0]))
    assert [float(x) for x in norm.moments()] == pytest.approx([3, 1])
    norm.add(torch.tensor([9.0, 9.0]))
    old = 0.99 / 1.99  # the first batch's weight
    mean = old * 3 + (1 - old) * 9
    variance = old * 10 + (1 - old) * 81 - mean**2
    assert [float(x) for x in norm.moments()] == pytest.approx([mean, variance**0.5])


class Table(torch.nn.Module):
    """A network whose outputs are its parameters, whatever it sees."""

    def __init__(self, outputs):
        super().__init__()
        self.outputs = torch.nn.Parameter(outputs)  # [time, env, agent, output]

    def forward(self, x, hidden=None):
        return self.outputs[: len(x)], None


def test_the_critic_learns_normalised_returns_by_hand():
    """One agent, three steps and a time-out; gamma and lambda 1/2. The returns so far: mean 10, deviation 10."""
    value_norm = mappo_yu.ValueNorm("cpu")
    value_norm.add(torch.tensor([0.0, 20.0]))
    critic = Table(torch.tensor([1.0, 2.0, 3.0, 4.0]).reshape(4, 1, 1, 1))  # the values are 20, 30, 40 and 50
    parts = {"agents": Table(torch.zeros(4, 1, 1, 2)), "critic": critic, "value_norm": value_norm}
    for part in ("actor", "critic"):
        network = parts["agents" if part == "actor" else "critic"]
        parts[f"{part}_optimiser"] = torch.optim.Adam(network.parameters(), 0.001)
    batch = mappo_yu.Batch(
        observations=torch.zeros(4, 1, 1, 1),
        states=torch.zeros(4, 1, 1),
        action_masks=torch.ones(4, 1, 1, 2, dtype=torch.bool),
        actions=torch.zeros(3, 1, 1, dtype=torch.int64),
        rewards=torch.tensor([1.0, 2.0, 3.0]).reshape(3, 1, 1),
        played=torch.ones(3, 1, dtype=torch.bool),
        no_bootstrap=torch.zeros(3, 1, dtype=torch.bool),
    )
    args = replace(mappo_yu.paper_defaults(), gamma=0.5, gae_lambda=0.5, update_epochs=1, reward_standardisation=False)
    loss = mappo_yu.update(args, parts, batch, 1)["loss/critic"].item()
    last = 3 + 25 - 40
    middle = 2 + 20 - 30 + last / 4
    first = 1 + 15 - 20 + middle / 4
    returns = torch.tensor([20 + first, 30 + middle, 40 + last], dtype=torch.float64)
    assert returns.tolist() == [13.25, 19, 28]
    old = 0.99 / 1.99
    mean = old * 10 + (1 - old) * returns.mean()
    deviation = (old * 200 + (1 - old) * returns.square().mean() - mean**2).sqrt()
    errors = (returns - mean) / deviation - torch.tensor([1.0, 2.0, 3.0])
    assert loss == pytest.approx(errors.square().mean().item(), rel=1e-5)
    assert [float(x) for x in value_norm.moments()] == pytest.approx([float(mean), float(deviation)])


def test_a_batch_is_learned_with_normalised_advantages_and_values(monkeypatch, capsys, tmp_path):
    """A short training, with what `gae` gives scaled and shifted: the policies learn the same."""
    gae, made = mappo_yu.gae, []
    for scale in (1.0, 8.0):
        monkeypatch.setattr(mappo_yu, "gae", lambda *inputs, scale=scale: scale * gae(*inputs) + scale - 1)
        flags = ["--env", "lbf-5x5-2p-1f", "--total-timesteps", "100", "--eval-points", "1", "--seed", "3"]
        monkeypatch.setattr(sys, "argv", [str(PATH), *flags, "--run-dir", str(tmp_path / str(scale))])
        monkeypatch.setitem(sys.modules, "mappo_yu", mappo_yu)
        mappo_yu.runs.main(
            str(PATH), mappo_yu.__doc__, mappo_yu.Args, mappo_yu.paper_defaults, mappo_yu.train, mappo_yu.load
        )
        made.append(mappo_yu.load(tmp_path / str(scale)).agents.state_dict())
    assert made[0].keys() == made[1].keys() and len(made[0]) > 0
    for name in made[0]:
        torch.testing.assert_close(made[0][name], made[1][name], rtol=1e-3, atol=1e-5)


def test_what_has_the_name_of_a_piece_of_mappo_has_its_text():
    def pieces(path):
        text = path.read_text()
        return {
            node.name: ast.get_source_segment(text, node)
            for node in ast.parse(text).body
            if isinstance(node, ast.FunctionDef | ast.ClassDef)
        }

    ours, theirs = pieces(PATH), pieces(ROOT / "algos/mappo.py")
    different = [name for name in ours if name in theirs and ours[name] != theirs[name]]
    assert different == ["Args", "update", "train"]
    assert ours.keys() - theirs.keys() == {"ValueNorm", "gae"}

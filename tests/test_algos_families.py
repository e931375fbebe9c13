"""Every algorithm for a few updates where agents are unequal, or play against each other.

test_algos_first_updates.py has every family of tasks.
"""

import pytest
import torch
from scripts import INDIVIDUAL, NAMES, OFF_POLICY, trained


def few_updates(monkeypatch, name, task, sharing, **flags):
    """Two batches of one or two episodes; all figures are finite, and the agents have learned something."""
    flags |= {"hidden_dim": 8, "network": "gru", "reward_standardisation": True, "parameter_sharing": sharing}
    flags |= {"batch_size": 1, "buffer_size": 4} if name in OFF_POLICY else {"num_envs": 2}
    start = trained(monkeypatch, name, 0, task, **flags).parts["agents"].state_dict()
    run = trained(monkeypatch, name, 2, task, **flags)
    assert run.n_updates == 2
    for figure, value in run.metrics.items():
        assert torch.isfinite(value) or figure == "value/explained_variance", (task, figure)
    assert any(not torch.equal(x, start[parameter]) for parameter, x in run.parts["agents"].state_dict().items())
    return run


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.slow
def test_a_few_updates_of_unequal_agents(monkeypatch, name):
    for sharing in (True, False):
        few_updates(monkeypatch, name, "mpe-speaker-listener", sharing)


@pytest.mark.parametrize("name", INDIVIDUAL)
def test_a_few_updates_of_opposing_teams(monkeypatch, name):
    for task in ("mpe-adversary-selfplay", "mpe2-tag-selfplay"):
        run = few_updates(monkeypatch, name, task, False, individual_rewards=True)
        assert len(set(run.env.teams)) == 2

"""A trial run of each script on one task of each family: its first updates are those that were recorded.

Beside the recorded updates of EPyMARL this holds what comes before an update: first weights, draws, whole episodes, the
replay. `python tests/test_algos_first_updates.py` records anew, after a change that is meant to change them.
"""

import json

import pytest
import torch
from scripts import NINE, OFF_POLICY, ROOT, trained

RECORDED = ROOT / "tests" / "data" / "first_updates.json"
TASKS = ["matrix-climbing", "lbf-8x8-2p-2f", "mpe-spread", "rware-tiny-2p", "smaclite-2s_vs_1sc-sc2"]


def first_updates(monkeypatch, name, task):
    """The figures of the third update, and the mean size of each network's weights after it."""
    flags = {"batch_size": 2, "buffer_size": 8} if name in OFF_POLICY else {"num_envs": 2}
    run = trained(monkeypatch, name, 4 if name in OFF_POLICY else 3, task, seed=3, **flags)
    figures = {figure: value.item() for figure, value in run.metrics.items()}
    figures.pop("value/explained_variance", None)  # 1 minus a quotient, whose rounding it shows
    for part in ("agents", "critic", "mixer", "target_agents", "target_critic", "target_mixer"):
        if part in run.parts:
            weights = torch.cat([x.detach().flatten() for x in run.parts[part].parameters()])
            figures[f"weights/{part}"] = weights.abs().mean().item()
    return figures


@pytest.mark.skipif(not torch.backends.mkl.is_available(), reason="PyTorch draws exponential numbers otherwise here")
@pytest.mark.parametrize("name", NINE)
@pytest.mark.parametrize("task", [TASKS[0], *(pytest.param(task, marks=pytest.mark.slow) for task in TASKS[1:])])
def test_the_first_updates_are_those_recorded(monkeypatch, name, task):
    """As near as other processors round: one draw or one reward that differed would show in the first digits."""
    recorded = json.loads(RECORDED.read_text())[name][task]
    assert first_updates(monkeypatch, name, task) == pytest.approx(recorded, rel=1e-3, abs=1e-5)


def record() -> None:
    """Writes the recording."""
    with pytest.MonkeyPatch.context() as patch:
        found = {name: {task: first_updates(patch, name, task) for task in TASKS} for name in NINE}
    RECORDED.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    record()

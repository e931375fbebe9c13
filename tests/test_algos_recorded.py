"""Updates recorded with EPyMARL's own learners, replayed in the nine scripts (tests/data/updates/README.md)."""

import pytest
import torch
from scripts import NINE, ROOT, VALUE_BASED, load_module, script

exercise = load_module(ROOT / "examples/check_exercise.py")


@pytest.mark.parametrize("name", NINE)
@pytest.mark.parametrize("case", exercise.CASES)
@pytest.mark.slow
def test_five_updates_are_those_of_epymarl(name, case):
    """Weights after the first and the last update; losses and norms of the gradients in each."""
    with exercise.double_precision():
        quantities = [*exercise.replay(script(name), name, case)]
    for found in quantities:
        assert found.ours.dtype == torch.float64
        torch.testing.assert_close(found.ours, found.theirs, rtol=0.0, atol=found.tolerance)
        assert found.agrees()
    learners = 1 if name in VALUE_BASED else 2
    networks = {"iql": 2, "vdn": 2, "qmix": 4, "maddpg": 4}.get(name, 3)
    assert len(quantities) == 5 * 2 * learners + 2 * networks

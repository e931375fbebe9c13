"""The programs of examples/ do what they say."""

import subprocess
import sys

import pytest
from scripts import ROOT, load_module

EXAMPLES = ROOT / "examples"


def test_gymnasium_ppo_learns(capsys):
    returned = load_module(EXAMPLES / "ppo_gymnasium.py").main(task="lbf-5x5-2p-1f", seed=1)
    printed = capsys.readouterr().out.splitlines()
    assert returned >= 0.95 and printed[-1].endswith(f"returned {returned:.3f}")
    assert len(printed) < 100  # of 488 updates


def test_gymnasium_ppo_for_a_few_steps(capsys):
    """A task with forbidden actions and with state, and a budget that is used up."""
    returned = load_module(EXAMPLES / "ppo_gymnasium.py").main(task="mpe-speaker-listener", total_timesteps=3000)
    assert returned < 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["1,024", "2,048"]


@pytest.mark.parametrize("name", ["ppo_gymnasium"])
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
    assert printed.startswith("random team: mean return 0.") and f"trained team: mean return {returned:.3f}" in printed
    assert 0 <= returned <= 1

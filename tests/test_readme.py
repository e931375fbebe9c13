"""What the README shows works as it stands there."""

import re
import subprocess
import sys

import pytest
from scripts import ROOT

README = (ROOT / "README.md").read_text()
EXAMPLE = (ROOT / "examples" / "meeting_numpy.py").read_text()


def run(program, folder):
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=folder)


def blocks():
    """The README's Python programs: a trained team, one random episode, an environment, ours elsewhere."""
    return re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


def test_one_random_episode(tmp_path):
    done = run(blocks()[1], tmp_path)
    assert done.returncode == 0 and done.stdout.startswith("["), done.stderr


def test_the_trained_team_in_a_few_lines(tmp_path):
    flags = ["--env", "lbf-15x15-3p-5f", "--total-timesteps", "500", "--eval-points", "2", "--eval-episodes", "2"]
    trained = subprocess.run([sys.executable, str(ROOT / "algos/mappo.py"), *flags, "--seed", "1"], cwd=tmp_path)
    assert trained.returncode == 0
    program = blocks()[0].replace("/path/to/marl-baselines/algos", str(ROOT / "algos"))
    program = program.replace("/path/to/marl-baselines/", f"{tmp_path}/")
    lines = [line for line in program.splitlines() if line and "env =" not in line and "env.reset" not in line]
    assert len(lines) == 5  # as the README says, besides the two that make an environment
    done = run(program + "print(actions.shape)", tmp_path)
    assert done.stdout.strip() == "(4, 3)", done.stderr


@pytest.mark.parametrize("index", [3, 4])
def test_our_environments_in_your_code(index, tmp_path):
    done = run(blocks()[index], tmp_path)
    assert done.returncode == 0, done.stderr


def test_an_environment_in_30_lines(tmp_path):
    (tmp_path / "meeting.py").write_text(blocks()[2])
    checked = subprocess.run([sys.executable, "-m", "envs", "check", "own:meeting"], cwd=tmp_path, capture_output=True)
    assert checked.returncode == 0 and b"keeps the contract" in checked.stdout, checked.stderr
    lines = [line for line in blocks()[2].splitlines() if line]
    assert len(lines) <= 30
    without_types = re.sub(
        r": (int|bool|str|np\.\S+?)(?=[,)])|( -> None)|( {4}\"\"\".*\n)|(\"\"\"[^\"]*\"\"\"\n+)", "", EXAMPLE
    )
    assert without_types.split() == blocks()[2].split()  # the example has types and says what the game is


def test_links_lead_somewhere():
    links = re.findall(r"\]\((?!http)([^)#]+)\)", README)
    assert len(links) > 5
    assert all((ROOT / link).exists() for link in links)

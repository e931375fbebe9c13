"""What the READMEs and the pages of docs/how-to show works as it stands there."""

import importlib
import itertools
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
import tomllib
from functools import cache
from pathlib import Path

import pandas as pd
import programs
import pytest
from scripts import NAMES, ROOT, script

import envs
from envs import runs

HOW_TO = ROOT / "docs" / "how-to"
README = (ROOT / "README.md").read_text()
PAGES = [ROOT / "README.md", ROOT / "benchmark" / "README.md", ROOT / "docs" / "index.md", *sorted(HOW_TO.glob("*.md"))]
EXAMPLE = (ROOT / "examples" / "meeting_numpy.py").read_text()


def blocks(page):
    """A page's Python programs."""
    return re.findall(r"```python\n(.*?)```", page.read_text(), flags=re.DOTALL)


def run(*command, folder):
    return programs.run([sys.executable, *command], cwd=folder)


# ---------------------------------------------------------------------------------------------------------------------
# Programs
# ---------------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_trained_team_in_a_few_lines(tmp_path):
    flags = ["--env", "lbf-15x15-3p-5f", "--total-timesteps", "500", "--eval-points", "2", "--eval-episodes", "2"]
    trained = run(str(ROOT / "algos/mappo.py"), *flags, "--seed", "1", folder=tmp_path)
    assert trained.returncode == 0
    programs = blocks(HOW_TO / "evaluate-and-film-a-team.md")
    programs = [text.replace("/path/to/marl-baselines/algos", str(ROOT / "algos")) for text in programs]
    program, *others = (text.replace("/path/to/marl-baselines/", f"{tmp_path}/") for text in programs)
    lines = [line for line in program.splitlines() if line and "env =" not in line and "env.reset" not in line]
    assert len(lines) == 5  # as the page says, besides the two that make an environment
    done = run("-c", program + "print(actions.shape)", folder=tmp_path)
    assert done.stdout.strip() == "(4, 3)", done.stderr
    done = run("-c", "\n".join([program, *others]), folder=tmp_path)
    assert "'return_mean': " in done.stdout and len(others) == 2, done.stderr


@pytest.mark.parametrize("index", range(4))
@pytest.mark.slow
def test_our_environments_in_your_code(index, tmp_path):
    done = run("-c", blocks(HOW_TO / "use-pettingzoo-or-gymnasium.md")[index], folder=tmp_path)
    assert done.returncode == 0, done.stderr


def test_an_environment_in_30_lines(tmp_path):
    [program] = blocks(HOW_TO / "add-an-environment.md")
    (tmp_path / "meeting.py").write_text(program)
    checked = run("-m", "envs", "check", "own:meeting", folder=tmp_path)
    assert checked.returncode == 0 and "keeps the contract" in checked.stdout, checked.stderr
    assert len([line for line in program.splitlines() if line]) <= 30
    without_types = re.sub(
        r": (int|bool|str|np\.\S+?)(?=[,)])|( -> None)|( {4}\"\"\".*\n)|(\"\"\"[^\"]*\"\"\"\n+)", "", EXAMPLE
    )
    assert without_types.split() == program.split()  # the example has types and says what the game is


# ---------------------------------------------------------------------------------------------------------------------
# Commands
# ---------------------------------------------------------------------------------------------------------------------

BY_HAND = {".", "tensorboard", "sbatch", "git", "ray", "source", "cd", "head=$(hostname"}  # nothing here can try these


def commands():
    """Each command of each page once, with the comment behind it left out."""
    found = []
    for page in PAGES:
        text = page.read_text()
        shown = re.findall(r"```(?:bash|console)\n(.*?)```", text, flags=re.DOTALL)
        shown += re.findall(r"\n\n((?: {4}\S.*\n)+)", re.sub(r"```.*?```", "", text, flags=re.DOTALL))
        for line in "\n".join(shown).replace("\\\n", "").splitlines():
            line = line.strip().removeprefix("$ ")
            if inner := re.search(r"(?:cd marl-baselines && |-- +)(python benchmark/[^']*)", line):
                line = inner[1]  # what a cluster is told to run
            words = shlex.split(line, comments=True)
            for together, own in itertools.groupby(words, "&&".__eq__):
                if not together and (command := [*own]) not in found:
                    found.append(command)
    return found


def check_script(name, flags):
    """The flags are the script's, and there is such a task or such a team."""
    module = script("mappo" if name == "mine" else name)
    if "--help" in flags:
        flags.remove("--help")
    args = runs.parse_flags(module.Args, module.paper_defaults, flags, module.__doc__)
    envs.task(args.env)
    if args.watch.startswith("benchmark/"):
        assert json.loads((ROOT / args.watch / "config.json").read_text())["algorithm"] == name


@cache
def help_of(path):
    done = run(path, "--help", folder=ROOT)
    assert done.returncode == 0, done.stderr
    return done.stdout


def check_program(path, words):
    """The program has these flags, and behind -- those of a script; algorithms and tasks are there.

    What such a command does is tested in test_benchmark*.py; here it would take hours.
    """
    own, behind = words, []
    if "--" in words:
        own, behind = words[: words.index("--")], words[words.index("--") + 1 :]
    assert all(re.search(rf"{word}\b", help_of(path)) for word in own if word.startswith("--"))
    named = re.findall(r"--(algorithms|tasks) ((?:(?!--)\S+ ?)+)", " ".join(own))
    for kind, names in named:
        for name in names.split():
            if kind == "algorithms":
                assert name in (*NAMES, "all", "mine", "mine2")
            elif name not in ("all", "matrix", "mpe", "smac", "lbf", "rware"):
                envs.task(name)
    check_script("mappo", behind)


@pytest.mark.parametrize("words", commands(), ids=" ".join)
def test_commands(words, tmp_path):
    if "..." in words or any(word.startswith("<") for word in words):
        pytest.skip("to be filled in by the reader")
    check(words, tmp_path)


def check(words, folder):
    """A command does what it can do here in a short time; folder: one that is empty."""
    program, *rest = words
    if program == "python" and rest[0].startswith("algos/"):
        check_script(rest[0].removeprefix("algos/").removesuffix(".py"), rest[1:])
    elif program == "python" and rest[0].startswith("benchmark/"):
        check_program(rest[0], rest[1:])
    elif program == "python" and rest[:2] in (["-m", "venv"], ["-m", "pytest"]):
        assert all((ROOT / word).exists() for word in rest if word.startswith("tests/"))
    elif program == "python" and rest[:2] == ["-m", "envs"]:
        [meeting] = blocks(HOW_TO / "add-an-environment.md")
        (folder / "meeting.py").write_text(meeting)
        done = run(*rest, folder=folder)
        assert done.returncode == 0, done.stderr
    elif program == "pip" and rest[:2] == ["install", "-e"]:
        extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
        assert all(extra in extras for extra in re.findall(r"\[(\w+)\]", rest[2]))
    elif program in ("diff", "cp"):
        assert all((ROOT / word).exists() for word in rest if word.startswith("algos/") and "mine" not in word)
    else:
        assert program in BY_HAND or words[:2] == ["pip", "install"], "nobody tries this command"


@pytest.mark.slow
def test_the_two_lines_set_everything_up(tmp_path):
    """As they stand there, but for the index with PyTorch's build. That the packages are here already spares pip to
    fetch them. The training is short, and there is one test; .ci/run has the whole line with all packages."""
    for folder in ("algos", "envs"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "tests").mkdir()
    for file in ("pyproject.toml", "README.md", "LICENSE", "tests/conftest.py"):
        shutil.copy(ROOT / file, tmp_path / file)
    (tmp_path / "tests" / "test_task.py").write_text(
        "import envs\n\n\ndef test_task():\n    envs.make('lbf-5x5-2p-1f')\n"
    )
    lines = re.findall("^    (python -m venv .*)", README, flags=re.MULTILINE)
    paths = os.pathsep.join(path for path in sys.path if "site-packages" in path)
    for line, shown in zip(lines, ("return_mean", " passed"), strict=True):
        line = line.replace("--extra-index-url https://download.pytorch.org/whl/cpu ", "").replace("400000", "4000")
        variables = os.environ | {"PIP_NO_DEPS": "1", "PYTHONPATH": paths}
        done = subprocess.run(["bash", "-c", line], cwd=tmp_path, env=variables, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert shown in done.stdout + done.stderr and (tmp_path / ".venv").exists()


@pytest.mark.slow
def test_the_small_comparison_runs_as_it_is_written(tmp_path):
    """The three commands of the page, in a copy of the programs, with shorter trainings."""
    for folder in ("algos", "benchmark"):
        unneeded = shutil.ignore_patterns("results", "teams", "figures", "searches", "__pycache__")
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=unneeded)
    page = (HOW_TO / "compare-fairly.md").read_text().partition("## Compare your algorithm")[2]
    [small, *_] = re.findall(r"```bash\n(.*?)```", page, flags=re.DOTALL)
    small = small.replace("--total-timesteps 200000", "--total-timesteps 600 --eval-points 2 --eval-episodes 2")
    assert "600" in small
    copy, train, report = (shlex.split(line) for line in small.replace("\\\n", "").splitlines())
    assert copy[0] == "cp"
    shutil.copy(tmp_path / copy[1], tmp_path / copy[2])
    for _, *command in (train, report):
        done = subprocess.run([sys.executable, *command], capture_output=True, text=True, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    told = (tmp_path / "my-report" / "RESULTS.md").read_text()
    assert "MINE" in told and "MAPPO" in told


# ---------------------------------------------------------------------------------------------------------------------
# The pages
# ---------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", ["README.md", "benchmark/README.md", "CONTRIBUTING.md"])
def test_links_lead_somewhere(page):
    """Those of the site's pages are followed where it is built."""
    text = (ROOT / page).read_text()
    links = re.findall(r"\]\((?!http)([^)#]+)", text)
    assert all((ROOT / page).parent.joinpath(link).exists() for link in links)


def test_the_readme_is_read_in_two_minutes():
    """At 300 words a minute; the table of results is looked at, not read."""
    text = re.sub("<!-- results: begin.*results: end -->", "", README, flags=re.DOTALL)
    assert len([word for word in text.split() if any(map(str.isalnum, word))]) <= 600  # tables have bars, too


@pytest.mark.parametrize(
    "first, second, lines", re.findall(r"diff -b algos/(\w+).py algos/(\w+).py.*: (\d+) lines", README)
)
def test_the_lines_that_a_diff_shows(first, second, lines):
    """New lines of code, besides the description, the hyperparameters and the flags."""
    code = [(ROOT / "algos" / f"{name}.py").read_text().partition("# --- networks")[2] for name in (first, second)]
    before, after = ({line.strip() for line in text.splitlines() if "#" not in line.strip()[:1]} for text in code)
    assert len(after - before) == int(lines)


@pytest.mark.slow
def test_the_paper_run_again():
    """Every figure of the pages, made anew by one process."""
    program = """
        import json
        import paper_run_again as tool
        texts = {str(page): page.read_text(encoding="utf-8") for page in tool.PAGES}
        print(json.dumps({page: [text, tool.filled(text)] for page, text in texts.items()}))
    """
    done = run("-c", textwrap.dedent(program), folder=ROOT / "tools")
    assert done.returncode == 0, done.stderr
    pages = json.loads(done.stdout)
    assert {Path(page).stem for page in pages} >= {"paper-run-again", "maddpg", "claims"}
    for page, (there, made) in pages.items():
        assert there.splitlines() == made.splitlines(), page


@pytest.mark.slow
def test_the_words_of_a_team(tmp_path):
    """Of a run directory: what its team earns for each goal, and the shares of the three words there."""
    flags = ["--env", "mpe-speaker-listener", "--total-timesteps", "500", "--eval-points", "1", "--eval-episodes", "2"]
    trained = run(str(ROOT / "algos/ia2c.py"), *flags, "--run-dir", "run", folder=tmp_path)
    assert trained.returncode == 0, trained.stderr
    done = run(str(ROOT / "tools/paper_run_again.py"), "words", "run", folder=tmp_path)
    assert re.match(r"ia2c: return -\d+\.\d; goal 1: ", done.stdout), done.stderr
    goals = done.stdout.split("; ")[1:]
    assert len(goals) == 3
    for goal in goals:
        shares = [int(share) for share in re.findall(r"(\d+) %", goal)]
        assert len(shares) == 3 and 98 < sum(shares) < 102  # each is rounded


def test_the_test_that_was_planned_waits_for_all_its_seeds(monkeypatch, capsys):
    """Then it prints each seed's count and that of seeds 1 to 4, of seeds that are made up: the last is the lowest."""
    monkeypatch.syspath_prepend(ROOT / "tools")
    tool = importlib.import_module("paper_run_again")
    curve = pd.DataFrame({seed: [0.0, 100.0 - 60 * seed] for seed in range(5)})
    monkeypatch.setattr(tool, "ours", lambda task, algorithm: curve.iloc[:, : 4 + (algorithm != "coma")])
    tool.new_seeds()
    waits, others = capsys.readouterr().out.splitlines()
    assert waits.endswith("seeds 1 to 4 are there in 8 of 9 cells; the test waits for all") and "24 of 27" in others
    monkeypatch.setattr(tool, "ours", lambda task, algorithm: curve)
    tool.new_seeds()
    lines = capsys.readouterr().out.splitlines()[:6]
    assert [line.split(": ")[1].split(",")[0] for line in lines] == [
        "9 of 9 above the paper's",  # averages of 50, 20, -10, ...
        "9 of 9 above the paper's",
        *4 * ["0 of 9 above the paper's"],
    ]
    assert "seeds 1 to 4 alone" in lines[-1] and lines[-1].endswith("p = 0.00")

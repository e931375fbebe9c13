"""What others have made is looked at, and neither run nor believed: teams, runs, what lies in their folders."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import programs
import pytest
import torch
from scripts import ROOT, script
from scripts import main as script_main

from benchmark import store
from envs import InputError, runs
from envs.runs import valid

Saved = dict[str, Any]
SHORT = ["--env", "matrix-climbing", "--total-timesteps", "250", "--eval-points", "2", "--eval-episodes", "2"]


@pytest.fixture(scope="module")
def good(made_once: Callable[..., Path]) -> Path:
    """A run of MAPPO's, complete."""

    def train(place: Path) -> None:
        words = [sys.executable, ROOT / "algos/mappo.py", *SHORT, "--hidden-dim", "8", "--run-dir", place]
        assert programs.run(words).returncode == 0
        (place / "lock").unlink()
        (place / "checkpoint.previous.pt").unlink()

    return made_once("good-run", train)


@pytest.fixture
def gift(good: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy, as somebody else gives it away; `victim` lies beside it, and the current folder has code of theirs."""
    (tmp_path / "victim").write_text("mine")
    shutil.copytree(good, tmp_path / "gift")
    (tmp_path / "evil.py").write_text("open('ran', 'w')\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(signal, "signal", lambda number, handler: None)
    return tmp_path / "gift"


def change(gift: Path, alter: Callable[[Saved], object]) -> None:
    """Writes the checkpoint again, after something was done to it."""
    saved = torch.load(gift / "checkpoint.pt", weights_only=True)
    alter(saved)
    torch.save(saved, gift / "checkpoint.pt")


def mappo(monkeypatch: pytest.MonkeyPatch, capsys: Any, *flags: object) -> tuple[object, str]:
    """The exit code, and what it says on stderr."""
    monkeypatch.setattr(sys, "argv", ["mappo.py", *map(str, flags)])
    code: object = 0
    try:
        script_main("mappo")
    except SystemExit as end:
        code = end.code
    return code, capsys.readouterr().err


@pytest.mark.parametrize("name", ["own:evil", "pettingzoo:evil", "gymnasium:evil:evil-v0"])
def test_a_team_names_no_code(gift: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any, name: str) -> None:
    change(gift, lambda saved: saved["config"]["flags"].update(env=name))
    monkeypatch.delitem(sys.modules, "evil", raising=False)
    code, said = mappo(monkeypatch, capsys, "--watch", gift)
    assert code == 2 and f"plays {name}, which is code of others; if you trust it, add --env {name}." in said
    another = ["--watch", gift, "--env", "matrix-climbing", "--eval-episodes", 1]
    for flags in (another, [*SHORT, "--start-from", gift, "--run-dir", "run"]):
        mappo(monkeypatch, capsys, *flags)
    assert not Path("ran").exists()
    assert mappo(monkeypatch, capsys, "--watch", gift, "--env", name)[0] == 2  # trusted: the module has no environment
    assert Path("ran").exists()


def test_a_team_starts_no_processes(gift: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    """How many play is a flag of the command line: for this task there are none, as a run of it would say."""
    change(gift, lambda saved: saved["config"]["flags"].update(env_workers=3))
    assert mappo(monkeypatch, capsys, "--watch", gift, "--eval-episodes", 2)[0] == 0


@pytest.mark.parametrize("name", ["film.gif", "episodes.csv", "episodes.csv.new"])
def test_watching_follows_no_links(gift: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any, name: str) -> None:
    (gift / name).symlink_to("../victim")
    assert mappo(monkeypatch, capsys, "--watch", gift, "--eval-episodes", 1)[0] == 0
    assert Path("victim").read_text() == "mine" and not (gift / name).is_symlink()


@pytest.mark.parametrize("name", ["lock", "progress.json", "checkpoint.new.pt", "replay.bin", "evaluations.csv.new"])
def test_a_run_goes_on_beside_no_links(gift: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any, name: str) -> None:
    (gift / name).symlink_to("../victim")
    words = [*SHORT, "--hidden-dim", 8, "--run-dir", gift, "--resume"]
    code, said = mappo(monkeypatch, capsys, *words)
    assert code == 2 and f"holds a symbolic link, '{name}'" in said and Path("victim").read_text() == "mine"


@pytest.mark.parametrize("name", ["..", ".", "", "../..", "../victim", "/tmp/x"])
def test_results_stay_in_their_folder(gift: Path, name: str) -> None:
    config = json.loads((gift / "config.json").read_text())
    config["flags"]["env"] = name
    (gift / "config.json").write_text(json.dumps(config))
    table = store.collect(gift, Path("results"))
    assert table.resolve().parents[1] == Path("results").resolve() and table.exists()
    assert {path.name for path in Path().iterdir()} == {"victim", "gift", "evil.py", "results"}


def doubled(times: int) -> Any:
    """A list that is short in a pickle, and has 2 ** times parts when it is written."""
    value: Any = ["x"]
    for _ in range(times):
        value = [value, value]
    return value


def recast(weights: Saved, dtype: torch.dtype) -> Saved:
    """Weights as numbers of another type."""
    return {name: x.to(dtype) for name, x in weights.items()}


def state(saved: Saved) -> Saved:
    """What an optimiser keeps of the first weights."""
    return saved["parts"]["critic_optimiser"]["state"][0]


def group(saved: Saved) -> Saved:
    """The settings of an optimiser."""
    return saved["parts"]["critic_optimiser"]["param_groups"][0]


MALFORMED: dict[str, Callable[[Saved], object]] = {
    "no parts": lambda saved: saved.pop("parts"),
    "parts without agents": lambda saved: saved.update(parts={}),
    "parts of another kind": lambda saved: saved.update(parts=[1]),
    "agents of another kind": lambda saved: saved["parts"].update(agents=3),
    "rows that are a number": lambda saved: saved.update(rows=7),
    "a row of another kind": lambda saved: saved.update(rows=[{"point": "0"}]),
    "no flags": lambda saved: saved["config"].update(flags={}),
    "a task that is a number": lambda saved: saved["config"]["flags"].update(env=5),
    "a size that is a word": lambda saved: saved["config"]["flags"].update(hidden_dim="8"),
    "a huge network": lambda saved: saved["config"]["flags"].update(hidden_dim=10**9),
    "a large network": lambda saved: saved["config"]["flags"].update(hidden_dim=16_384),
    "very many agents": lambda saved: saved.update(network=(10**9, 2, 3, "fc")),
    "sizes below 0": lambda saved: saved.update(network=(-1, 2, 3, "fc")),
    "seconds that are words": lambda saved: saved.update(seconds={"wall_seconds": "x", "cpu_seconds": 0.0}),
    "what is nested deeply": lambda saved: saved["config"].update(x=json.loads("[" * 99 + "]" * 99)),
    "what grows when it is written": lambda saved: saved["config"].update(x=doubled(40)),
    "what cannot be written": lambda saved: saved["config"].update(x="\ud800"),
    "weights that are not there": lambda saved: saved["parts"].update(x={"w": torch.zeros(1).expand(10**6, 10**6)}),
    "weights that are no numbers": lambda saved: [w.fill_(torch.nan) for w in saved["parts"]["agents"].values()],
    "a tensor as a setting": lambda saved: saved["config"].update(x=torch.zeros(2)),
    "complex weights": lambda saved: saved["parts"].update(agents=recast(saved["parts"]["agents"], torch.complex64)),
}
FOR_RESUME: dict[str, Callable[[Saved], object]] = {
    "a budget of 0": lambda saved: saved.update(budget=0),
    "a budget that is a word": lambda saved: saved.update(budget="250"),
    "an episode too large": lambda saved: saved.update(episode=2**80),
    "no random numbers": lambda saved: saved.pop("rng"),
    "random numbers of another size": lambda saved: saved.update(rng=torch.zeros(3, dtype=torch.uint8)),
    "an optimiser of another kind": lambda saved: saved["parts"].update(actor_optimiser={"state": 3}),
    "evaluations all the time": lambda saved: saved.update(budget=1, rows=saved["rows"][:1], timestep=0),
    "evaluations that were left out": lambda saved: saved.update(budget=10),
    "evaluations out of order": lambda saved: saved["rows"].reverse(),
    "an evaluation before its point": lambda saved: saved["rows"][1].update(timestep=249),
    "an evaluation in the future": lambda saved: saved["rows"][1].update(timestep=251),
    "a value in the place of a state": lambda saved: state(saved).update(exp_avg=1.0),
    "a state of another shape": lambda saved: state(saved).update(exp_avg=torch.zeros(2, 2)),
    "a state of another type": lambda saved: state(saved).update(exp_avg=state(saved)["exp_avg"].double()),
    "a state that is no number": lambda saved: state(saved)["exp_avg"].fill_(torch.nan),
    "a state below 0": lambda saved: state(saved)["exp_avg_sq"].fill_(-1.0),
    "a step below 0": lambda saved: state(saved)["step"].fill_(-1.0),
    "a part of a state": lambda saved: state(saved).pop("exp_avg"),
    "a state of other weights": lambda saved: saved["parts"]["critic_optimiser"]["state"].update({99: {}}),
    "a learning rate that is no number": lambda saved: group(saved).update(lr="0.1"),
    "a learning rate that is infinite": lambda saved: group(saved).update(lr=torch.inf),
    "weights of an optimiser's own": lambda saved: group(saved).update(params=[0]),
}
FOR_MORE_TRAINING: dict[str, Callable[[Saved], object]] = {  # a team at play does not need it
    "a critic that is no number": lambda saved: saved["parts"]["critic"]["networks.0.last.bias"].fill_(torch.inf),
    "a critic of another kind": lambda saved: saved["parts"]["critic"].update({"networks.0.last.bias": 1}),
}


@pytest.mark.parametrize("what", [*MALFORMED, *FOR_RESUME, *FOR_MORE_TRAINING])
def test_malformed_checkpoints(gift: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any, what: str) -> None:
    """One sentence, whatever one wants to do with them."""
    change(gift, (MALFORMED | FOR_RESUME | FOR_MORE_TRAINING)[what])
    uses: list[list[Any]] = []
    if what != "very many agents":  # of no matter there
        uses.append([*SHORT, "--hidden-dim", 8, "--run-dir", gift, "--resume"])
    if what in MALFORMED:
        uses.append(["--watch", gift])
    if what not in FOR_RESUME and what not in ("a large network", "very many agents"):  # of no matter there
        uses.append([*SHORT, "--hidden-dim", 8, "--start-from", gift, "--run-dir", "run"])
    for flags in uses:
        code, said = mappo(monkeypatch, capsys, *flags)
        assert code == 2 and len(said.strip().splitlines()) == 1, flags


@pytest.mark.parametrize("how", ["start", "resume"])
def test_weights_from_which_no_training_goes_on(
    gift: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any, how: str
) -> None:
    """They are finite, but so large that the first loss is not: wrong input, and no training that diverges."""
    change(gift, lambda saved: [weights.fill_(1e30) for weights in saved["parts"]["critic"].values()])
    words: list[Any] = [*SHORT, "--hidden-dim", 8, "--start-from", gift, "--run-dir", "run"]
    if how == "resume":
        words = [*SHORT, "--hidden-dim", 8, "--total-timesteps", 500, "--run-dir", gift, "--resume"]
    code, said = mappo(monkeypatch, capsys, *words)
    assert code == 2 and f"The weights of {gift} cannot be trained on: loss/critic is" in said.splitlines()[-1]


def test_a_checkpoint_larger_than_its_file(gift: Path) -> None:
    """PyTorch packs nothing; a packed one may have a thousand times as much in it."""
    whole = (gift / "checkpoint.pt").rename(gift / "whole")
    with zipfile.ZipFile(whole) as old, zipfile.ZipFile(gift / "checkpoint.pt", "w", zipfile.ZIP_DEFLATED) as new:
        for part in old.namelist():
            new.writestr(part, old.read(part))
    assert valid.is_whole(whole) and not valid.is_whole(gift / "checkpoint.pt")


@pytest.mark.parametrize("text", ["[" * 10**5, "[" * 99 + "]" * 99, "null", "[]", '{"flags": {}, "changed": 5}', "{"])
def test_malformed_configs(gift: Path, text: str) -> None:
    (gift / "config.json").write_text(text)
    with pytest.raises(InputError, match=r"config\.json is damaged"):
        store.collect(gift, Path("results"))
    with pytest.raises(InputError, match="holds no run"):
        runs.flags.identity(gift)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no such files")
@pytest.mark.parametrize("name", ["config.json", "evaluations.csv"])
@pytest.mark.parametrize("how", ["pipe", "device", "large"])
def test_files_that_never_end(gift: Path, name: str, how: str) -> None:
    (gift / name).unlink()
    if how == "pipe":
        os.mkfifo(gift / name)
    elif how == "device":
        (gift / name).symlink_to("/dev/zero")
    else:
        with open(gift / name, "wb") as file:
            file.truncate(2**40)
    with pytest.raises(
        InputError, match=f"{name} is damaged: it (is no file|has 1,099,511,627,776 bytes)|not complete"
    ):
        store.collect(gift, Path("results"))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no such files")
def test_a_checkpoint_that_never_ends(gift: Path) -> None:
    (gift / "checkpoint.pt").unlink()
    os.mkfifo(gift / "checkpoint.pt")
    with pytest.raises(InputError, match="no checkpoint of ours can be read"):
        runs.read_checkpoint(gift, "mappo")


@pytest.mark.parametrize("flag", ["--start-from", "--run-dir", "--watch"])
@pytest.mark.parametrize("form", ["{} ", "{}="])
def test_an_empty_variable_of_a_shell(monkeypatch: pytest.MonkeyPatch, capsys: Any, flag: str, form: str) -> None:
    words = form.format(flag).split(" ")
    assert mappo(monkeypatch, capsys, *words) == (2, f"mappo: {flag} needs the directory of a run.\n")


def test_what_others_put_beside_a_run(gift: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    """A spreadsheet's lock, or notes, do not keep it from going on."""
    for name in (".~lock.evaluations.csv#", "notes.txt"):
        (gift / name).touch()
    assert mappo(monkeypatch, capsys, *SHORT, "--hidden-dim", 8, "--run-dir", gift, "--resume")[0] == 0


def test_a_loaded_team_looks_at_what_it_is_given(gift: Path) -> None:
    team = script("mappo").load(gift)
    with pytest.raises(ValueError, match="The team needs observations"):
        team.act(torch.zeros(2, 1).numpy(), {})


@pytest.mark.slow
@pytest.mark.parametrize(
    "first", [0, 25, *(pytest.param(first, marks=pytest.mark.nightly) for first in range(50, 200, 25))]
)
def test_malformed_gifts(good: Path, made_once: Callable[..., Path], tmp_path: Path, first: int) -> None:
    """Fifty, and at night 150 others, by tests/fuzz.py, of three algorithms and two kinds of folders."""

    def collect(folder: Path) -> None:
        shutil.copytree(good, folder / "mappo")
        shutil.copytree(ROOT / "benchmark/teams/matrix-climbing", folder / "team")
        flags = ["--env", "lbf-5x5-2p-1f", *SHORT[2:], "--hidden-dim", "8", "--run-dir", folder / "iql"]
        assert programs.run([sys.executable, ROOT / "algos/iql.py", *flags]).returncode == 0

    folder = made_once("good-gifts", collect)
    words = [sys.executable, ROOT / "tests/fuzz.py", folder, tmp_path / "cases", first, first + 24]
    done = programs.run(words, timeout=600)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")

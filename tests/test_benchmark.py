"""The programs of benchmark/: runs are collected without loss, reported as the paper does, and the timing is timed."""

import contextlib
import csv
import errno
import io
import itertools
import json
import os
import shutil
import sys
import threading
from types import SimpleNamespace
from typing import Any

import filelock
import numpy as np
import pandas as pd
import programs
import pytest
from kills import full_everywhere, killed_everywhere
from scipy.stats import ttest_ind
from scripts import NAMES, ROOT, load_module

import envs
from benchmark import (
    agreement,
    collect,
    hyperparameters,
    measures,
    plots,
    report,
    store,
    tables,
    time_stepping,
    time_training,
)
from envs.runs import fast_mkl

BENCHMARK = ROOT / "benchmark"
train_opponents = load_module(ROOT / "tools" / "train_opponents.py")
COLUMNS = "point,timestep,wall_seconds,cpu_seconds,return_mean,return_std,episode_length"


@pytest.fixture(autouse=True)
def made_up_values(monkeypatch):
    """The runs of these tests have other values than the paper's."""
    monkeypatch.setattr(hyperparameters, "check", lambda *run: None)


@pytest.fixture
def run(monkeypatch, capsys):
    """Runs a program of benchmark/ in this process; one of its own would spend seconds on imports."""

    def here(program, *flags):
        monkeypatch.setenv(fast_mkl.SWITCH, os.environ.get(fast_mkl.SWITCH, "1"))  # time_training.py changes it
        for name in NAMES:
            monkeypatch.setitem(sys.modules, name, None)  # so that afterwards all is as it was
        monkeypatch.setattr(sys, "argv", [f"{program.__name__.rpartition('.')[2]}.py", *map(str, flags)])
        capsys.readouterr()
        code: Any = 0
        try:
            program.main()
        except SystemExit as end:
            code = end.code
        said = capsys.readouterr()
        return SimpleNamespace(returncode=code, stdout=said.out, stderr=said.err)

    return here


# ---------------------------------------------------------------------------------------------------- collecting


def make_run(directory, seed=0, returns=(0.0, 10.5), budget=2_500_000, reached=None, changed=None, **flags):
    """A run directory as a script leaves it, with one evaluation for each of the returns."""
    directory.mkdir(parents=True)
    changed = changed or {}
    flags = {"env": "matrix-climbing", "seed": seed, "total_timesteps": budget, "parameter_sharing": True} | flags
    of_script = {"algorithm": flags.pop("algorithm", "mappo"), "script": flags.pop("script", "123")}
    flags |= changed | {"threads": 1, "run_dir": "runs/x"}
    config = of_script | {"flags": flags, "changed": changed, "paper_timesteps": 2_500_000}
    config |= {"commit": "abc", "version": "0.1.0", "command": ["mappo.py"], "python": "3.11.7"}
    config |= {"versions": {"torch": "2.13.0"}, "machine": {"cores": 2}, "fast_mkl": False}
    (directory / "config.json").write_text(json.dumps(config))
    steps = np.linspace(0, flags["total_timesteps"] if reached is None else reached, len(returns)).astype(int)
    rows = [f"{k},{step},{1.25 * k},0.5,{value!r},1.0,25.0" for k, (step, value) in enumerate(zip(steps, returns))]
    (directory / "evaluations.csv").write_text("\n".join([COLUMNS, *rows]) + "\n")
    return directory


def run_of(directory, algorithm="mappo", seed=0, sharing="shared", changed=None, script=ROOT / "algos" / "mappo.py"):
    """The run as a campaign has planned it."""
    return store.BenchmarkRun(algorithm, "matrix-climbing", sharing, seed, changed or {}, directory, script)


def table(folder, name="mappo-shared"):
    with open(folder / "matrix-climbing" / f"{name}.csv") as file:
        return list(csv.DictReader(file))


def test_seeds_come_together_and_stay(run, tmp_path):
    there = tmp_path / "results"
    make_run(tmp_path / "first" / "deep" / "in" / "folders", 1)
    make_run(tmp_path / "first" / "whatever", 0, returns=(0.1 + 0.2, 10.5))
    assert run(collect, tmp_path / "first", "--results", there).returncode == 0
    path = store.collect(make_run(tmp_path / "second", 10), there)
    assert path == there / "matrix-climbing" / "mappo-shared.csv"
    rows = [(row["seed"], row["timestep"], row["return_mean"], row["wall_seconds"]) for row in table(there)]
    assert rows == [
        ("0", "0", "0.30000000000000004", "0.0"),  # every digit as it was
        ("0", "2500000", "10.5", "1.2"),
        ("1", "0", "0.0", "0.0"),
        ("1", "2500000", "10.5", "1.2"),
        ("10", "0", "0.0", "0.0"),
        ("10", "2500000", "10.5", "1.2"),
    ]
    settings = json.loads(path.with_suffix(".json").read_text())
    assert settings["algorithm"] == "mappo" and settings["changed"] == {} and settings["paper_timesteps"] == 2_500_000
    assert settings["flags"] == {"env": "matrix-climbing", "total_timesteps": 2_500_000, "parameter_sharing": True}
    assert list(settings["seeds"]) == ["0", "1", "10"]
    assert settings["seeds"]["1"] == {
        "rows": store.hash_rows(path.read_bytes())["1"],
        **{"commit": "abc", "version": "0.1.0", "script": "123", "python": "3.11.7", "versions": {"torch": "2.13.0"}},
        **{"machine": {"cores": 2}, "fast_mkl": False, "wall_seconds": 1.2, "cpu_seconds": 0.5},
    }


def test_the_same_run_twice_changes_nothing(tmp_path):
    directory = make_run(tmp_path / "run")
    path = store.collect(directory, tmp_path / "results")
    before = path.read_bytes(), path.with_suffix(".json").read_bytes()
    store.collect(directory, tmp_path / "results")
    assert (path.read_bytes(), path.with_suffix(".json").read_bytes()) == before


@pytest.mark.slow
def test_a_seed_with_other_returns_is_kept_unless_it_is_replaced(run, tmp_path):
    there = tmp_path / "results"
    store.collect(make_run(tmp_path / "first"), there)
    make_run(tmp_path / "second", returns=(0.0, 11.0))
    make_run(tmp_path / "third", returns=(1.0, 10.5))
    for other in ("second", "third"):
        done = run(collect, tmp_path / other, "--results", there)
        assert done.returncode == 2 and "has a seed 0 with other returns" in done.stderr
    assert table(there)[-1]["return_mean"] == "10.5"
    assert run(collect, tmp_path / "second", "--results", there, "--replace").returncode == 0
    assert table(there)[-1]["return_mean"] == "11.0" and len(table(there)) == 2


def test_replacing_the_only_seed_replaces_the_flags(tmp_path):
    there = tmp_path / "results"
    store.collect(make_run(tmp_path / "first", hidden_dim=64), there)
    with pytest.raises(ValueError, match="made with another hidden_dim"):
        store.collect(make_run(tmp_path / "other", 1, hidden_dim=128), there)
    path = store.collect(make_run(tmp_path / "second", hidden_dim=128), there, replace=True)
    assert json.loads(path.with_suffix(".json").read_text())["flags"]["hidden_dim"] == 128


def test_flags_of_one_run_are_no_part_of_a_setting(tmp_path):
    there = tmp_path / "results"
    store.collect(make_run(tmp_path / "first", env_workers=0), there)
    path = store.collect(make_run(tmp_path / "second", 1, env_workers=4), there)
    assert "env_workers" not in json.loads(path.with_suffix(".json").read_text())["flags"]


def test_a_run_that_was_lengthened_to_the_papers_budget_has_too_many_evaluations(tmp_path):
    lengthened = make_run(tmp_path / "run", returns=(0.0, 5.0, 10.5), eval_points=2)
    with pytest.raises(ValueError, match="has 3 evaluations instead of 2"):
        store.collect(lengthened, tmp_path / "results")
    own_budget = make_run(tmp_path / "own", 0, (0.0, 5.0, 10.5), changed={"total_timesteps": 1000}, eval_points=2)
    store.collect(own_budget, tmp_path / "results")


def test_seeds_of_another_text_of_ones_own_script_do_not_mix(tmp_path):
    """Of the nine they do: their versions compute the same."""
    texts = [tmp_path / "old.py", tmp_path / "new.py"]
    for seed, text in enumerate(texts):
        text.write_text(text.name)
        for algorithm in ("mappo", "own"):
            script = envs.runs.script_hash(text)
            make_run(tmp_path / f"{algorithm}{seed}", seed, algorithm=algorithm, script=script)
    there = tmp_path / "results"
    for name in ("mappo0", "mappo1", "own0", "own0"):
        store.collect(tmp_path / name, there)
    with pytest.raises(ValueError, match=r"holds runs of another text of own\.py"):
        store.collect(tmp_path / "own1", there)

    known = [run_of(tmp_path, "own", seed, script=text) for seed, text in ((0, texts[0]), (1, texts[1]))]
    assert store.has(known[0], there) and not store.has(known[1], there)
    with pytest.raises(ValueError, match=r"holds runs of another text of own\.py"):
        store.has(run_of(tmp_path, "own", 0, script=texts[1]), there)


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")
def test_runs_behind_links_are_found_once(tmp_path):
    make_run(tmp_path / "machine" / "run")
    (tmp_path / "all").mkdir()
    for name, target in (("one", tmp_path / "machine"), ("two", tmp_path / "machine"), ("loop", tmp_path / "all")):
        (tmp_path / "all" / name).symlink_to(target)
    assert list(collect.run_directories(tmp_path / "all")) == [tmp_path / "all" / "one" / "run"]


def test_incomplete_runs_are_left_out(run, tmp_path):
    make_run(tmp_path / "runs" / "short", reached=2_499_999)
    shutil.copytree(tmp_path / "runs" / "short", tmp_path / "runs" / "unborn")
    (tmp_path / "runs" / "unborn" / "evaluations.csv").unlink()
    done = run(collect, tmp_path / "runs", "--results", tmp_path / "results")
    assert done.returncode == 0 and done.stderr.count("it is not complete") == 2
    assert not list((tmp_path / "results").glob("*/*"))


def test_changed_flags_are_another_table(tmp_path):
    there = tmp_path / "results"
    changed = {"total_timesteps": 1000, "learning_rate": 1e-05}
    path = store.collect(make_run(tmp_path / "run", changed=changed), there)
    assert path.name == "mappo-shared-learning-rate=1e-05-total-timesteps=1000.csv"
    assert store.has(run_of(tmp_path, changed=changed), there)
    assert not store.has(run_of(tmp_path), there)
    assert not store.has(run_of(tmp_path, seed=1, changed=changed), there)
    assert not store.has(run_of(tmp_path, sharing="independent", changed=changed), there)
    assert store.load(there)["setting"].unique() == ['{"learning_rate": 1e-05, "total_timesteps": 1000}']


def test_other_flags_do_not_mix(tmp_path):
    there = tmp_path / "results"
    store.collect(make_run(tmp_path / "0", 0, gamma=0.99), there)
    with pytest.raises(ValueError, match="another gamma"):
        store.collect(make_run(tmp_path / "1", 1, gamma=0.5), there)
    store.collect(make_run(tmp_path / "2", 2, gamma=0.99, added_later=1), there)
    assert {row["seed"] for row in table(there)} == {"0", "2"}


def test_a_lengthened_run_and_other_columns_do_not_mix(tmp_path):
    """Begun with a smaller budget, it has more evaluations than the others, at other steps."""
    there = tmp_path / "results"
    store.collect(make_run(tmp_path / "0"), there)
    with pytest.raises(ValueError, match="3 evaluations"):
        store.collect(make_run(tmp_path / "1", 1, returns=(0.0, 5.0, 10.5)), there)
    other = make_run(tmp_path / "2", 2)
    text = (other / "evaluations.csv").read_text()
    (other / "evaluations.csv").write_text(text.replace("length", "length,battle_won").replace("25.0", "25.0,1.0"))
    with pytest.raises(ValueError, match=r"columns .*battle_won"):
        store.collect(other, there)
    assert {row["seed"] for row in table(there)} == {"0"}


@pytest.mark.slow
def test_damaged_runs_are_named_and_do_not_stop_the_others(run, tmp_path):
    make_run(tmp_path / "runs" / "a")
    (tmp_path / "runs" / "a" / "config.json").write_text('{"algorithm": "map')
    make_run(tmp_path / "runs" / "b", 1)
    done = run(collect, tmp_path / "runs", "--results", tmp_path / "results")
    assert done.returncode == 2 and "config.json is damaged" in done.stderr
    assert {row["seed"] for row in table(tmp_path / "results")} == {"1"}


@pytest.mark.parametrize(
    "damage",
    [
        lambda config: None,
        lambda config: 3,
        lambda config: {"flags": {}},
        lambda config: config | {"flags": []},
        lambda config: config | {"changed": []},
        lambda config: config | {"flags": {k: v for k, v in config["flags"].items() if k != "seed"}},
        lambda config: config | {"flags": config["flags"] | {"total_timesteps": "many"}},
    ],
)
def test_an_odd_config_is_damaged(tmp_path, damage):
    file = make_run(tmp_path / "run") / "config.json"
    file.write_text(json.dumps(damage(json.loads(file.read_text()))))
    with pytest.raises(ValueError, match=r"config\.json is damaged"):
        store.collect(tmp_path / "run", tmp_path / "results")


@pytest.mark.parametrize(
    "damage",
    [
        lambda lines: lines[:1] + lines[2:],  # the first evaluation is gone
        lambda lines: [*lines[:3], *lines[2:]],
        lambda lines: [lines[0], *lines[:0:-1]],
        lambda lines: [line.replace("10.5", "nan") for line in lines],
        lambda lines: [line.replace("10.5", "ten") for line in lines],
        lambda lines: [*lines[:-1], lines[-1][:-2]],
        lambda lines: ["<<<<<<< HEAD\n", *lines],
        lambda lines: ["\n"],
        lambda lines: ["hello\n", "1\n"],
    ],
)
def test_odd_evaluations_are_damaged(tmp_path, damage):
    file = make_run(tmp_path / "run", returns=(0.0, 5.0, 7.0, 10.5)) / "evaluations.csv"
    file.write_text("".join(damage(file.read_text().splitlines(keepends=True))))
    with pytest.raises(ValueError, match=r"evaluations\.csv is damaged"):
        store.collect(tmp_path / "run", tmp_path / "results")


def test_a_statistic_may_be_missing(tmp_path):
    """A game that crashed has none; but it is never infinite."""
    file = make_run(tmp_path / "run") / "evaluations.csv"
    text = file.read_text().replace("length\n", "length,battle_won\n").replace("25.0\n", "25.0,nan\n")
    file.write_text(text.replace("25.0,nan\n", "25.0,\n", 1))
    store.collect(tmp_path / "run", tmp_path / "results")
    assert [row["battle_won"] for row in table(tmp_path / "results")] == ["", "nan"]
    assert store.load(tmp_path / "results")["battle_won"].isna().all()
    file.write_text(text.replace("nan", "inf"))
    with pytest.raises(ValueError, match="missing or infinite"):
        store.collect(tmp_path / "run", tmp_path / "results")


def as_older_versions_had_it(path):
    """Without hashes of the seeds' rows."""
    settings = json.loads(path.with_suffix(".json").read_text())
    for origin in settings["seeds"].values():
        del origin["rows"]
    path.with_suffix(".json").write_text(json.dumps(settings))


def lines_of(table, seed):
    return [line for line in table if line.startswith(f"{seed},")]


@pytest.mark.parametrize(
    "damage",
    [
        lambda lines: [],
        lambda lines: lines[:1],
        lambda lines: lines[:1] + lines_of(lines, 0),  # the file is cut between two seeds
        lambda lines: lines[:3] + lines[4:6] + lines[7:],  # both seeds lack a point
        lambda lines: [line for line in lines if ",2500000," not in line],
        lambda lines: [*lines, *lines_of(lines, 1)],
        lambda lines: [line.replace("seed", "sead") for line in lines],
        lambda lines: [line.encode().decode("utf-16-le", "replace") for line in lines],
    ],
)
def test_a_damaged_table_is_named(tmp_path, damage):
    there = tmp_path / "results"
    for seed in range(2):
        path = store.collect(make_run(tmp_path / str(seed), seed, returns=(0.0, 5.0, 10.5)), there)
    path.write_text("".join(damage(path.read_text().splitlines(keepends=True))), encoding="utf-8")
    for older in (False, True):
        if older:
            as_older_versions_had_it(path)
        with pytest.raises(ValueError, match=f"{path.name} is damaged"):
            store.load(there)


def test_other_returns_than_those_that_were_collected_are_damage(tmp_path):
    """Lines may end as on Windows, where Git changes them; and results of older versions name no rows."""
    there = tmp_path / "results"
    for seed in range(2):
        path = store.collect(make_run(tmp_path / str(seed), seed), there)
    text = path.read_bytes()
    path.write_bytes(text.replace(b"\n", b"\r\n"))
    assert len(store.load(there)) == 4
    path.write_bytes(text.replace(b"10.5", b"10.6", 1))
    with pytest.raises(ValueError, match=r"does not hold the evaluations that mappo-shared\.json names"):
        store.load(there)
    as_older_versions_had_it(path)
    assert set(store.load(there)["return_mean"]) == {0.0, 10.5, 10.6}


@pytest.mark.parametrize("suffix", [".csv", ".json"])
def test_a_damaged_result_is_named_by_all(tmp_path, run, suffix):
    there = tmp_path / "results"
    path = store.collect(make_run(tmp_path / "0"), there).with_suffix(suffix)
    path.write_text("<<<<<<< HEAD\n" + path.read_text())
    before, said = path.read_bytes(), f"{path.name} is damaged"
    with pytest.raises(ValueError, match=said):
        store.has(run_of(tmp_path), there)
    with pytest.raises(ValueError, match=said):
        store.collect(make_run(tmp_path / "1", 1), there)
    for flags in (["--output", tmp_path / "out", "--results", there], ["--grid", there]):
        done = run(report, *flags)
        assert done.returncode == 2 and said in done.stderr
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    "damage",
    [
        lambda settings: {k: v for k, v in settings.items() if k != "seeds"},
        lambda settings: settings | {"seeds": ["0"]},
        lambda settings: settings | {"seeds": {"none": {}}},
        lambda settings: settings | {"seeds": {"0": 3}},
    ],
)
def test_damaged_settings_are_named(tmp_path, damage):
    path = store.collect(make_run(tmp_path / "0"), tmp_path / "results").with_suffix(".json")
    path.write_text(json.dumps(damage(json.loads(path.read_text()))))
    with pytest.raises(ValueError, match=f"{path.name} is damaged"):
        store.load(tmp_path / "results")


def test_lost_settings_do_not_cost_the_other_seeds(tmp_path):
    there = tmp_path / "results"
    path = store.collect(make_run(tmp_path / "0", 0), there)
    store.collect(make_run(tmp_path / "1", 1), there)
    settings, before = path.with_suffix(".json").read_text(), path.read_bytes()
    path.with_suffix(".json").unlink()
    with pytest.raises(ValueError, match=r"mappo-shared\.json, which lists them, is missing"):
        store.collect(tmp_path / "1", there)
    assert path.read_bytes() == before and not path.with_suffix(".json").exists()
    old = json.loads(settings)
    del old["seeds"]["0"]  # such as those of an older commit
    path.with_suffix(".json").write_text(json.dumps(old))
    store.collect(tmp_path / "1", there)
    assert path.read_bytes() == before
    path.unlink()
    path.with_suffix(".json").unlink()
    store.collect(tmp_path / "1", there)
    path.with_suffix(".json").unlink()  # the same seed alone: the end of a process between the two files
    store.collect(tmp_path / "1", there)
    assert set(store.load(there)["seed"]) == {1}


def test_nobody_listens(monkeypatch, run, tmp_path):
    """As `| true`: a run that was collected is not called left out."""

    def closed(_):
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    make_run(tmp_path / "run")
    monkeypatch.setattr(sys, "stdout", SimpleNamespace(write=closed, flush=lambda: None))
    done = run(collect, tmp_path / "run", "--results", tmp_path / "results")
    assert done.stderr == "collect: [Errno 32] Broken pipe\n" and len(table(tmp_path / "results")) == 2


def test_a_seed_counts_once_the_settings_list_it(tmp_path):
    """As where an older version was killed between the two files."""
    path = store.collect(make_run(tmp_path / "0", 0), tmp_path / "results")
    settings = path.with_suffix(".json").read_text()
    store.collect(make_run(tmp_path / "1", 1), tmp_path / "results")
    path.with_suffix(".json").write_text(settings)
    assert set(store.load(tmp_path / "results")["seed"]) == {0}
    store.collect(tmp_path / "1", tmp_path / "results")
    assert len(store.load(tmp_path / "results")) == 4


class TestKills:
    """A collector that is killed, or meets a full disk, at any file operation; with --replace a seed gets new returns,
    from another commit."""

    @pytest.fixture(params=["first seed", "second seed", "--replace", "--replace in older results"])
    def collecting(self, request, tmp_path):
        """A results folder, the run that is collected, and with --replace or without."""
        before = tmp_path / "before"
        before.mkdir()
        for seed in range(0 if request.param == "first seed" else 2):
            path = store.collect(make_run(tmp_path / f"seed{seed}", seed), before)
        if "older" in request.param:
            as_older_versions_had_it(path)
        replace = "--replace" in request.param
        run = make_run(tmp_path / "new", 1 if replace else 2, returns=(3.0, 4.0))
        config = json.loads((run / "config.json").read_text())
        (run / "config.json").write_text(json.dumps(config | {"commit": "def"}))
        return before, run, replace

    def rows(self, there):
        """What the results say: seed, return and commit of each evaluation."""
        if not list(there.glob("*/*.json")):
            return []
        return store.load(there)[["seed", "return_mean", "commit"]].to_numpy().tolist()

    @pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
    def test_a_kill_leaves_all_as_it_was_or_the_whole_run(self, collecting, tmp_path):
        before, run, replace = collecting
        there, found = tmp_path / "there", []
        for _ in killed_everywhere(before, there, lambda: store.collect(run, there, replace)):
            found.append(self.rows(there))
            store.collect(run, there, replace=True)
            assert self.rows(there) == found[-1] or found[-1] == self.rows(before)
            files = {file.name for file in there.rglob("*") if file.is_file()}
            assert files == {".lock", "mappo-shared.csv", "mappo-shared.json"}
        old, new = self.rows(before), self.rows(there)
        assert old != new and len(found) > 6
        assert found == [old] * found.count(old) + [new] * found.count(new) and found[-1] == new

    @pytest.mark.slow
    def test_a_killed_collector_loses_nothing_to_the_next_ones(self, collecting, tmp_path):
        """They collect another run, and may be killed, too: what was there, or what the first one brought, stays."""
        before, run, replace = collecting
        there, again, other = tmp_path / "there", tmp_path / "again", make_run(tmp_path / "other", 7)
        for _ in killed_everywhere(before, there, lambda: store.collect(run, there, replace)):
            found = self.rows(there)
            both = [*found, [7, 0.0, "abc"], [7, 10.5, "abc"]]
            if list(there.glob("*/*.csv.new")) and found != self.rows(before):
                for _ in killed_everywhere(there, again, lambda: store.collect(other, again)):
                    assert self.rows(again) in (found, both)
            store.collect(other, there)
            assert self.rows(there) == both

    def test_a_full_disk_leaves_all_as_it_was(self, collecting, tmp_path):
        before, run, replace = collecting
        there, errors = tmp_path / "there", []
        for error in full_everywhere(before, there, lambda: store.collect(run, there, replace)):
            errors.append(error)
            if error is None:  # there was another way
                assert self.rows(there) != self.rows(before)
            else:
                assert self.rows(there) == self.rows(before) and not list(there.glob("*/*.new"))
        assert len(errors) > 6


def test_a_reader_that_meets_a_collector_reads_again(monkeypatch, tmp_path):
    """A seed is replaced between the reading of its JSON and that of its CSV."""
    there = tmp_path / "results"
    store.collect(make_run(tmp_path / "old"), there)
    read, waiting = store.read_settings, [make_run(tmp_path / "new", returns=(3.0, 4.0))]

    def then_replaced(path):
        settings = read(path)
        if waiting:
            store.collect(waiting.pop(), there, replace=True)
        return settings

    monkeypatch.setattr(store, "read_settings", then_replaced)
    assert list(store.load(there)["return_mean"]) == [3.0, 4.0]


def test_a_campaign_reads_a_run_once(monkeypatch, tmp_path):
    """What it judges is what it collects, whatever comes in between."""
    directory, read, content_of = make_run(tmp_path / "run"), [], store.content_of

    def noted(file):
        read.append(file.relative_to(tmp_path).parts[0])
        return content_of(file)

    monkeypatch.setattr(store, "content_of", noted)
    assert store.bring_in(run_of(directory), tmp_path / "results") == "in the results"
    assert read.count("run") == 1


def test_two_collectors_at_once_lose_no_seed(monkeypatch, tmp_path):
    """They meet between reading the results and writing them, if nothing keeps the second one out."""
    barrier, merge = threading.Barrier(2), store.merge

    def meet(*words):
        with contextlib.suppress(threading.BrokenBarrierError):
            barrier.wait(timeout=0.5)
        return merge(*words)

    monkeypatch.setattr(store, "merge", meet)
    made = [make_run(tmp_path / str(seed), seed) for seed in range(2)]
    at_once(store.collect, [(run, tmp_path / "results") for run in made])
    assert set(store.load(tmp_path / "results")["seed"]) == {0, 1}


def test_two_timings_at_once_lose_no_task(monkeypatch, tmp_path):
    barrier, read = threading.Barrier(2), store.read_speeds

    def meet(file):
        there = read(file)
        with contextlib.suppress(threading.BrokenBarrierError):
            barrier.wait(timeout=0.5)
        return there

    monkeypatch.setattr(store, "read_speeds", meet)
    origin = {"machine": {"processor": "any"}, "commit": "abc"}
    tasks = ("matrix-climbing", "lbf-5x5-2p-1f")
    at_once(store.keep_speeds, [(tmp_path / "stepping.csv", task, {"ours": 1.0}, origin) for task in tasks])
    assert set(read(tmp_path / "stepping.csv")["task"]) == set(tasks)


def test_teams_are_kept_by_one_collector_at_a_time(monkeypatch, run, tmp_path):
    """With the results' lock: a team that another one has kept meanwhile may be better than the returns say."""

    def keep(directory, returns):
        with pytest.raises(filelock.Timeout):
            filelock.FileLock(tmp_path / "results" / ".lock", timeout=0).acquire()
        kept.append(directory)

    kept: list[Any] = []
    monkeypatch.setattr(store, "RESULTS", tmp_path / "results")
    monkeypatch.setattr(collect, "last_returns", lambda: "returns")
    monkeypatch.setattr(collect, "keep_team", keep)
    assert run(collect, make_run(tmp_path / "run"), "--results", tmp_path / "results").returncode == 0
    assert kept == [tmp_path / "run"]


def at_once(function, words):
    """Calls it in a thread for each of the words."""
    threads = [threading.Thread(target=function, args=each) for each in words]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def test_a_later_seed_may_lack_a_flag(tmp_path):
    """Of a script that has lost it; the settings keep what all seeds were made with."""
    store.collect(make_run(tmp_path / "0", 0, gone=3), tmp_path / "results")
    path = store.collect(make_run(tmp_path / "1", 1), tmp_path / "results")
    assert json.loads(path.with_suffix(".json").read_text())["flags"]["gone"] == 3


def test_each_seed_must_reach_the_end(tmp_path):
    for seed in (0, 1):
        path = store.collect(make_run(tmp_path / str(seed), seed), tmp_path / "results")
    as_older_versions_had_it(path)
    text = path.read_text()
    for row in (2, 4):
        lines = text.splitlines()
        lines[row] = lines[row].replace("2500000", "2000000")
        path.write_text("\n".join(lines) + "\n")
        with pytest.raises(ValueError, match="the last evaluations are missing"):
            store.load(tmp_path / "results")


# ---------------------------------------------------------------------------------------------------- what tables say


def evaluations(curves, task="matrix-climbing", algorithm="mappo", sharing="shared", changed=None, budget=2_500_000):
    """Evaluations in the form of `store.load`; curves: a list of returns for each seed."""
    rows = [
        {"seed": seed, "point": point, "timestep": point * budget // max(1, len(curve) - 1), "return_mean": value}
        for seed, curve in enumerate(curves)
        for point, value in enumerate(curve)
    ]
    setting = store.setting_name(changed or {})
    names = {"task": task, "family": store.family(task), "algorithm": algorithm, "sharing": sharing}
    times = {"cpu_seconds": 7200.0, "wall_seconds": 7200.0, "total_timesteps": budget, "paper_timesteps": 2_500_000}
    return pd.DataFrame(rows).assign(**names, **times, setting=setting)


def test_maximum_average_and_last_by_hand():
    """Two seeds: the means are 1, 5, 5; ties go to the first best point."""
    row = measures.summarise(evaluations([[0, 4, 2], [2, 6, 8]])).iloc[0]
    assert row["seeds"] == 2 and row["maximum"] == 5 and row["maximum_point"] == 1
    assert row["maximum_interval"] == pytest.approx(2)  # 4 and 6: s = sqrt(2), 2 s / sqrt(2)
    assert row["average"] == pytest.approx(11 / 3)  # the seeds' own means are 2 and 16 / 3
    assert row["average_interval"] == pytest.approx(10 / 3)
    assert row["last"] == 5 and row["last_interval"] == pytest.approx(6)
    crashed = measures.summarise(evaluations([[0, 4, 2], [2, 6, np.nan]])).iloc[0]  # the last point has one seed left
    assert crashed["last"] == 2 and np.isnan(crashed["last_interval"])
    single = measures.summarise(evaluations([[9, 4]])).iloc[0]
    assert single["maximum"] == 9 and single["maximum_point"] == 0 and np.isnan(single["maximum_interval"])


def test_means_that_are_equal_but_for_rounding_are_ties():
    """The mean of the same numbers in another order may differ in its last bits."""
    assert measures.summarise(evaluations([[0.5, 0.5 + 1e-15]])).iloc[0]["maximum_point"] == 0
    assert measures.summarise(evaluations([[0.5, 0.5 + 1e-6]])).iloc[0]["maximum_point"] == 1


def test_the_papers_five_seeds_of_climbing():
    """IQL's 195 +- 67.82 are the untrained seeds 125, 125, 175, 275, 275, which later all have 125 or 150."""
    curves = [[first] + [125] * 100 for first in (125, 125, 175, 275, 275)]
    row = measures.summarise(evaluations(curves)).iloc[0]
    assert (row["maximum"], round(row["maximum_interval"], 2), row["maximum_point"]) == (195, 67.82, 0)


def test_the_papers_marks_come_out_of_its_own_numbers():
    """Everywhere it prints any, but for the cells that are known to differ (the matrix rows have no asterisks)."""
    paper = store.paper_cells()
    marked = paper[paper["metric"] == "max_return"]
    ours = tables.with_marks(marked.rename(columns={"mark": "printed"}))
    family = ours["task"].map(store.family)
    prints = (ours["sharing"] == "shared") | (family != "matrix")
    assert ((ours["mark"] == "best") == (ours["printed"] == "best"))[prints].all()
    different = ours[(ours["mark"] != ours["printed"]) & (family != "matrix")]
    assert set(different[["sharing", "task", "algorithm"]].itertuples(index=False, name=None)) == {
        ("shared", "mpe-speaker-listener", "ippo"),
        ("shared", "mpe-tag", "maa2c"),
        ("shared", "smac-2s_vs_1sc", "ippo"),
        ("shared", "lbf-10x10-3p-3f", "mappo"),
        ("independent", "smac-corridor", "iql"),
        ("independent", "smac-corridor", "ippo"),
    }


def test_the_papers_impossible_cells():
    paper = store.paper_cells()
    found = paper[tables.impossible(paper) & (paper["metric"] == "max_return")]
    wrong = {("independent", "lbf-8x8-2p-2f-c", "qmix"), ("shared", "lbf-15x15-4p-5f", "maddpg")}
    for task in ("lbf-10x10-3p-3f", "lbf-10x10-3p-3f-2s", "lbf-15x15-4p-3f"):
        wrong |= {("independent", task, name) for name in ("iql", "vdn", "qmix")}
    for task in ("lbf-15x15-3p-5f", "lbf-15x15-4p-5f"):
        wrong |= {("independent", task, name) for name in ("vdn", "qmix")}
    assert set(found[["sharing", "task", "algorithm"]].itertuples(index=False, name=None)) == wrong


def compared(*parts):
    """Evaluations as cells beside the paper's."""
    return tables.compare(measures.our_cells(pd.concat(parts)), store.paper_cells())


def cell(both, metric="max_return", algorithm="mappo"):
    return both[(both["metric"] == metric) & (both["algorithm"] == algorithm)].iloc[0]


def test_differences_in_units_of_the_prediction_interval():
    """The paper's average of MAPPO on Climbing: 170.76 +- 1.79, its maximum 175.00 +- 0.00."""
    both = compared(evaluations([[171, 171], [175, 175]]))
    ours = cell(both, "average_return")
    assert ours["interval"] == pytest.approx(4)
    width = agreement.half_width(4, 2, 1.79)
    assert ours["difference"] == pytest.approx((173 - 170.76) / width)
    single = cell(compared(evaluations([[173, 173]])), "average_return")
    assert single["difference"] == pytest.approx((173 - 170.76) / agreement.half_width(np.nan, 1, 1.79))
    assert cell(compared(evaluations([[175, 175]] * 5)))["difference"] == 0


def test_the_signs_of_cells():
    few = evaluations([[9, 4], [9, 4]])
    short = evaluations([[1, 5]] * 5, algorithm="ia2c", changed={"total_timesteps": 1000}, budget=1000)
    whole = evaluations([[1, 9.001], [1, 9], [1, 9], [1, 9], [1, 9]], algorithm="qmix")
    longer = evaluations([[1, 99]] * 5, algorithm="qmix", changed={"total_timesteps": 9_000_000}, budget=9_000_000)
    other = evaluations([[1, 99]] * 5, algorithm="qmix", changed={"network": "gru"})
    both = compared(few, short, whole, longer, other)
    header, _, ours, paper, _ = tables.markdown(both, "max_return", "shared").splitlines()
    cells = dict(zip(header.split(" | "), ours.split(" | ")))
    assert cells["MAPPO"] == "9.00 ± 0.00 ²°" and cells["IA2C"] == "5.00 ± 0.00 †"
    assert cells["QMIX |"] == "**9.00 ± 0.00** |"  # printed like the best, so bold as well
    assert paper.split(" | ")[1] == "paper" and "195.00" not in paper and "175.00 ± 0.00" in paper
    single = compared(evaluations([[0, 8]]), evaluations([[0, 7], [0, 7]], algorithm="ia2c"))
    assert "**" not in tables.markdown(single, "max_return", "shared")  # the highest is of one seed
    many = compared(evaluations([[0, 1]] * 10))
    assert "1.00 ± 0.00** ¹⁰ |" in tables.markdown(many, "max_return", "shared")
    for planned, sign in ((5, "²⁻°"), (2, "²°"), (1, "²⁺°")):
        cells = measures.our_cells(few)
        text = tables.markdown(
            tables.compare(cells, store.paper_cells(), {("matrix-climbing", "shared"): planned}), "max_return", "shared"
        )
        assert f"9.00 ± 0.00 {sign} |" in text
    averages = tables.markdown(both, "average_return", "shared").splitlines()
    for lines in (averages, tables.markdown(both, "max_return", "shared").splitlines()):
        assert dict(zip(header.split(" | "), lines[4].split(" | ")))["IA2C"] == "-"  # another budget
    assert "**" not in averages[2]
    listed = tables.variants(pd.concat([few, short, whole, longer, other]), pd.concat([few, short, whole]))
    assert "network gru" in listed and "total_timesteps 9000000" in listed and "MAPPO" not in listed
    assert tables.short(both).splitlines()[2].startswith("| `matrix-climbing` |  |  |  |")  # no other budgets


def test_asterisks_by_the_t_test():
    """1.0 +- 0.2 against 0.7 +- 0.3 (five seeds): t = 0.3 / sqrt(s1^2 / 5 + s2^2 / 5) = 1.66, below 2.306."""
    row = pd.DataFrame({"mean": [1.0, 0.7, 0.2], "interval": [0.2, 0.3, 0.2], "seeds": 5})
    assert tables.marks(row) == ["best", "not significantly different", ""]
    assert not tables.same_mean(1.0, np.nan, 1, 0.99, 0.2, 5)
    assert tables.same_mean(1.0, 0.0, 5, 1.0, 0.0, 5) and not tables.same_mean(1.0, 0.0, 5, 0.9, 0.0, 5)
    tied = pd.DataFrame({"mean": [1.0, 1.0, 0.7], "interval": [0.01, 0.3, 0.2], "seeds": 5})
    for order in ([0, 1, 2], [1, 0, 2]):  # 0.7 is significantly different from one of the best, not from the other
        assert tables.marks(tied.iloc[order].reset_index(drop=True)) == ["best", "best", "not significantly different"]
    few, many = np.array([1.0, 2.2]), np.array([0.0, 0.5, 0.3, 0.8, 0.9])  # unequal numbers of seeds: p = 0.047
    cells = [(runs.mean(), measures.interval(runs.std(ddof=1), len(runs)), len(runs)) for runs in (few, many)]
    assert ttest_ind(few, many).pvalue < 0.05 and not tables.same_mean(*cells[0], *cells[1])
    close = evaluations([[0, 8], [0, 9], [0, 10]]), evaluations([[0, 8], [0, 9], [0, 9.9]], algorithm="ia2c")
    text = tables.markdown(compared(*close), "max_return", "shared")
    assert "| **9.00 ± 1.15** ³ |" in text and r"| 8.97 ± 1.10\* ³ |" in text


def test_what_cannot_be_is_shown_and_does_not_count():
    """The paper's IQL on 10x10-3p-3f without sharing has an average above its maximum."""
    both = compared(evaluations([[1, 2]] * 5, task="lbf-10x10-3p-3f", algorithm="iql", sharing="independent"))
    lines = tables.markdown(both, "max_return", "independent").splitlines()
    assert "‡" in lines[3] and len(lines) == 4 and both["difference"].isna().all()


def test_rows_say_what_is_known_against_a_stand_in():
    for task, words in store.KNOWN_AGAINST.items():
        assert store.paper_task(task) != task, "not what is compared with the paper"
        table = tables.markdown(compared(evaluations([[1, 2]], task=task)), "max_return", "shared")
        assert f"| {task} ({words}) | ours |" in table


def test_the_short_table_is_of_shared_parameters():
    both = compared(evaluations([[9, 9]] * 5), evaluations([[4, 4]] * 5, sharing="independent"))
    assert "9.00" in tables.short(both) and "4.00" not in tables.short(both)


def test_numbers():
    assert tables.number(-0.001, np.nan) == "0.00" and tables.number(-0.5, 0.25) == "-0.50 ± 0.25"


def test_of_other_budgets_the_longest_is_shown():
    runs = [evaluations([[1, k]], changed={"total_timesteps": 5_000_000 * k}, budget=5_000_000 * k) for k in (1, 3, 2)]
    assert set(measures.in_tables(pd.concat(runs))["total_timesteps"]) == {15_000_000}


def test_families_are_those_of_the_budgets():
    for task, family in {
        "gymnasium:rware-tiny-2ag-v2": "rware",
        "own:rware": "other",
        "smac-27m_vs_30m": "smac",
    }.items():
        assert store.family(task) == family


def test_what_a_task_stands_in_for():
    """Of several rules on a map the newest; the others, and tasks of the paper itself, stand for themselves."""
    names = {"smaclite-3s5z-sc2-v2": "smac-3s5z", "smaclite-MMM2-sc2": "smac-MMM2"}
    names |= {name: name for name in ("smaclite-3s5z-sc2", "smaclite-3s5z", "lbf-8x8-2p-2f-c")}
    assert {name: store.paper_task(name) for name in names} == names
    assert [name for name in names if store.has_older_rules(name)] == ["smaclite-3s5z-sc2"]
    runs = evaluations([[0, 4]], task="smaclite-3s5z-sc2-v2")
    assert list(measures.normalise(runs)["normalised"]) == [0, 1]


def test_a_maximum_before_training_marks_no_average():
    cells = measures.our_cells(evaluations([[9, 4], [9, 4]]))
    assert set(cells[cells["at_start"]]["metric"]) == {"max_return"}


def test_win_rates_have_their_own_best_point():
    runs = evaluations([[1, 2, 3]] * 2, task="smaclite-3s5z-sc2-v2").assign(battle_won=[0.0, 0.5, 0.2] * 2)
    won = cell(compared(runs), "max_win_rate")
    assert won["mean"] == 0.5 and won["paper_mean"] > 0  # stands in for the paper's 3s5z
    assert won["paper_task"] == "smac-3s5z"


# ---------------------------------------------------------------------------------------------------- over all tasks


def test_normalised_by_the_range_over_both_sharings():
    runs = pd.concat([evaluations([[0, 4]]), evaluations([[2, 8]], sharing="independent")])
    assert list(measures.normalise(runs)["normalised"]) == [0, 0.5, 0.25, 1]
    assert measures.normalise(evaluations([[3, 3]])).empty  # nothing ever changed
    assert measures.normalise(evaluations([[0, 4]], task="lbf-9x9-2p-2f")).empty  # not in the paper
    assert measures.normalise(evaluations([[0, 4]], changed={"network": "gru"})).empty


def test_final_scores_are_those_of_the_last_point():
    runs = measures.normalise(evaluations([[0, 4, 1], [0, 2, 3]]))
    assert measures.final_scores(runs)["mappo", "shared"]["matrix-climbing"].tolist() == [0.25, 0.75]


def test_intervals_of_the_bootstrap_leave_a_fortieth_out_at_each_end():
    """The samples are 0, 1, ..., 2000; the measure looks at them alone."""

    def measure(scores):
        return np.arange(len(scores[0]), dtype=float)

    assert measures.with_interval(measure, [np.zeros(3)])[1:].tolist() == pytest.approx([49.975, 1949.025])


def test_means_with_and_without_sharing_by_hand():
    """Two algorithms on one task, ranging from 0 to 4; runs with another budget do not count."""
    values = {("mappo", "shared"): 4, ("mappo", "independent"): 0, ("ia2c", "shared"): 2, ("ia2c", "independent"): 4}
    values["coma", "shared"] = 3
    rows = [("max_return", *key, "matrix-climbing", float(value), False) for key, value in values.items()]
    rows.append(("max_return", "qmix", "shared", "matrix-climbing", 99.0, True))
    columns = ["metric", "algorithm", "sharing", "task", "mean", "other_budget"]
    means = measures.sharing_means(pd.DataFrame(rows, columns=columns))
    assert means.loc[("matrix", "shared"), ["mean", "count"]].tolist() == [0.75, 2]  # coma has no other half
    assert means.loc[("matrix", "shared"), "error"] == pytest.approx(0.25)  # 1 and 0.5: s = 0.354, s / sqrt(2)
    assert means.loc[("matrix", "independent"), "error"] == pytest.approx(0.5)


def test_cpu_hours_are_those_at_the_end_of_a_run():
    runs = evaluations([[0, 1, 2]] * 2).assign(cpu_seconds=[0, 1800, 3600, 0, 3600, 7200])
    other = evaluations([[0, 1]], task="matrix-penalty-0")  # two hours
    assert measures.cpu_hours(pd.concat([runs, other])).loc[("matrix", "mappo", "shared")].tolist() == [3, 5, 5 / 3]


def test_interquartile_mean_by_hand():
    """Eight runs of two unequal tasks: the two lowest and the two highest are left out."""
    tasks = [np.array([0.0, 1.0, 2.0]), np.array([3.0, 4.0, 5.0, 6.0, 100.0])]
    value, low, high = measures.with_interval(measures.interquartile_mean, tasks)
    assert value == (2 + 3 + 4 + 5) / 4 and low < value < high


def test_bootstrap_draws_within_tasks():
    """A task with one run, or with equal runs, has no spread, however far apart the tasks are."""
    scores = [np.array([0.0]), np.array([5.0, 5.0])]
    assert list(measures.with_interval(measures.interquartile_mean, scores)) == [10 / 3] * 3
    two = measures.with_interval(measures.interquartile_mean, [np.array([0.0, 1.0])])
    assert list(two) == [0.5, 0, 1]  # a quarter of the samples is 0, 0, a quarter 1, 1


def test_probability_of_improvement_by_hand():
    ours, theirs = [np.array([1.0, 3.0]), np.array([0.0])], [np.array([2.0, 2.0, 3.0]), np.array([0.0])]
    # task one: 3 beats 2, 2 and ties 3, of six pairs; task two: a tie
    value, low, high = measures.with_interval(measures.probability_of_improvement, ours, theirs)
    assert value == pytest.approx((2.5 / 6 + 0.5) / 2) and low < value < high


def test_performance_profile_by_hand():
    measure = measures.performance_profile(np.array([0.0, 0.5, 0.9]))
    share, low, high = measures.with_interval(measure, [np.array([0.0, 0.5]), np.array([0.6, 1.0])])
    assert list(share) == [0.75, 0.5, 0.25] and (low <= share).all() and (share <= high).all()


def test_parameter_sharing_helps_everywhere_but_in_the_matrix_games_of_the_paper():
    means = measures.sharing_means(store.paper_cells())["mean"].unstack()
    better = {name for name in means.index if means.loc[name, "shared"] > means.loc[name, "independent"]}
    assert better == {"mpe", "smac", "lbf", "rware"}
    assert measures.sharing_means(measures.our_cells(evaluations([[0, 5]]))).empty


def test_curves_have_the_width_of_their_runs():
    """Outside the paper's budgets, and of tasks that it does not have, they are drawn over timesteps."""
    for task, budget, end in (
        ("matrix-climbing", 2_500_000, 1),
        ("matrix-climbing", 25_000, 25_000),
        ("gymnasium:somebody/A-Game-With-A-Long-Name-For-Some-Agents-v3", 2_500_000, 2_500_000),
    ):
        changed = {"total_timesteps": budget} if budget != 2_500_000 else {}
        rows = measures.in_tables(evaluations([[0, 1]] * 2, task=task, budget=budget, changed=changed))
        figure = plots.learning_curves(rows, store.family(task), "shared")
        panel = figure.axes[0]
        assert panel.get_xlim() == pytest.approx((-0.02 * end, 1.02 * end))
        figure.draw_without_rendering()
        assert panel.title.get_window_extent().width <= figure.bbox.width
        assert panel.get_xlabel() == ("timesteps" if end > 1 else "share of the paper's timesteps")
        plots.plt.close(figure)


@pytest.mark.parametrize("seeds, bands", [(1, 0), (2, 1)])
def test_profiles_of_single_seeds_have_no_interval(seeds, bands):
    both = [evaluations([[0, 1]] * 3), evaluations([[0, 1]] * seeds, task="matrix-penalty-0")]
    figure = plots.profiles(measures.normalise(pd.concat(both)), "shared")
    assert len(figure.axes[0].collections) == bands
    plots.plt.close(figure)


def test_curves_are_means_of_tasks():
    """Task one 0 and 4 (interval 4), task two 8 three times (interval 0): mean (2 + 8) / 2, interval 4 / 2."""
    one = evaluations([[0, 0], [0, 4]])
    two = evaluations([[0, 8]] * 3, task="matrix-penalty-0")
    ((name, line),) = plots.mean_curves(pd.concat([one, two]), "return_mean")
    assert name == "mappo" and line.loc[1].to_dict() == pytest.approx({"x": 1.0, "mean": 5.0, "interval": 2.0})
    ((_, line),) = plots.mean_curves(pd.concat([one, two[two["seed"] == 0]]), "return_mean")
    assert np.isnan(line.loc[1, "interval"])


# ---------------------------------------------------------------------------------------------------- the report


@pytest.mark.slow
def test_the_report_is_up_to_date():
    made = report.Report(store.RESULTS)
    how = "run python benchmark/report.py"
    readme = ROOT / "README.md"
    assert readme.read_text(encoding="utf-8") == report.between_markers(readme, made.short()), how
    assert (BENCHMARK / "RESULTS.md").read_text(encoding="utf-8") == made.long() + "\n", how
    assert (BENCHMARK / "tables.csv").read_text(encoding="utf-8") == tables.to_csv(made.both), how
    assert (BENCHMARK / "figures" / "source.txt").read_text(encoding="utf-8") == made.digest + "\n", how
    assert {path.stem for path in (BENCHMARK / "figures").glob("*.png")} == made.figures().keys(), how


def test_all_evaluations_are_one_table_for_pandas(tmp_path):
    store.collect(make_run(tmp_path / "a", seed=0), tmp_path / "results")
    store.collect(make_run(tmp_path / "b", seed=1, returns=(3.0, 1 / 3)), tmp_path / "results")
    text = report.evaluations_csv(store.load(tmp_path / "results"))
    read = pd.read_csv(io.StringIO(text))
    assert list(read) == report.EVALUATION_COLUMNS
    assert read["seed"].tolist() == [0, 0, 1, 1] and read["timestep"].tolist() == [0, 2_500_000] * 2
    assert read["return"].tolist() == [0.0, 10.5, 3.0, 0.333333]
    constant = read[["task", "algorithm", "sharing", "setting", "commit"]].drop_duplicates()
    assert constant.values.tolist() == [["matrix-climbing", "mappo", "shared", "{}", "abc"]]


def test_the_text_around_the_markers_stays(tmp_path):
    path = tmp_path / "README.md"
    path.write_text(f"before\n{report.BEGIN}\nold\n{report.END}\nafter\n")
    assert report.between_markers(path, "new") == f"before\n{report.BEGIN}\n\nnew\n\n{report.END}\nafter\n"
    path.write_text("no markers")
    with pytest.raises(ValueError, match="two lines between which"):
        report.between_markers(path, "new")


def test_marl_evals_structure():
    runs = pd.concat([evaluations([[0.0, 4.0, 2.0]]), evaluations([[0.0, 9.0]], changed={"network": "gru"})])
    step = {"step_count": 1_250_000, "elapsed_time": 7200.0, "return": [4.0]}
    made = report.marl_eval(runs)
    seed = made["matrix"]["matrix-climbing"]["mappo_shared"]["seed_0"]
    assert list(seed) == ["step_0", "step_1", "step_2", "absolute_metrics"] and seed["step_1"] == step
    assert seed["absolute_metrics"] == {"return": [4.0]} and len(made["matrix"]["matrix-climbing"]) == 1
    json.dumps(made)


def make_results(folder, tasks):
    """Results of nine algorithms, both sharings, five seeds each, in folder/results."""
    rng = np.random.default_rng(0)
    for task, name, sharing in itertools.product(tasks, store.ALGORITHMS, (True, False)):
        curves = rng.uniform(0.3, 1) * np.linspace(0, 1, 21) + rng.normal(0, 0.02, (5, 21))
        for seed, curve in enumerate(curves.tolist()):
            directory = folder / "runs" / task / f"{name}-{sharing}-{seed}"
            make_run(directory, seed, curve, algorithm=name, env=task, parameter_sharing=sharing)
            store.collect(directory, folder / "results")


def write_report(monkeypatch, folder, *flags):
    """The report on folder/results, in folder/out."""
    folders = ["--results", str(folder / "results"), "--output", str(folder / "out")]
    monkeypatch.setattr(sys, "argv", ["report.py", *folders, *flags])
    report.main()


@pytest.mark.slow
def test_the_report_has_every_cell_of_the_results(monkeypatch, tmp_path):
    tasks = ["lbf-8x8-2p-2f-c", "lbf-8x8-2p-2f-2s-c"]
    make_results(tmp_path, tasks)
    write_report(monkeypatch, tmp_path, "--marl-eval", str(tmp_path / "m.json"))
    text = (tmp_path / "out" / "RESULTS.md").read_text(encoding="utf-8")
    assert all(f"| {task} | ours |" in text for task in tasks)
    cells = pd.read_csv(tmp_path / "out" / "tables.csv")
    assert list(dict.fromkeys(cells["algorithm"])) == list(store.ALGORITHMS) and set(cells["task"]) == set(tasks)
    assert (
        len(cells) == len(tasks) * 9 * 2 * 3 and cells.loc[cells["metric"] == "max_return", "paper_mean"].notna().any()
    )
    figures = {path.name for path in (tmp_path / "out" / "figures").iterdir()}
    assert {"curves-lbf-shared.svg", "normalised-shared.png", "profiles-independent.svg", "sharing.png"} <= figures
    assert json.loads((tmp_path / "m.json").read_text()).keys() <= store.FAMILIES.keys()


@pytest.mark.slow
def test_an_algorithm_of_your_own_is_reported_beside_the_papers(monkeypatch, tmp_path):
    make_results(tmp_path, ["matrix-climbing"])
    for sharing in ("shared", "independent"):
        best = pd.read_csv(tmp_path / "results" / "matrix-climbing" / f"mappo-{sharing}.csv")
        own = tmp_path / "results" / "matrix-climbing" / f"my_mappo-{sharing}.csv"
        best.assign(return_mean=2 * best["return_mean"] + 1).to_csv(own, index=False)
        settings = json.loads(own.with_name(f"mappo-{sharing}.json").read_text())
        for seed, rows in store.hash_rows(own.read_bytes()).items():
            settings["seeds"][seed]["rows"] = rows
        own.with_suffix(".json").write_text(json.dumps(settings | {"algorithm": "my_mappo"}))
    write_report(monkeypatch, tmp_path)
    lines = (tmp_path / "out" / "RESULTS.md").read_text(encoding="utf-8").splitlines()
    start = lines.index("### Maximum returns, with parameter sharing")
    assert lines[start + 2].endswith("| QMIX | MY_MAPPO |") and lines[start + 4].count("**") == 2
    assert lines[start + 4].split(" | ")[-1].startswith("**") and lines[start + 6].endswith("| - |")
    assert sum(line.startswith("| MY_MAPPO") for line in lines) == 6  # two tables of each sharing, two CPU lines
    drawn = (tmp_path / "out" / "figures" / "curves-matrix-shared.svg").read_text()
    assert "MY_MAPPO" in drawn and "stroke: #000000" in drawn


@pytest.mark.slow
def test_a_single_run_of_a_foreign_task_is_reported(monkeypatch, tmp_path):
    directory = make_run(tmp_path / "run", env="gymnasium:Some-v1", changed={"total_timesteps": 1000, "network": "gru"})
    store.collect(directory, tmp_path / "results")
    for changed in ({"total_timesteps": 1000}, {}):
        shutil.rmtree(directory)
        make_run(directory, env="gymnasium:Some-v1", changed=changed)
        write_report(monkeypatch, tmp_path)
        store.collect(directory, tmp_path / "results")
    write_report(monkeypatch, tmp_path)
    text = (tmp_path / "out" / "RESULTS.md").read_text(encoding="utf-8")
    assert "| gymnasium:Some-v1 | ours |  |  |  |  |  |  | 10.50 ¹ |" in text and "network gru" in text
    assert (tmp_path / "out" / "figures" / "curves-other-shared.png").exists()


def test_a_report_of_changed_flags_alone(monkeypatch, tmp_path, capsys):
    directory = make_run(tmp_path / "run", changed={"total_timesteps": 1000, "network": "gru"})
    store.collect(directory, tmp_path / "results")
    write_report(monkeypatch, tmp_path)
    text = (tmp_path / "out" / "RESULTS.md").read_text(encoding="utf-8")
    assert "1 run on 1 task. None of our values is of one of the paper's tasks with" in text and "network gru" in text
    assert not any(absent in text for absent in ("Where we do not agree", "| difference |", "not measured", "claim"))
    assert "## Figures" not in text and "## Over all tasks" not in text
    with pytest.raises(SystemExit):
        write_report(monkeypatch, tmp_path, "--marl-eval", str(tmp_path / "m.json"))
    assert "there are none" in capsys.readouterr().err and not (tmp_path / "m.json").exists()


def test_panels_say_on_how_many_tasks_each_algorithm_was_run():
    both = [evaluations([[0, 1]] * 2, algorithm=name) for name in ("mappo", "ia2c")]
    other = evaluations([[0, 1]] * 2, task="matrix-penalty-0", algorithm="ia2c")
    for runs, title, small in (
        (both, "Matrix games, 1 task", ""),
        ([*both, other], "Matrix games, 2 tasks", "run on so many of them: IA2C 2, MAPPO 1"),
    ):
        normalised = measures.normalise(pd.concat(runs))
        for figure in (plots.normalised_curves(normalised, "shared"), plots.profiles(normalised, "shared")):
            (panel,) = figure.axes
            assert panel.get_title() == title and [text.get_text() for text in panel.texts] == [small]
            plots.plt.close(figure)


def test_a_report_of_nothing_ends_in_a_sentence(run, tmp_path):
    done = run(report, "--results", tmp_path, "--output", tmp_path)
    assert done.returncode == 2 and "there are no results" in done.stderr


def test_a_marl_eval_file_that_cannot_be_written_leaves_all_as_it_was(monkeypatch, capsys, tmp_path):
    make_results(tmp_path, ["matrix-climbing"])
    with pytest.raises(SystemExit, match="2"):
        write_report(monkeypatch, tmp_path, "--marl-eval", str(tmp_path / "nowhere" / "m.json"))
    assert "m.json" in capsys.readouterr().err and not (tmp_path / "out").exists()


# ---------------------------------------------------------------------------------------------------- other programs


@pytest.mark.parametrize(
    "command, said",
    [
        ((collect, "nowhere"), "no runs in nowhere"),
        ((time_stepping, "--tasks", "nothing"), "unknown task 'nothing'"),
        ((time_training, "--env", "nothing"), "unknown task 'nothing'"),
        ((time_training, "--algorithms", "nothing"), "invalid choice: 'nothing'"),
        ((time_training, "--seconds", "0"), "--seconds must be a positive number"),
        ((time_training, "--", "--bogus"), "Unrecognized options: --bogus"),
    ],
)
@pytest.mark.slow
def test_wrong_input_is_named(command, said):
    """In processes, since a script that time_training.py times reads its flags in one of its own."""
    program, *flags = command
    done = programs.run([sys.executable, program.__file__, *flags])
    assert done.returncode == 2 and said in done.stderr


def test_stepping_counts_no_step_of_what_has_finished():
    """On the smallest map random agents collect the only food long before the 50th step."""
    counted = time_stepping.ours("lbf-5x5-2p-1f", 100)()
    env = envs.make("lbf-5x5-2p-1f", 2000)
    env.reset()
    totals = envs.EpisodeTotals(env)
    rng = np.random.default_rng(1)
    while not totals.ended.all():
        totals.add(*env.step(rng.integers(0, env.n_actions, (2000, 2)))[1:])
    assert counted == pytest.approx(100 * totals.means()["episode_length"], rel=0.1) and counted < 4000
    assert time_stepping.ours("matrix-climbing", 4)() == 100


def test_stepping_takes_the_best_of_five_measurements(monkeypatch):
    """Whatever else the machine does makes an environment slower, never faster."""
    clock = [0.0]
    durations = iter([9.0, 0.5, 0.5, 0.25, 0.25, 0.25, 0.25, 1.0, 2.0, 4.0])  # the first, before it counts, compiles

    def play():
        clock[0] += next(durations)
        return 100

    monkeypatch.setattr(time_stepping, "time", SimpleNamespace(process_time=lambda: clock[0]))
    assert time_stepping.rate(play, seconds=5.0) == 400
    assert not list(durations)


@pytest.mark.slow
def test_stepping_keeps_its_figures(run, tmp_path):
    file = tmp_path / "stepping.csv"
    file.write_text("task,whose,steps_per_second,processor,commit\nmatrix-climbing,old,1,x,y\nother,kept,2,x,y\n")
    flags = ["--tasks", "matrix-climbing", "--num-envs", "2", "--seconds", "0.1", "--output", file]
    done = run(time_stepping, *flags)
    assert done.returncode == 0 and "126,582" in done.stdout, done.stderr  # the paper's 0.079 s for 10,000
    found = pd.read_csv(file).set_index("whose")["steps_per_second"]
    assert list(found.index) == ["kept", "ours, num_envs=2"] and found.iloc[-1] > 1000
    speeds = store.speeds(tmp_path)
    assert set(speeds["whose"]) == {"the paper", "kept", "ours, num_envs=2"}


@pytest.mark.parametrize(
    "flags, said",
    [
        (["--num-envs", "0"], "must be positive"),
        (["--num-envs", "10000000000"], "does not fit into this machine's memory"),
        (["--seconds", "nan"], "must be positive"),
        (["--tasks", "matrix-climbing", "pettingzoo:nope"], "there is no module nope"),
        (["--output", "nowhere/speeds.csv"], "there is no folder nowhere"),
        (["--output", "."], "Is a directory"),
        (["--output", ROOT / "README.md"], "README.md is not a table of time_stepping.py"),
        (["--output", store.PAPER / "env_speed.csv"], "env_speed.csv is not a table of time_stepping.py"),
    ],
)
def test_wrong_input_of_stepping_is_named_before_it_begins(monkeypatch, run, tmp_path, flags, said):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(time_stepping, "rate", lambda *_: pytest.fail("it was timed"))
    done = run(time_stepping, *flags)
    assert done.returncode == 2 and said in done.stderr and not list(tmp_path.iterdir())


def test_stepping_does_not_make_its_own_commit_dirty(monkeypatch, run, tmp_path):
    """The commit is asked for once, before the first figures are written."""
    commits = iter(["clean", "dirty", "dirty"])
    origin = {"machine": {"processor": "x"}}
    monkeypatch.setattr(time_stepping.runs, "provenance", lambda: origin | {"commit": next(commits)})
    monkeypatch.setattr(time_stepping, "rate", lambda *_: 1.0)
    tasks = ["matrix-climbing", "matrix-penalty-0"]
    run(time_stepping, "--tasks", *tasks, "--num-envs", 1, "--output", tmp_path / "speeds.csv")
    table = store.read_speeds(tmp_path / "speeds.csv")
    assert list(table["task"]) == tasks and set(table["commit"]) == {"clean"}


@pytest.mark.parametrize(
    "flags, said",
    [
        (["--seeds", "0", "-1"], "--seed -1: the value must lie between"),
        (["--seeds", str(2**63)], "the value must lie between"),
        (["--runs", "file"], "Not a directory"),
    ],
)
def test_wrong_input_of_training_opponents_is_named(monkeypatch, run, tmp_path, flags, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    done = run(train_opponents, "--tasks", "mpe-tag", *flags)
    assert done.returncode == 2 and said in done.stderr and [path.name for path in tmp_path.iterdir()] == ["file"]


def test_timing_needs_no_room_for_a_whole_replay(monkeypatch, tmp_path):
    """One of QMIX's on the largest map takes 11 GiB."""
    monkeypatch.setattr(time_training.tempfile, "tempdir", str(tmp_path))
    sizes = []
    file = time_training.runs.EpisodeFile

    def noted(path, fields, size, played):
        sizes.append(size)
        return file(path, fields, size, played)

    monkeypatch.setattr(envs.runs.run, "EpisodeFile", noted)
    flags = ["--env", "matrix-climbing", "--batch-size", "4", "--hidden-dim", "8"]
    setting, (rate, *shares) = time_training.measure("vdn", flags, 0.05)
    assert rate > 0 and setting.endswith(" shared")
    assert sum(shares) == pytest.approx(1) and min(shares) > 0
    assert sizes == [80]


@pytest.mark.slow
def test_training_speed(monkeypatch, run):
    algorithms = ["mappo", "coma", "qmix", "maddpg", "iql"]
    monkeypatch.setattr(time_training, "TURNS", 1)
    words = ["--env", "matrix-climbing", "--seconds", "0.1", "--algorithms", *algorithms]
    lines = run(time_training, *words, "--", "--no-parameter-sharing").stdout.splitlines()
    kernels = [["plain"], ["plain", "fast"]][fast_mkl.LOADED]
    assert [(line.split()[0], line.split()[4]) for line in lines] == list(itertools.product(algorithms, kernels))
    assert all("independent" in line and "stepping" in line for line in lines)

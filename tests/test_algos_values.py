"""A value that one writes counts: in Args, in a row of PAPER, on the command line, for every flag of every script."""

import dataclasses
import re
import sys
import types
import typing

import pytest
from scripts import NAMES, ROOT, load_module, script

from envs import InputError, runs

OTHER_TASK = "gymnasium:CartPole-v1"  # of no family that the paper has
NOT_OF_A_TRAINING = {"env", "resume", "watch", "greedy", "run_dir", "device", "track", "start_from"}


def another(name, value, hint):
    """A value that the field does not have now, as Python."""
    choices = typing.get_args(hint)
    if choices:
        return next(choice for choice in choices if choice != value)
    if isinstance(value, bool):
        return not value
    if isinstance(value, str):
        return "k=1"
    return value / 2 if isinstance(value, float) else value + 1


def received(module, monkeypatch, words):
    """The Args that `train` gets from a command line."""
    seen: list = []
    monkeypatch.setattr(sys, "argv", [module.__file__, *words])
    runs.main(module.__file__, module.__doc__, module.Args, module.paper_defaults, seen.append, module.load)
    return seen[0]


def copy(tmp_path, text):
    path = tmp_path / "mine.py"
    path.write_text(text)
    return load_module(path)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("task", ["mpe-spread", OTHER_TASK])
def test_every_field(name, task, monkeypatch, tmp_path):
    """Another value in Args reaches `train`, and so does one on the command line."""
    source = (ROOT / "algos" / f"{name}.py").read_text()
    before = received(script(name), monkeypatch, ["--env", task])
    hints = typing.get_type_hints(script(name).Args)
    shared = {field.name for field in dataclasses.fields(runs.Flags)}
    fields = {flag: value for flag, value in vars(before).items() if flag not in NOT_OF_A_TRAINING}
    written = {flag: another(flag, value, hints[flag]) for flag, value in fields.items()}
    text = source
    for flag, value in written.items():
        if flag in shared:  # these stand in envs/runs; a script that wants another value declares the field anew
            continue
        text, found = re.subn(
            rf"^    {flag}: ([^=#]*?)( = \S+)?  # ", rf"    {flag}: \1 = {value!r}  # ", text, flags=re.M
        )
        assert found == 1, flag
    anew = [f"    {flag}: {type(value).__name__} = {value!r}\n" for flag, value in written.items() if flag in shared]
    text = text.replace("class Args(runs.Flags):\n", "class Args(runs.Flags):\n" + "".join(anew))
    edited = received(copy(tmp_path, text), monkeypatch, ["--env", task])
    assert {flag: getattr(edited, flag) for flag in written} == written

    words = [word for flag, value in written.items() for word in runs.flags.as_flag(flag, value).split(" ", 1)]
    given = received(script(name), monkeypatch, ["--env", task, *words])
    assert {flag: getattr(given, flag) for flag in written} == written


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("task, family", [("mpe-spread", "mpe"), (OTHER_TASK, "other")])
def test_every_column_of_the_paper_s_table(name, task, family, monkeypatch, tmp_path):
    source = (ROOT / "algos" / f"{name}.py").read_text()
    module = script(name)
    row = module.PAPER[family, "shared"]
    hints = typing.get_type_hints(module.Args)
    columns = module.TUNED.split()
    values = tuple(another(flag, value, hints[flag]) for flag, value in zip(columns, row, strict=True))
    text, found = re.subn(
        rf'^    \("{family}", "shared"\): .*$', f'    ("{family}", "shared"): {values!r},', source, flags=re.M
    )
    assert found == 1
    args = received(copy(tmp_path, text), monkeypatch, ["--env", task])
    assert tuple(getattr(args, flag) for flag in columns) == values


@pytest.mark.parametrize("task", ["lbf-8x8-2p-2f-v3", OTHER_TASK])
def test_values_of_the_task(task):
    """A task of a known family takes its row; any other one that of "other"."""
    args, module = script("mappo").paper_defaults(task), script("mappo")
    family = "lbf" if task.startswith("lbf") else "other"
    assert tuple(getattr(args, flag) for flag in module.TUNED.split()) == module.PAPER[family, "shared"]


def test_a_field_without_a_value_anywhere(tmp_path):
    text = (ROOT / "algos" / "mappo.py").read_text()
    module = copy(tmp_path, re.sub(r'^    \("(other|lbf)", .*\n', "", text, flags=re.M))
    with pytest.raises(
        InputError, match="network has no value in Args, and no row of PAPER gives one for lbf-8x8-2p-2f-c"
    ):
        module.paper_defaults()


def test_the_help_says_where_values_come_from(tmp_path, capsys):
    text = (ROOT / "algos" / "iql.py").read_text()
    text = text.replace("    hidden_dim: int  # from PAPER: width", "    hidden_dim: int = 77  # width")
    module = copy(tmp_path, text)
    with pytest.raises(SystemExit):
        runs.parse_flags(module.Args, module.paper_defaults, ["--help"], module.__doc__)
    words = " ".join(capsys.readouterr().out.split())
    assert "PAPER gives --network, --learning-rate, --epsilon-anneal" in words
    assert "the task gives --total-timesteps, --eval-points; Args gives all others." in words
    assert "width of all layers (default: 77)" in re.sub(r"[\s│]+", " ", words)


def test_a_range_in_an_annotation(tmp_path):
    text = (ROOT / "algos" / "iql.py").read_text().replace("import Any, ", "import Annotated, Any, ")
    line = "    gamma: float = 0.99  # discount\n"
    module = copy(tmp_path, text.replace(line, line + "    trace: Annotated[float, runs.Range(0, 1)] = 0.5  # decay\n"))

    def parse(*words):
        return runs.parse_flags(module.Args, module.paper_defaults, [*words], module.__doc__)

    assert parse("--trace", "0.75").trace == 0.75
    with pytest.raises(InputError, match=r"--trace 7\.0: the value must lie between 0 and 1"):
        parse("--trace", "7")


def test_a_part_that_needs_the_run_is_kept_and_restored(tmp_path, capsys):
    """Such as the priorities of a replay: it is in the checkpoints, and a resumed run has it."""
    text = (ROOT / "algos" / "iql.py").read_text()
    line = "        replay = Replay(args, env, storage, run)\n"
    text = text.replace(line, line + '        run.add_part("seen", Seen())\n')
    line = "    played = batch.played\n"
    text = text.replace(line, line + '    parts["seen"].updates += 1\n')
    text = text.replace("# --- update ---", SEEN + "\n\n# --- update ---")
    module = copy(tmp_path, text)
    args = module.paper_defaults("lbf-5x5-2p-1f")
    args.run_dir, args.eval_points, args.eval_episodes, args.total_timesteps = str(tmp_path / "run"), 2, 1, 10**6
    args.batch_size, args.hidden_dim = 2, 8
    stopped: list[int] = []

    class Interrupted(runs.Run):
        def stop_if_asked(self):
            """Ends, with a checkpoint, after so many updates."""
            if self.n_updates == stopped[-1]:
                self.save()
                self.log.close()
                raise KeyboardInterrupt

    module.runs = types.SimpleNamespace(**vars(runs) | {"Run": Interrupted})
    for number in (3, 7):
        stopped.append(number)
        with pytest.raises(KeyboardInterrupt):
            module.train(args)
        args.resume = True
        saved = runs.last_checkpoint(args.run_dir) or {}
        assert saved["parts"]["seen"] == {"updates": number} and saved["updates"] == number


SEEN = '''class Seen:
    """Counts updates."""

    updates = 0

    def state_dict(self):
        return {"updates": self.updates}

    def load_state_dict(self, state):
        self.updates = state["updates"]
'''

"""The exercises: wrong files are found by their check, in words, and the solutions do what the pages say."""

import sys
from typing import Any

import pytest
from scripts import ROOT, load_module

check_exercise = load_module(ROOT / "examples/check_exercise.py")
plant_fault = load_module(ROOT / "examples/plant_fault.py")


@pytest.fixture
def checked(monkeypatch, capsys):
    """checked(algorithm, path): the exit code of check_exercise.py and what it says."""

    def here(algorithm, path):
        monkeypatch.setattr(sys, "argv", ["check_exercise.py", algorithm, str(path)])
        monkeypatch.setitem(sys.modules, path.stem, None)  # so that afterwards all is as it was
        code: Any = 0
        try:
            check_exercise.main()
        except SystemExit as end:
            code = end.code
        said = capsys.readouterr()
        return code, said.out + said.err

    return here


def changed(path, algorithm, *replacements):
    """A script with other text in some places, each of which it has once."""
    text = (ROOT / "algos" / f"{algorithm}.py").read_text(encoding="utf-8")
    for right, wrong in replacements:
        assert text.count(right) == 1
        text = text.replace(right, wrong)
    path.write_text(text, encoding="utf-8")
    return path


FOUND = {
    1: "fc_shared, update 1 of 5: `loss/value` is ",
    2: "collect: `no_bootstrap` is True after a time-out",
    3: "fc_shared, update 1 of 5: after it, the weights are off by up to ",
}


@pytest.mark.parametrize("number", FOUND)
def test_each_planted_fault_is_found(checked, tmp_path, monkeypatch, number):
    fault = plant_fault.FAULTS[number - 1]
    path = tmp_path / "faulty.py"
    monkeypatch.setattr(sys, "argv", ["plant_fault.py", str(number), str(path)])
    plant_fault.main()
    original = ROOT / "algos" / f"{fault['script']}.py"
    assert path.read_text() == changed(tmp_path / "x.py", fault["script"], (fault["right"], fault["wrong"])).read_text()
    assert checked(fault["script"], original)[0] == 0
    code, said = checked(fault["script"], path)
    assert code == 1 and said.startswith(FOUND[number])
    assert number != 3 or "in the agents' target networks" in said
    with pytest.raises(SystemExit, match="2"):  # it exists now
        plant_fault.main()


def test_what_differs_first_is_said(checked, tmp_path):
    path = tmp_path / "mine.py"
    unclipped = "torch.minimum(ratios * advantages, clipped * advantages)", "ratios * advantages"
    code, said = checked("mappo", changed(path, "mappo", unclipped))
    assert code == 1 and "`loss/actor` is" in said
    code, said = checked("iql", changed(path, "iql", ("    optimiser.step()\n", "    optimiser.step()\n" * 2)))
    assert code == 1 and "the weights are off by up to" in said and "the optimiser's step" in said
    code, said = checked("iql", changed(path, "iql", ("* played.unsqueeze(-1)).sum()", ").mean()")))
    assert code == 1 and "`loss/value` is" in said
    code, said = checked("iql", changed(path, "iql", ("ended = terminated | truncated", "ended = terminated")))
    assert code == 1 and "stops: IndexError" in said
    code, said = checked("qmix", ROOT / "algos/vdn.py")
    assert code == 1 and "has no attribute 'Mixer'" in said
    code, said = checked("qmix", tmp_path / "nothing.py")
    assert code == 2 and said == f"check_exercise: {tmp_path / 'nothing.py'} is no Python file.\n"

"""Writes a script with a planted fault, to be found (docs/exercises/index.md, task 3).

    python examples/plant_fault.py 1 faulty.py

Fault 1 is in a copy of IQL, fault 2 in one of MAA2C, fault 3 in one of VDN. Who looks into examples/exercises/ finds
them without thinking.
"""

import argparse
import json
from pathlib import Path

from envs import InputError
from envs.runs import Parser, one_sentence

ROOT = Path(__file__).resolve().parents[1]
FAULTS = json.loads((ROOT / "examples/exercises/faults.json").read_text(encoding="utf-8"))


def faulty(number: int) -> str:
    """The text of a script with fault 1, 2 or 3."""
    fault = FAULTS[number - 1]
    text = (ROOT / "algos" / f"{fault['script']}.py").read_text(encoding="utf-8")
    before, right, after = text.partition(fault["right"])
    assert right, "the script has changed, and the fault's lines have not"
    return before + fault["wrong"] + after


@one_sentence(__file__)
def main() -> None:
    """See the module's docstring."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("number", type=int, choices=range(1, len(FAULTS) + 1))
    parser.add_argument("script", type=Path, help="the file to write")
    args = parser.parse_args()
    if args.script.exists():
        raise InputError(f"{args.script} exists, and is left as it is.")
    args.script.write_text(faulty(args.number), encoding="utf-8")


if __name__ == "__main__":
    main()

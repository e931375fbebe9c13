"""When it is imported, says in one sentence which packages are missing; a program would end in a traceback."""

import importlib.util
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# The dependencies of pyproject.toml, as they are imported
PACKAGES = "torch numpy gymnasium pettingzoo tyro tensorboard numba tqdm filelock psutil PIL".split()


def check() -> None:
    """Ends a program of this checkout with exit code 2 where packages are missing; to others the import says enough."""
    program = Path(sys.argv[0])
    if sys.argv[0] != "-m" and program.resolve().parent.parent != ROOT:  # -m: `python -m envs`, say
        return
    missing = [package for package in PACKAGES if importlib.util.find_spec(package) is None]
    if missing:
        name = sys.orig_argv[-len(sys.argv)] if sys.argv[0] == "-m" else program.stem
        install = f"python -m pip install -e '{ROOT}'"
        print(f"{name}: these packages are missing: {', '.join(missing)}; {install} installs them.", file=sys.stderr)
        sys.exit(2)


check()

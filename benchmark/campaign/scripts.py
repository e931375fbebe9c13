"""The scripts of algos/ as modules."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

ALGOS = Path(__file__).resolve().parents[2] / "algos"


def script_names() -> list[str]:
    """The algorithms: what lies in algos/ and has flags, but no modules that only help such scripts."""
    paths = sorted(path for path in ALGOS.glob("*.py") if not path.name.startswith("."))  # an editor's lock file
    return [path.stem for path in paths if "\nclass Args" in path.read_text(encoding="utf-8")]


def load_script(name: str) -> ModuleType:
    """algos/<name>.py as a module, made anew."""
    spec = importlib.util.spec_from_file_location(name, ALGOS / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where its flags and their help are looked for
    spec.loader.exec_module(module)
    return module

"""What imports what in the package: arrows between its folders point one way, and `import envs` is light."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import envs

PACKAGE = Path(envs.__file__).parent
FILES = sorted(path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py"))

# What runs use of the package itself; __file__: to see that it is ours
FUNCTIONS = tuple(f"envs.{name}" for name in "__file__ VectorEnv film make named_kwargs optional task".split())
# What the files of a folder import from this package, also inside functions
ALLOWED = {
    "needed.py": (),
    "vector.py": (),
    "workers.py": ("envs.vector",),
    "render.py": ("envs.vector",),
    "families": ("envs.families", "envs.vector", "envs.workers"),
    "pictures": ("envs.families", "envs.render"),
    "tasks.py": ("envs.families", "envs.vector"),
    "faults.py": (),
    "settings.py": (),
    "adapters": tuple(f"envs.{name}" for name in "adapters faults settings workers tasks vector make".split()),
    "check.py": ("envs.faults", "envs.settings", "envs.vector"),
    "__init__.py": tuple(f"envs.{name}" for name in "needed adapters families tasks vector render".split()),
    "runs": ("envs.runs", "envs.faults", "envs.tasks", "envs.vector", "envs.workers", *FUNCTIONS),
}


def imports(name: str) -> set[str]:
    """The modules that a file imports; of `import envs`, what it uses of the package."""
    tree = ast.parse((PACKAGE / name).read_text(encoding="utf-8"))
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names} - {"envs"}
        elif isinstance(node, ast.ImportFrom) and node.module == "envs":
            found |= {f"envs.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.module and not node.level
            found.add(node.module)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "envs":
            found.add(f"envs.{node.attr}")
    return found


@pytest.mark.parametrize("name", [name for name in FILES if name.partition("/")[0] in ALLOWED])
def test_arrows_point_one_way(name: str) -> None:
    allowed = ALLOWED[name.partition("/")[0]]
    own = {module for module in imports(name) if module.partition(".")[0] == "envs"}
    assert {module for module in own if not f"{module}.".startswith(tuple(f"{room}." for room in allowed))} == set()


def test_the_contract_needs_nothing_but_numpy_and_gymnasium() -> None:
    packages = {module.partition(".")[0] for module in imports("vector.py")}
    assert packages - sys.stdlib_module_names == {"numpy", "gymnasium"}


def test_what_is_really_missing_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Where an optional package is there, but one that it needs is not."""
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "a_package.py").write_text("import what_it_needs.inside\n")
    with pytest.raises(envs.InputError, match=r"^a_package needs what_it_needs, which is not installed"):
        envs.optional("a_package")
    with pytest.raises(envs.InputError, match=r"^another_package is not installed; pip install -e '\.\[an_extra\]'"):
        envs.optional("another_package", "an_extra")


def test_importing_envs_is_light() -> None:
    """What only a run, a picture or a compiled rule needs is imported where it is used."""
    heavy = "numba PIL matplotlib torch tyro filelock psutil tqdm pettingzoo pandas".split()
    code = f"import sys, envs; envs.task_names(); print(envs.optional.__name__, *sys.modules.keys() & set({heavy}))"
    environment = {**os.environ, "PYTHONPATH": str(PACKAGE.parent)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == "optional\n"

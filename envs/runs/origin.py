"""Where a result comes from: command, packages, commit, machine, the text of a script."""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
import platform
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

from envs.runs import fast_mkl

PACKAGES = ("torch", "numpy", "gymnasium", "numba")


def script_hash(script: str | os.PathLike[str]) -> str:
    """Names the text of a script."""
    return hashlib.sha256(Path(script).read_bytes()).hexdigest()[:16]


def provenance() -> dict[str, Any]:
    """Where a result came from, in plain types: command, packages, commit, machine, MKL's fast kernels."""
    return {
        "command": sys.argv,
        "python": platform.python_version(),
        "versions": {name: importlib.metadata.version(name) for name in PACKAGES},
        "commit": _commit(),
        "machine": {"system": platform.platform(), "processor": _processor(), "cores": os.cpu_count()},
        "fast_mkl": fast_mkl.LOADED,
    }


def project_version() -> str:
    """This project's version. A checkout says it itself, and need not be installed."""
    project = Path(__file__).parents[2] / "pyproject.toml"
    if project.exists():
        return tomllib.loads(project.read_text(encoding="utf-8"))["project"]["version"]
    return importlib.metadata.version("marl-baselines")


def _commit() -> str | None:
    """The checkout's commit, "-dirty" behind it where files were changed; None outside a checkout."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    if not Path(__file__).parents[2].joinpath(".git").exists():  # installed somewhere, perhaps in another checkout
        return None
    try:
        done = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, timeout=10)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() or None


def _processor() -> str:
    """The processor's model; `platform` knows only its architecture on Linux."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor()

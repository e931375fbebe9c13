"""Faster matrix products in PyTorch on AMD processors.

PyTorch's matrix products come from Intel's library MKL, which takes slower kernels where the processor does not say
that it is Intel's. It asks a function of its own, `mkl_serv_intel_cpu_true`. A library that is loaded before PyTorch
and answers yes makes it take the fast ones, which choose their instructions by what the processor has. Results differ
in rounding. `from envs import runs` does this, and the environment variable MARL_FAST_MKL=0 switches it off.
"""

from __future__ import annotations

import ctypes
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

SOURCE = "int mkl_serv_intel_cpu_true(void) { return 1; }\n"
SWITCH = "MARL_FAST_MKL"
CPUINFO = Path("/proc/cpuinfo")


def is_amd() -> bool:
    """Whether this is Linux on a 64-bit AMD processor. Elsewhere nothing is to be gained."""
    if sys.platform != "linux" or platform.machine() != "x86_64":
        return False
    return "AuthenticAMD" in CPUINFO.read_text(encoding="utf-8", errors="replace")


def build() -> Path:
    """The library, made with the system's compiler into the user's cache unless it is there.

    Raises OSError, RuntimeError (no home directory) or subprocess.SubprocessError where that cannot be done.
    """
    cache = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    library = cache / "marl-baselines" / "fast-mkl.so"
    if library.exists():
        return library
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if compiler is None:
        raise OSError("there is no C compiler")
    library.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:  # so that it appears whole
        made = Path(folder, library.name)
        command = [compiler, "-shared", "-fPIC", "-x", "c", "-", "-o", str(made)]
        subprocess.run(command, input=SOURCE, text=True, capture_output=True, check=True, timeout=10)
        made.replace(library)
    return library


def load() -> bool:
    """Loads the library into this process, and says whether PyTorch will use it.

    It is left out without a word where it is switched off or cannot be had, and where PyTorch is loaded already, which
    looks for the function only once.
    """
    if os.environ.get(SWITCH) == "0" or "torch" in sys.modules:
        return False
    try:
        if not is_amd():
            return False
        ctypes.CDLL(str(build()), mode=ctypes.RTLD_GLOBAL)
    except (OSError, RuntimeError, subprocess.SubprocessError):
        return False
    return True


LOADED = load()

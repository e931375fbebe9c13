"""Faster matrix products on processors that are not Intel's.

PyTorch's matrix products come from Intel's library MKL, which takes slower kernels where the processor does not say
that it is Intel's. It asks a function of its own, `mkl_serv_intel_cpu_true`. A library that answers yes, preloaded into
the process (LD_PRELOAD), makes it take the fast ones. Results then differ in rounding. config.json tells what a run had
preloaded.

This file uses the standard library alone: on a cluster it is sent to nodes that may lack the rest.
"""

import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

SOURCE = "int mkl_serv_intel_cpu_true(void) { return 1; }\n"


class NotPossible(Exception):
    """Why the fast kernels cannot be had, or are not needed; the message is one sentence."""


def build() -> Path:
    """The library, made with the system's compiler into the user's cache unless it is there. Raises NotPossible."""
    if sys.platform != "linux" or platform.machine() != "x86_64":
        raise NotPossible("the library is for Linux on 64-bit x86 processors")
    if "GenuineIntel" in Path("/proc/cpuinfo").read_text():
        raise NotPossible("the processor is Intel's and has the fast kernels already")
    try:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    except RuntimeError:
        raise NotPossible("there is no home directory to keep the library in") from None
    library = cache / "marl-baselines" / "fast-mkl.so"
    if set(str(library)) & {" ", ":"}:
        raise NotPossible(f"nothing can be preloaded from {library.parent}, whose name has a space or a colon")
    if library.exists():
        return library
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if compiler is None:
        raise NotPossible("there is no C compiler (cc, gcc or clang)")
    try:
        library.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=library.parent) as folder:  # so that it appears whole
            made = Path(folder) / library.name
            command = [compiler, "-shared", "-fPIC", "-x", "c", "-", "-o", str(made)]
            subprocess.run(command, input=SOURCE, text=True, capture_output=True, check=True)
            made.replace(library)
    except subprocess.CalledProcessError as error:
        raise NotPossible(f"{compiler} says: {error.stderr.strip()}") from None
    except OSError as error:
        raise NotPossible(str(error)) from None
    return library


def preload() -> str:
    """LD_PRELOAD for new processes: the library before what is preloaded already. Raises NotPossible."""
    library, others = str(build()), os.environ.get("LD_PRELOAD", "")
    return others if library in others.split(":") else ":".join(filter(None, [library, others]))

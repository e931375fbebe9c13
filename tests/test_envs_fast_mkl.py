"""MKL's fast kernels: loaded before PyTorch and only then, switched off by a variable, and no condition of anything."""

import ctypes
import json
import os
import subprocess
import sys

import pytest
from scripts import ROOT

from envs.runs import fast_mkl

SAYS_YES = "getattr(ctypes.CDLL(None), 'mkl_serv_intel_cpu_true', None) is not None"
PRODUCT = """
from envs import runs
import torch
torch.manual_seed(0)
torch.save((torch.randn(1500, 128) @ torch.randn(128, 128)), {!r})
"""


def python(program, **variables):
    return subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True, env=os.environ | variables
    ).stdout.strip()


def can_be_built():
    try:
        return fast_mkl.is_amd() and fast_mkl.build().exists()
    except (OSError, RuntimeError, subprocess.SubprocessError):
        return False


needs_library = pytest.mark.skipif(not can_be_built(), reason="needs Linux, an AMD processor and a C compiler")


@needs_library
@pytest.mark.parametrize(
    "imports, switch, loaded",
    [
        ("envs.runs, torch", "", True),
        ("envs.runs, torch", "0", False),
        ("torch, envs.runs", "", False),
        ("envs, torch", "", False),
    ],
)
@pytest.mark.slow
def test_it_is_loaded_before_pytorch_unless_it_is_switched_off(imports, switch, loaded):
    said = python(f"import ctypes, {imports}; print({SAYS_YES})", MARL_FAST_MKL=switch)
    assert said == str(loaded)


@needs_library
def test_it_is_built_once(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    library = fast_mkl.build()
    assert [path.name for path in library.parent.iterdir()] == ["fast-mkl.so"]
    assert ctypes.CDLL(str(library)).mkl_serv_intel_cpu_true() == 1
    monkeypatch.setenv("PATH", "")
    assert fast_mkl.build() == library


@needs_library
@pytest.mark.slow
def test_products_are_what_they_were_within_rounding(tmp_path):
    import torch

    products = []
    for switch in ("", "0"):
        path = str(tmp_path / f"product{switch}.pt")
        python(PRODUCT.format(path), MARL_FAST_MKL=switch)
        products.append(torch.load(path))
    torch.testing.assert_close(*products, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize(
    "obstacle", ["no Linux", "Intel", "no compiler", "a compiler that fails", "no home", "no room"]
)
def test_it_is_left_out_where_it_cannot_be_had(monkeypatch, tmp_path, obstacle):
    processor = tmp_path / "cpuinfo"
    processor.write_text("vendor_id : GenuineIntel" if obstacle == "Intel" else "vendor_id : AuthenticAMD")
    monkeypatch.setattr(fast_mkl, "CPUINFO", processor)
    monkeypatch.setattr(fast_mkl.platform, "machine", lambda: "x86_64")
    monkeypatch.setattr(fast_mkl.sys, "platform", "win32" if obstacle == "no Linux" else "linux")
    monkeypatch.delitem(sys.modules, "torch", raising=False)
    monkeypatch.delenv("MARL_FAST_MKL", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(processor if obstacle == "no room" else tmp_path / "cache"))
    compilers = tmp_path / "bin"
    compilers.mkdir()
    if obstacle != "no compiler":
        (compilers / "cc").write_text(f"#!/bin/sh\nexit {int(obstacle == 'a compiler that fails')}\n")
        (compilers / "cc").chmod(0o755)
    monkeypatch.setenv("PATH", f"{compilers}:/bin" if obstacle != "no compiler" else str(compilers))
    if obstacle == "no home":
        monkeypatch.delenv("XDG_CACHE_HOME")
        monkeypatch.setattr(fast_mkl.Path, "expanduser", no_home)
    opened = []
    monkeypatch.setattr(fast_mkl.ctypes, "CDLL", lambda path, mode: opened.append(path))
    assert not fast_mkl.load()
    assert not opened


def no_home(path):
    raise RuntimeError("Could not determine home directory.")


@pytest.mark.slow
def test_mappo_trains_without_a_compiler_and_says_so(tmp_path):
    variables = {"MARL_FAST_MKL": "", "PATH": "", "XDG_CACHE_HOME": str(tmp_path / "cache")}
    flags = "--env matrix-climbing --total-timesteps 500 --eval-points 2 --eval-episodes 2".split()
    subprocess.run(
        [sys.executable, str(ROOT / "algos/mappo.py"), *flags, "--run-dir", str(tmp_path / "run")],
        check=True,
        env=os.environ | variables,
    )
    config = json.loads((tmp_path / "run" / "config.json").read_text())
    assert config["fast_mkl"] is False

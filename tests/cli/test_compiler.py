"""Commands set XLA's fast code generator and the CPU platform unless the user sets them."""

import os

import jaxlib.version
import pytest

from trinoc.cli.main import compile_quickly

EMITTERS, SPLIT = "--xla_cpu_use_fusion_emitters", "--xla_cpu_parallel_codegen_split_count"


@pytest.mark.parametrize(
    ("version", "flags", "expected"),
    [
        ("0.10.2", None, f"{EMITTERS}=false {SPLIT}=1"),
        ("0.10.2", "--xla_a=1", f"{EMITTERS}=false {SPLIT}=1 --xla_a=1"),
        ("0.10.2", f"{EMITTERS}=true", f"{SPLIT}=1 {EMITTERS}=true"),
        ("0.11.0", None, None),
        ("0.100.0", "--xla_a=1", "--xla_a=1"),
    ],
)
def test_only_versions_that_know_the_flag_get_it(monkeypatch, version, flags, expected) -> None:
    monkeypatch.setattr(jaxlib.version, "__version__", version)
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    if flags is not None:
        monkeypatch.setenv("XLA_FLAGS", flags)
    compile_quickly()
    compile_quickly()
    assert os.environ.get("XLA_FLAGS") == expected


@pytest.mark.parametrize(("platforms", "expected"), [(None, "cpu"), ("cuda,cpu", "cuda,cpu")])
def test_commands_leave_a_gpu_alone_that_nobody_names(monkeypatch, platforms, expected) -> None:
    monkeypatch.setenv("XLA_FLAGS", "")
    monkeypatch.delenv("JAX_PLATFORMS", raising=False)
    if platforms is not None:
        monkeypatch.setenv("JAX_PLATFORMS", platforms)
    compile_quickly()
    assert os.environ.get("JAX_PLATFORMS") == expected

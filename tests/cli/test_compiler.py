"""The commands choose XLA's quicker code generator and processors; users have the last word."""

import os

import jaxlib.version
import pytest

from trinoc.cli.main import compile_quickly


@pytest.mark.parametrize(
    ("version", "own", "expected"),
    [
        ("0.10.2", None, "--xla_cpu_use_fusion_emitters=false"),
        ("0.10.2", "--xla_a=1", "--xla_cpu_use_fusion_emitters=false --xla_a=1"),
        ("0.10.2", "--xla_cpu_use_fusion_emitters=true", "--xla_cpu_use_fusion_emitters=true"),
        ("0.11.0", None, None),
        ("0.100.0", "--xla_a=1", "--xla_a=1"),
    ],
)
def test_only_versions_that_know_the_flag_get_it(monkeypatch, version, own, expected) -> None:
    monkeypatch.setattr(jaxlib.version, "__version__", version)
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    if own is not None:
        monkeypatch.setenv("XLA_FLAGS", own)
    compile_quickly()
    compile_quickly()
    assert os.environ.get("XLA_FLAGS") == expected


@pytest.mark.parametrize(("own", "expected"), [(None, "cpu"), ("cuda,cpu", "cuda,cpu")])
def test_commands_leave_a_gpu_alone_that_nobody_names(monkeypatch, own, expected) -> None:
    monkeypatch.setenv("XLA_FLAGS", "")
    monkeypatch.delenv("JAX_PLATFORMS", raising=False)
    if own is not None:
        monkeypatch.setenv("JAX_PLATFORMS", own)
    compile_quickly()
    assert os.environ.get("JAX_PLATFORMS") == expected

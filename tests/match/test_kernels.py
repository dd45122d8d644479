"""The matcher's kernels contain no call to the host and give the same results in NumPy."""

import importlib
from typing import Any

import jax
import numpy as np
import pytest

from tests.match.made import loose_lines, pictures, rig_of
from trinoc.match import match_many
from trinoc.match.matcher import match_segments
from trinoc.match.tracks.matches import Matches
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.numerics import buckets, programs
from trinoc.numerics.tables import with_field

KERNELS = {
    "candidates.search": ["_predict_pairs", "_passes_gate"],
    "candidates.triples": ["_fit_triples", "_triple_evidence"],
    "selection.messages": ["_propagate"],
    "occlusion.possible_pairs": ["_pair_evidence"],
    "tracks.line_fit": ["_triangulate_tracks"],
}
COUNT = 20


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> dict[str, tuple[Any, tuple, dict]]:
    """Kernel and arguments of the last call of each kernel, by name."""
    last_calls = {}
    for room, names in KERNELS.items():
        module = importlib.import_module(f"trinoc.match.{room}")
        for name in names:
            kernel = getattr(module, name)

            def recorded(*args, kernel=kernel, key=f"{room}.{name}", **kwargs):
                last_calls[key] = kernel, args, kwargs
                return kernel(*args, **kwargs)

            monkeypatch.setattr(module, name, recorded)
    return last_calls


def doubled(seed: int) -> dict:
    """Pictures of lines with a second segment, a rival, beside each."""
    lines_mm = loose_lines(COUNT // 2, seed)
    pictures_px = pictures(rig_of("upper", "left", "right"), lines_mm, sigma_px=0.3, seed=seed)
    return {name: np.concatenate([ends, ends + 0.7]) for name, ends in pictures_px.items()}


@pytest.mark.parametrize("frames", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_no_kernel_calls_the_host_on_a_gpu(calls, frames: int) -> None:
    rig = rig_of("upper", "left", "right")
    frames_px = [doubled(seed) for seed in range(frames)]
    batch = match_many(frames_px, rig)
    assert (batch.status == "ok").all()
    assert set(calls) == {f"{room}.{name}" for room, names in KERNELS.items() for name in names}
    for name, (kernel, args, kwargs) in calls.items():
        with jax.enable_x64(True):
            traced = jax.jit(lambda: kernel(*args, **kwargs)).trace()  # noqa: B023
            lowered = traced.lower(lowering_platforms=("cuda",))
        program = lowered.as_text()
        assert "stablehlo" in program
        for word in ("custom_call", "callback", "infeed", "outfeed", "send", "recv"):
            assert word not in program, f"{name} has a {word}"


def test_few_candidates_are_judged_in_numpy_as_many_are_by_programs(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    # A tuning of its own, for which nothing is compiled yet.
    tuning = with_field(DEFAULT, "candidates.gate_slack", 1.12)
    pictures_px, rig = doubled(5), rig_of("upper", "left", "right")
    monkeypatch.setattr(programs, "_stores", [None])

    def match() -> tuple[Matches, set[str]]:
        caplog.clear()
        with jax.log_compiles(), caplog.at_level("WARNING"):
            matches = match_segments(pictures_px, rig, tuning=tuning)
        messages = " ".join(r.getMessage() for r in caplog.records)
        judges = {"_fit_triples", "_triple_evidence", "_pair_evidence"}
        return matches, {name for name in judges if name in messages}

    few, compiled = match()
    assert compiled == set()
    for module in (buckets, programs):
        monkeypatch.setattr(module, "FEW_ROWS", -1)
    many, compiled = match()
    assert compiled == {"_fit_triples", "_triple_evidence", "_pair_evidence"}
    assert len(few) == len(many) > 10
    np.testing.assert_array_equal(few.index, many.index)
    np.testing.assert_allclose(few.posterior, many.posterior, rtol=1e-9)
    np.testing.assert_allclose(few.lines_mm, many.lines_mm, rtol=1e-9, atol=1e-9)

"""The tuned constants of the matcher: one value, passed to every step."""

import dataclasses
import importlib
import inspect
import pkgutil

import jax
import numpy as np
import pytest

import trinoc.match
from tests.match.made import loose_lines, pictures, rig_of
from trinoc.match import join_collinear, snap_corners
from trinoc.match.matcher import match_segments
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.numerics.tables import with_field

VIEWS = ("upper", "left", "right")


@pytest.fixture(scope="module")
def scene():
    rig = rig_of(*VIEWS)
    return pictures(rig, loose_lines(30, seed=3), sigma_px=0.4, seed=4), rig


def test_the_default_is_what_no_argument_means(scene):
    plain, with_default = match_segments(*scene), match_segments(*scene, tuning=MatchTuning())
    for one, other in zip(jax.tree.leaves(plain), jax.tree.leaves(with_default), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_swept_field_changes_the_answer(scene):
    plain = match_segments(*scene)
    narrow = match_segments(*scene, tuning=with_field(DEFAULT, "candidates.gate", 0.5))
    assert narrow.counts["triples considered"] < plain.counts["triples considered"]
    tempting = match_segments(*scene, tuning=with_field(DEFAULT, "evidence.log_odds_offset", 3.0))
    assert tempting.posterior.mean() > plain.posterior.mean()


def test_options_are_hashable_frozen_and_changed_by_name():
    changed = with_field(DEFAULT, "selection.damping", 0.5)
    assert changed.selection.damping == 0.5
    assert changed != DEFAULT
    assert with_field(changed, "selection.damping", DEFAULT.selection.damping) == DEFAULT
    assert len({DEFAULT, MatchTuning(), changed}) == 2
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(DEFAULT.selection, "damping", 0.5)  # noqa: B010
    with pytest.raises(ValueError, match="Choose one of"):
        with_field(DEFAULT, "selection.dampening", 0.5)


def functions_of_the_matcher():
    for file in pkgutil.walk_packages(trinoc.match.__path__, "trinoc.match."):
        module = importlib.import_module(file.name)
        for name, function in vars(module).items():
            if inspect.isfunction(function) and function.__module__ == file.name:
                yield name, inspect.unwrap(function)


def test_every_step_is_handed_the_tuning_and_falls_back_on_no_default(scene, monkeypatch):
    groups = {id(group) for group in (DEFAULT, *vars(DEFAULT).values())}
    without = []
    for name, function in functions_of_the_matcher():
        defaults, by_name = function.__defaults__ or (), function.__kwdefaults__ or {}
        if groups & {id(value) for value in (*defaults, *by_name.values())}:
            poisoned = tuple(None if id(value) in groups else value for value in defaults)
            monkeypatch.setattr(function, "__defaults__", poisoned)
            poisoned = {k: None if id(v) in groups else v for k, v in by_name.items()}
            monkeypatch.setattr(function, "__kwdefaults__", poisoned)
            without.append(name)
    assert {"match_segments", "triple_evidence", "fit_line"} <= set(without)
    jax.clear_caches()
    matches = match_segments(*scene, tuning=DEFAULT)
    assert len(snap_corners(join_collinear(matches, scene[1], tuning=DEFAULT), tuning=DEFAULT)) == 0

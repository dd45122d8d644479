"""Shadows of boxes on a table: marked where a lamp is, none where there is no lamp or no plane."""

import dataclasses

import jax
import numpy as np
import pytest

from tests.match.made import loose_lines, pictures
from tests.match.shadows.made_shadows import NEAR_LAMP, scene_of, unit_toward
from trinoc.errors import InputError
from trinoc.match import MatchTuning, find_shadows
from trinoc.match.matcher import match_segments
from trinoc.match.tuning.bodies import ShadowTuning


@pytest.fixture(scope="module")
def lit():
    """(rig, segments, matches, which are shadows, what was found) under a lamp."""
    rig, segments, matches, shadow = scene_of(NEAR_LAMP)
    return rig, segments, matches, shadow, find_shadows(matches, segments, rig)


def test_shadows_are_marked_and_edges_are_not(lit) -> None:
    _, _, matches, shadow, found = lit
    assert shadow.sum() == 16
    assert found.shadow[shadow].min() > 0.9
    assert found.shadow[~shadow].max() < 0.5
    assert found.mark(matches).marks["shadow"] is found.shadow


def test_the_lamp_is_found_within_its_errors(lit) -> None:
    found = lit[4]
    assert found.lamp_known
    true = unit_toward(NEAR_LAMP, found.middle_mm)
    off = np.degrees(np.arccos(np.clip(found.toward_lamp @ true, -1, 1)))
    assert off < 3 * found.lamp_sigma_deg < 1.0
    nearness = 1 / np.linalg.norm(NEAR_LAMP[:3] - found.middle_mm)
    assert abs(found.nearness_per_mm - nearness) < 3 * np.sqrt(found.lamp_covariance[2, 2])
    # The same in homogeneous coordinates.
    place = found.lamp_mm[:3] / found.lamp_mm[3] - found.middle_mm
    np.testing.assert_allclose(place / np.linalg.norm(place), found.toward_lamp, atol=1e-12)


def test_the_order_of_tracks_says_nothing(lit) -> None:
    rig, segments, matches, _, found = lit
    order = np.random.default_rng(5).permutation(len(matches))
    fields = (
        *("index", "fragments_px", "lines_mm", "covariance_mm2", "stage", "posterior"),
        *("rival_posterior", "fragments_covariance_px2", "misfit", "viewpoint_dependent"),
    )
    other = dataclasses.replace(
        matches, **{name: np.asarray(getattr(matches, name))[order] for name in fields}
    )
    again = find_shadows(other, segments, rig)
    np.testing.assert_allclose(again.shadow, found.shadow[order], atol=0.02)
    np.testing.assert_allclose(again.toward_lamp, found.toward_lamp, atol=2e-3)


def test_without_a_lamp_nothing_is_marked() -> None:
    rig, segments, matches, _ = scene_of(None)
    found = find_shadows(matches, segments, rig)
    assert not found.lamp_known
    assert found.shadow.max() < 0.5


def test_among_more_lines_than_were_measured_no_lamp_is_looked_for(lit) -> None:
    rig, segments, matches, _, _ = lit
    few = dataclasses.replace(ShadowTuning(), most_lines=10)
    found = find_shadows(matches, segments, rig, tuning=MatchTuning(shadows=few))
    assert found.lamp_posterior == 0.0
    assert found.shadow.max() < 0.1
    assert len(found.shadow) == len(matches)


def test_without_a_plane_nothing_is_marked(lit) -> None:
    rig = lit[0]
    segments = pictures(rig, loose_lines(3, seed=4), 0.05)
    matches = match_segments(segments, rig)
    found = find_shadows(matches, segments, rig)
    assert (found.lamp_posterior, found.counts["planes"]) == (0.0, 0)
    assert found.shadow.max() < 0.5
    none = find_shadows(jax.tree.map(_no_rows(matches), matches), segments, rig)
    assert none.shadow.shape == (0,)


def _no_rows(matches):
    return lambda leaf: leaf[:0] if np.shape(leaf)[:1] == (len(matches),) else leaf


def test_segments_of_every_view_are_needed(lit) -> None:
    rig, segments, matches, _, _ = lit
    with pytest.raises(InputError, match="needs the segments of every view"):
        find_shadows(matches, {"upper": segments["upper"]}, rig)

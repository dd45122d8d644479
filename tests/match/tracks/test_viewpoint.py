"""Outlines of round bodies, which differ from camera to camera, are rejected or marked."""

import numpy as np
import pytest
from scipy.stats import chi2

from simulation.solids import Cylinder
from tests.match.made import loose_lines, pictures, rig_of
from trinoc.geometry.rig import Rig
from trinoc.match.matcher import match_segments
from trinoc.match.tracks.matches import BINOCULAR, TRINOCULAR

VIEWS = ("upper", "left", "right")


def with_cylinders(rig: Rig, radius_mm: float, lines_mm: np.ndarray, sigma_px: float, seed: int):
    """(pictures of the outlines of six cylinders, then of the lines; outlines per picture)."""
    rng = np.random.default_rng(seed)
    feet = np.append(np.mgrid[-50:51:50, -30:31:60].reshape(2, -1).T, np.zeros((6, 1)), axis=1)
    pictures_px = {}
    for name, camera in rig.items():
        outlines = [
            Cylinder(foot, radius_mm, 35.0, 96).silhouette_mm(camera.centre_world_mm)
            for foot in feet
        ]
        image = pictures(Rig({name: camera}), np.concatenate([*outlines, lines_mm]))[name]
        pictures_px[name] = image + sigma_px * rng.normal(size=image.shape)
    return pictures_px, 2 * len(feet)


def test_outlines_that_move_with_the_viewpoint_are_rejected_or_marked() -> None:
    rig, lines = rig_of(*VIEWS), loose_lines(40, seed=21)
    for radius in (3.0, 5.0):
        pictures_px, outlines = with_cylinders(rig, radius, lines, 0.1, seed=4)
        matches = match_segments(pictures_px, rig, sigma_px=0.1)
        assert matches.viewpoint_dependent is not None
        in_three = matches.stage == TRINOCULAR
        round_body = in_three & (matches.index.max(axis=1) < outlines)
        assert matches.viewpoint_dependent[round_body].all()
        assert round_body.sum() < outlines / 2
        same = (matches.index == matches.index.max(axis=1)[:, None]) | (matches.index < 0)
        pairs = (matches.stage == BINOCULAR) & same.all(axis=1)
        pairs &= matches.index.max(axis=1) < outlines
        assert matches.viewpoint_dependent[pairs].sum() >= 0.8 * pairs.sum()
        assert matches.viewpoint_dependent[in_three & ~round_body].sum() <= 3
        assert (
            matches.counts["tracks that seem to move with the viewpoint"]
            == matches.viewpoint_dependent.sum()
        )


def test_outlines_of_thin_bodies_are_lines() -> None:
    # An outline moves by a hundredth of a millimetre here.
    rig, lines = rig_of(*VIEWS), loose_lines(40, seed=22)
    pictures_px, outlines = with_cylinders(rig, 0.1, lines, 0.1, seed=5)
    matches = match_segments(pictures_px, rig, sigma_px=0.1)
    assert matches.viewpoint_dependent is not None
    straight = (matches.stage == TRINOCULAR) & (matches.index[:, 0] < outlines)
    assert straight.sum() >= outlines - 2
    assert matches.viewpoint_dependent[straight].sum() <= 1


@pytest.mark.parametrize("sigma_px", [0.1, 0.4])
def test_misfit_of_straight_lines_is_chi_square(sigma_px: float) -> None:
    rig = rig_of(*VIEWS)
    misfit = []
    for seed in range(4):
        pictures_px = pictures(rig, loose_lines(50, seed), sigma_px=sigma_px, seed=seed + 9)
        matches = match_segments(pictures_px, rig, sigma_px=sigma_px)
        right = (matches.index == matches.index[:, :1]).all(axis=1)
        assert matches.misfit is not None
        misfit.extend(matches.misfit[right])
    assert len(misfit) > 180
    rank = chi2.cdf(np.array(misfit), 2)
    # What fits worst is not matched: 5 in 100,000.
    assert abs(rank.mean() - 0.5) < 4 / np.sqrt(12 * len(misfit))
    assert 0.01 < (rank > 0.95).mean() < 0.1

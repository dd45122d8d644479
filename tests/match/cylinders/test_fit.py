"""Cylinders fitted to outlines: the optimum, its weights, and where axes end."""

import numpy as np
import pytest
from scipy.stats import norm

from tests.match.cylinders.made_outlines import Placed, nothing_matched, seen_by
from tests.match.made import rig_of
from trinoc.match.bodies.cylinder_fit import ROUND, STRAIGHT, Members, fit_cylinders
from trinoc.match.bodies.cylinder_search import place_ends
from trinoc.match.bodies.outlines import Outlines, possible_outlines, ray_axis_distances
from trinoc.match.observations.match_input import prepare
from trinoc.match.tuning.every_group import DEFAULT as TUNING
from trinoc.numerics.tables import with_field
from trinoc.numerics.vectors import complete_axes

ERRORS = TUNING.collinear
VIEWS = ("upper", "left", "right")
TRUE = Placed(7.0, 45.0, turn=(0.2, 1.1, 0.0), shift_mm=(-25.0, 5.0, 12.0))


def outlines(sigma_px: float, seed: int, wrong_px: float = 0.0) -> tuple[Outlines, Members]:
    """The table of both outlines in three views, of which one segment may lie aside."""
    rig = rig_of(*VIEWS)
    segments = seen_by(rig, [TRUE], sigma_px=sigma_px, seed=seed)
    seen = prepare(segments, rig, None)
    table = possible_outlines(seen, nothing_matched(segments), TUNING.cylinders)
    way = np.diff(TRUE.axis_mm, axis=0)[0]
    way = way / np.linalg.norm(way)
    side = np.sign(ray_axis_distances(table.rays, TRUE.axis_mm[0], way).distance_mm.mean(axis=1))
    if wrong_px:
        rays = table.rays.ray.copy()
        rays[0] += wrong_px * table.rays.slope[0]
        table = table._replace(rays=table.rays._replace(ray=rays))
    return table, Members(np.arange(len(side))[None], side[None])


def start():
    way = np.diff(TRUE.axis_mm, axis=0)
    way = way / np.linalg.norm(way)
    return TRUE.axis_mm[:1], way, np.array([TRUE.solid.radius_mm])


def converged(table, members, parameters=ROUND):
    fits = fit_cylinders(table, members, *start(), TUNING, parameters)
    for _ in range(8):
        fits = fit_cylinders(table, members, *fits[:3], TUNING, parameters)
    return fits


def log_likelihood(table, members, point, direction, radius) -> float:
    """Of displacements of both ends across, each segment's errors larger by one of the factors."""
    rays = ray_axis_distances(table.rays, point, direction)
    error = (members.side[0][:, None] * radius - rays.distance_mm) / rays.per_px
    total = 0.0
    for own, covariance in zip(error, table.across_px2, strict=True):
        values, axes = np.linalg.eigh(covariance)
        along = axes.T @ own
        total += np.log(
            sum(
                share * norm.pdf(along, scale=scale * np.sqrt(values)).prod()
                for share, scale in zip(ERRORS.error_shares, ERRORS.error_scales, strict=True)
            )
        )
    return total


@pytest.mark.parametrize("wrong_px", [0.0, 1.5, 6.0])
def test_a_fit_is_where_the_likelihood_of_heavy_tails_is_greatest(wrong_px) -> None:
    table, members = outlines(0.2, seed=3, wrong_px=wrong_px)
    fits = converged(table, members)
    point, direction, radius = fits.point_mm[0], fits.direction[0], fits.radius_mm[0]
    best = log_likelihood(table, members, point, direction, radius)
    np.testing.assert_allclose(fits.log_likelihood[0], best, rtol=1e-9)
    across, sigma = complete_axes(direction), np.sqrt(np.diag(fits.covariance[0]))
    for k, step in enumerate(1e-3 * np.diag(sigma)):
        values = [
            log_likelihood(
                table,
                members,
                point + sign * step[:2] @ across,
                (turned := direction + sign * step[2:4] @ across) / np.linalg.norm(turned),
                radius + sign * step[4],
            )
            for sign in (1, -1)
        ]
        slope = (values[0] - values[1]) / (2 * step[k])
        # Half a tenth of a standard deviation off the top there is a slope of 0.05 per sigma. So
        # much is left where a segment is far off: pixels per mm count as they are at the fit.
        assert abs(slope) * sigma[k] < 0.05


def test_the_covariance_is_the_inverse_of_the_curvature_where_errors_are_as_stated() -> None:
    table, members = outlines(0.0, seed=0)
    tuning = with_field(TUNING, "collinear.error_shares", (1.0, 0.0, 0.0))
    fits = fit_cylinders(table, members, *start(), tuning)
    point, direction, radius = fits.point_mm[0], fits.direction[0], fits.radius_mm[0]
    across = complete_axes(direction)

    def whitened(step):
        turned = direction + step[2:4] @ across
        rays = ray_axis_distances(
            table.rays, point + step[:2] @ across, turned / np.linalg.norm(turned)
        )
        error = members.side[0][:, None] * (radius + step[4]) - rays.distance_mm
        root = np.linalg.cholesky(table.across_px2)
        return np.linalg.solve(root, (error / rays.per_px)[..., None]).ravel()

    steps = 1e-5 * np.eye(5)
    slope = np.stack([whitened(s) - whitened(-s) for s in steps], axis=1) / 2e-5
    np.testing.assert_allclose(fits.covariance[0], np.linalg.inv(slope.T @ slope), rtol=1e-4)
    straight = fit_cylinders(table, members, *start(), tuning, STRAIGHT)
    np.testing.assert_allclose(straight.radius_mm, TRUE.solid.radius_mm)
    assert straight.degrees[0] == fits.degrees[0] + 1


def test_along_the_axis_ends_are_where_detectors_stopped() -> None:
    table, members = outlines(0.0, seed=0)
    fits = fit_cylinders(table, members, *start(), TUNING)
    axis, covariance = place_ends(table, fits, members, free_end_px=7.0)
    way = fits.direction[0]
    # Along the axis: so many pixels, each as long as the outlines say.
    ends = TRUE.axis_mm
    mm_per_px = (np.linalg.norm(ends[1] - ends[0]) / table.length_px).mean()
    for end in (0, 1):
        block = covariance[0, 3 * end : 3 * end + 3, 3 * end : 3 * end + 3]
        np.testing.assert_allclose(way @ block @ way, (7.0 * mm_per_px) ** 2, rtol=0.02)
    # Across, an end has the offset's and the tilt's share at its place.
    across, reach = complete_axes(way), (axis[0] - fits.point_mm[0]) @ way
    for end in (0, 1):
        by = np.hstack([np.eye(2), reach[end] * np.eye(2), np.zeros((2, 1))])
        block = covariance[0, 3 * end : 3 * end + 3, 3 * end : 3 * end + 3]
        np.testing.assert_allclose(
            across @ block @ across.T, by @ fits.covariance[0] @ by.T, rtol=1e-9
        )

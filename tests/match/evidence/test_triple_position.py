"""Evidence of triples: the trifocal tensor and integration over all lines agree."""

from itertools import permutations
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2

from tests.geometry import trifocal
from tests.match.evidence.line_integral import log_evidence
from tests.match.made import pictures
from tests.match.scene import MadeScene, seen_by
from trinoc.geometry import line_through
from trinoc.geometry.lines import signed_distance
from trinoc.match.evidence.triple_position import (
    TripleEvidence,
    line_of_three,
    triple_evidence,
)
from trinoc.match.observations.clutter import ClutterModel
from trinoc.match.tuning.candidates import CandidateTuning
from trinoc.match.two_view.planes import segment_planes
from trinoc.numerics.vectors import vector3

ORDER = np.arange(3)


@jax.jit
def evidence_on(lines, order, segments, near_mm, clutter) -> TripleEvidence:
    points = vector3(near_mm[:, 0]), vector3(near_mm[:, 1])
    return triple_evidence(segment_planes(lines, clutter, order, segments.T), points)


@jax.jit
def one_by_one(lines, order, segments, near_mm, clutter) -> TripleEvidence:
    def one(segments, near_mm):
        points = vector3(near_mm[0]), vector3(near_mm[1])
        return triple_evidence(segment_planes(lines, clutter, order, segments), points)

    return jax.vmap(one)(segments, near_mm)


def evidence_near(lines, order, segments, near_mm, clutter) -> TripleEvidence:
    """Evidence on the line, then on the line fitted to it, as the matcher does."""
    first = evidence_on(lines, order, segments, near_mm, clutter)
    on_fitted_line = evidence_on(lines, order, segments, ends_of(first.ends_mm), clutter)
    return jax.tree.map(np.asarray, on_fitted_line)


def ends_of(points: tuple) -> np.ndarray:
    return np.moveaxis(np.array(points), 2, 0)


@pytest.fixture(scope="module")
def evidence(precise: MadeScene, clutter: ClutterModel) -> TripleEvidence:
    """Evidence of the true triples."""
    return evidence_near(precise.inputs.lines, ORDER, precise.true, precise.lines_mm, clutter)


def test_evidence_is_the_integral_over_all_lines(
    precise: MadeScene, clutter: ClutterModel, evidence: TripleEvidence
) -> None:
    table, ends_mm = precise.table, ends_of(evidence.ends_mm)
    assert evidence.possible.all()
    for n, row in enumerate(precise.true):
        integral = log_evidence(
            table.matrix_px, table.ends_px[ORDER, row], table.across_px2[ORDER, row], ends_mm[n]
        )
        # Strangers: places per px^2 and direction per rad, which is the displacement of one end
        # over the length.
        length = table.length_px[ORDER, row]
        strangers = np.sum(np.asarray(clutter.log_density)[ORDER, row] - np.log(length))
        extents = np.array([[low[n], high[n]] for low, high in evidence.extent_px])
        ends = log_share_of_lengths(np.diff(extents)[:, 0], float(clutter.typical_px))
        expected = integral - strangers - np.log(evidence.px_per_mm[n]) + ends
        log_evidence_of_triple = (
            evidence.log_density[n] - 0.5 * evidence.chi_square[n] - np.log(2 * np.pi)
        )
        np.testing.assert_allclose(log_evidence_of_triple, expected, atol=5e-3)


def log_share_of_lengths(lengths_px: np.ndarray, typical_px: float) -> float:
    """Log share of the lengths: members show parts of one line with ends anywhere on it."""

    def density(length: float | np.ndarray) -> np.ndarray:
        return typical_px / (typical_px + np.asarray(length)) ** 2

    longest, others = lengths_px.max(), len(lengths_px) - 1
    ratio = density(longest) / np.prod(density(lengths_px)) / longest ** (2 * others)
    return float(np.log(ratio))


def test_triples_at_once_are_what_each_is_alone(precise: MadeScene, clutter: ClutterModel) -> None:
    arguments = precise.inputs.lines, ORDER, precise.true, precise.lines_mm, clutter
    for together, alone in zip(
        jax.tree.leaves(evidence_on(*arguments)),
        jax.tree.leaves(one_by_one(*arguments)),
        strict=True,
    ):
        np.testing.assert_allclose(together, alone, rtol=1e-6, atol=1e-9)


def test_misfit_is_that_of_the_line_which_the_trifocal_tensor_transfers(
    precise: MadeScene, evidence: TripleEvidence
) -> None:
    table = precise.table
    tensor = trifocal.trifocal_tensor(*table.matrix_px)
    interval = np.array([[first, last] for first, last in evidence.interval])

    @jax.jit
    @jax.vmap
    def chi_square(ends_px, across_px2, interval):
        normal = jax.vmap(line_through)(ends_px[:, 0], ends_px[:, 1])[:, :2]

        def residual(across):
            """Distances from the transferred line, with all ends moved across by (3, 2) px."""
            ends = ends_px + across[:, :, None] * normal[:, None, :]
            lines = jax.vmap(line_through)(ends[:, 0], ends[:, 1])
            transferred = trifocal.transfer_line(tensor, lines[1], lines[2])
            return jnp.stack(
                [
                    signed_distance(transferred, ends[0, 0] + share * (ends[0, 1] - ends[0, 0]))
                    for share in interval
                ]
            )

        moves = jnp.zeros((3, 2))
        error, jacobian = residual(moves), jax.jacfwd(residual)(moves)
        (a, b), (_, c) = jnp.einsum("pve,vef,qvf->pq", jacobian, across_px2, jacobian)
        return (c * error[0] ** 2 - 2 * b * error[0] * error[1] + a * error[1] ** 2) / (
            a * c - b**2
        )

    expected = chi_square(
        table.ends_px[ORDER, precise.true],
        table.across_px2[ORDER, precise.true],
        np.ascontiguousarray(interval[0].T),
    )
    # Two planes that hardly cross transfer a line that is far from linear in their errors.
    well = np.array([sine_of(table, row) for row in precise.true]) > 0.1
    assert well.sum() >= 20
    np.testing.assert_allclose(evidence.chi_square[well], np.asarray(expected)[well], rtol=0.01)


def sine_of(table: Any, row: np.ndarray) -> float:
    """Sine of the angle between the planes of sight of the views 1 and 2."""
    normal = np.cross(*np.moveaxis(table.rays[ORDER, row], 1, 0))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return float(np.linalg.norm(np.cross(normal[1], normal[2])))


@pytest.mark.parametrize("order", [p for p in permutations(range(3)) if p != (0, 1, 2)])
def test_which_view_comes_first_means_nothing(
    precise: MadeScene, clutter: ClutterModel, evidence: TripleEvidence, order: tuple[int, ...]
) -> None:
    turn = np.array(order)
    reordered = evidence_near(
        precise.inputs.lines, turn, precise.true[:, turn], precise.lines_mm[:, ::-1] + 0.2, clutter
    )
    np.testing.assert_allclose(reordered.chi_square, evidence.chi_square, rtol=0.01, atol=1e-3)
    np.testing.assert_allclose(reordered.log_density, evidence.log_density, atol=0.01)
    ends = ends_of(evidence.ends_mm)[:, ::-1]
    np.testing.assert_allclose(ends_of(reordered.ends_mm), ends, atol=0.02)


def test_misfit_of_true_triples_is_chi_square(exact: MadeScene, clutter: ClutterModel) -> None:
    chi_squares = []
    for seed in range(20):
        pictures_px = pictures(exact.rig, exact.lines_mm, sigma_px=0.3, seed=seed)
        scene = seen_by(exact.rig, exact.lines_mm, pictures_px, 0.3)
        triples = evidence_near(scene.inputs.lines, ORDER, scene.true, scene.lines_mm, clutter)
        chi_squares.append(np.asarray(triples.chi_square))
    rank = chi2.cdf(np.concatenate(chi_squares), 2)
    assert abs(rank.mean() - 0.5) < 4 / np.sqrt(12 * len(rank))
    assert abs((rank > 0.9).mean() - 0.1) < 4 * np.sqrt(0.09 / len(rank))


def test_three_can_be_one_line_where_their_misfit_is_within_the_gate(
    exact: MadeScene, clutter: ClutterModel
) -> None:
    """The fast test returns the same line and answer as the full evidence."""
    pictures_px = pictures(exact.rig, exact.lines_mm, sigma_px=0.3, seed=3)
    scene = seen_by(exact.rig, exact.lines_mm, pictures_px, 0.3)
    evidence = evidence_on(scene.inputs.lines, ORDER, scene.true, scene.lines_mm, clutter)
    points = vector3(scene.lines_mm[:, 0]), vector3(scene.lines_mm[:, 1])
    sight = segment_planes(scene.inputs.lines, clutter, ORDER, scene.true.T)
    gate = float(np.median(evidence.chi_square))
    strict = CandidateTuning(gate=gate)
    ends, possible = jax.jit(lambda sight, ends_mm: line_of_three(sight, ends_mm, strict))(
        sight, points
    )
    np.testing.assert_array_equal(possible, np.asarray(evidence.chi_square) < gate)
    np.testing.assert_allclose(ends_of(ends), ends_of(evidence.ends_mm), atol=1e-6)
    full_evidence = jax.jit(lambda sight, ends_mm: triple_evidence(sight, ends_mm, strict).possible)
    np.testing.assert_array_equal(full_evidence(sight, points), possible)

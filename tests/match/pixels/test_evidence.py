"""Laws of the one test: its rate of false alarms, what it sees, where it says an edge is."""

from typing import NamedTuple

import cv2
import numpy as np
import pytest
from scipy.special import ndtr

from trinoc.match.pixels.probes import picture_gradient
from trinoc.match.pixels.views import (
    EdgeResponse,
    PictureInput,
    ask,
    log_chance,
    measure_growth,
    picture_inputs,
    with_usual_width,
)
from trinoc.numerics.precision import in_float64
from trinoc.synth import table1_rig

RIG = table1_rig()
WIDTH, HEIGHT = RIG["upper"].image_size_px
# Blur of the made edges, px.
BLUR = 1.0


class Edge(NamedTuple):
    """A step along the line through a place in a direction, from a place along it to another."""

    picture: np.ndarray
    ends_px: np.ndarray


def as_levels(grey: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def step_edge(angle: float, contrast: float, noise: float, seed: int, length: float = 80) -> Edge:
    """An edge of a given length in a noisy picture, brighter on the right of its way."""
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    way = np.array([np.cos(angle), np.sin(angle)])
    offset = np.stack([u, v], axis=-1) - np.array([255.3, 240.6])
    along, across = offset @ way, offset @ np.array([-way[1], way[0]])
    held = ndtr((along + length / 2) / BLUR) * ndtr((length / 2 - along) / BLUR)
    grey = 120 + contrast * (ndtr(across / BLUR) - 0.5) * held
    grey = grey + noise * np.random.default_rng(seed).normal(size=grey.shape)
    ends = np.array([255.3, 240.6]) + np.array([[-0.5], [0.5]]) * length * way
    return Edge(as_levels(grey), ends)


@in_float64
def seen(picture: np.ndarray) -> PictureInput:
    return picture_inputs(RIG, {"upper": picture})[0]


@in_float64
def answers(picture: PictureInput, ends_px: np.ndarray, gate: float = 2.0) -> EdgeResponse:
    count = len(ends_px)
    return ask(picture, ends_px, np.full(count, gate), np.ones(count), np.full(count, np.inf))


def probes(count: int, length: float, seed: int) -> np.ndarray:
    """Probes anywhere, in any direction."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform(length, np.array([WIDTH, HEIGHT]) - length, (count, 2))
    angle = rng.uniform(0, 2 * np.pi, count)
    half = length / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.stack([middle - half, middle + half], axis=1)


def noise_picture(kind: str) -> np.ndarray:
    rng = np.random.default_rng(4)
    white = rng.normal(size=(HEIGHT, WIDTH))
    if kind == "white":
        return as_levels(128 + 4 * white)
    if kind == "on a ramp":
        return as_levels(np.linspace(30, 220, WIDTH) + 3 * white)
    smooth = cv2.GaussianBlur(white, (0, 0), 2.0)
    return as_levels(128 + 20 * smooth / smooth.std() + rng.normal(size=white.shape))


@pytest.mark.parametrize("kind", ["white", "on a ramp", "texture"])
def test_noise_passes_as_seldom_as_claimed(kind):
    found = answers(seen(noise_picture(kind)), probes(2048, 90, 9))
    # All windows and lines of a probe are counted as if they were independent.
    for rate in (0.01, 0.001):
        passed = int((found.log_chance < np.log(rate)).sum())
        assert passed <= rate * 2048 + 3 * np.sqrt(rate * 2048)


def test_what_noise_shows_in_one_probe_of_a_hundred_is_no_evidence():
    """Whatever the number of tests that a probe makes, more for long ones."""
    for length in (20, 90):
        found = answers(seen(noise_picture("white")), probes(2048, length, 9))
        assert (found.tests > 0).sum() <= 0.01 * 2048 + 3 * np.sqrt(0.01 * 2048)


def test_one_test_alone_has_the_rate_of_a_normal_variable():
    from trinoc.match.pixels.probes import WINDOW_SIZE, WINDOWS, sample_probes, window_scores
    from trinoc.match.pixels.views import block_noise

    gradient = picture_gradient(noise_picture("white"))
    places = sample_probes(probes(2048, 100, 3), RIG["upper"].intrinsics, (WIDTH, HEIGHT))
    growth = measure_growth(gradient, RIG["upper"].intrinsics, (WIDTH, HEIGHT))
    scores, _ = window_scores(gradient.by_uv, block_noise(gradient), places)
    window = int(np.flatnonzero(WINDOW_SIZE == 8)[1])
    score = np.abs(scores[:, window]) / np.sqrt(growth[WINDOWS.index(8)])
    chance = np.exp(log_chance(score.astype(np.float64), np.ones(len(score))))
    for rate in (0.3, 0.1, 0.03):
        share = float((chance < rate).mean())
        assert share == pytest.approx(rate, abs=4 * np.sqrt(rate / 2048), rel=0.25)


def test_a_faint_edge_is_seen_where_it_is_asked_for():
    edge = step_edge(0.4, contrast=2.5, noise=1.0, seed=1)
    found = answers(seen(edge.picture), edge.ends_px[None], gate=1.0)
    assert found.log_chance[0] < np.log(1e-4)
    assert found.sign[0] == 1


def test_neither_a_ramp_nor_an_edge_that_crosses_is_one():
    edge = step_edge(0.4, contrast=60, noise=1.0, seed=2, length=300)
    middle = edge.ends_px.mean(axis=0)
    for turn in (0.5, 1.0, 1.5):
        way = 40 * np.array([np.cos(0.4 + turn), np.sin(0.4 + turn)])
        found = answers(seen(edge.picture), np.stack([middle - way, middle + way])[None])
        assert found.log_chance[0] > np.log(1e-3)


def test_place_ends_and_contrast_within_their_errors():
    across, along = [], []
    for seed in range(12):
        edge = step_edge(0.25 * seed, contrast=40, noise=2.0, seed=seed)
        way = np.array([np.cos(0.25 * seed), np.sin(0.25 * seed)])
        right = np.array([-way[1], way[0]])
        longer = edge.ends_px + np.array([[-1], [1]]) * 20 * way
        found = answers(seen(edge.picture), (longer + 0.6 * right)[None])
        off = found.ends_px[0] - edge.ends_px
        blocks = found.covariance_px2[0].reshape(2, 2, 2, 2)
        for places, unit in ((across, right), (along, way)):
            sigma = np.sqrt(np.einsum("eiej,i,j->e", blocks, unit, unit))
            places += (off @ unit / sigma).tolist()
        assert found.contrast[0] == pytest.approx(40, rel=0.15)
    assert np.mean(np.square(across)) < 2.0
    assert np.mean(np.square(along)) < 4.0
    assert np.abs(across).max() < 4.0


def test_the_other_way_round_the_answer_is_the_same():
    edge = step_edge(1.1, contrast=30, noise=2.0, seed=5, length=64)
    both = answers(seen(edge.picture), np.stack([edge.ends_px, edge.ends_px[::-1]]))
    assert both.sign.tolist() == [1, -1]
    np.testing.assert_allclose(both.ends_px[0], both.ends_px[1][::-1], atol=0.05)


def test_another_edge_that_comes_near_moves_no_end_beyond_its_error():
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    normalised, away = [], []
    for seed in range(16):
        angle = 0.4 * seed
        way = np.array([np.cos(angle), np.sin(angle)])
        right = np.array([-way[1], way[0]])
        offset = np.stack([u, v], axis=-1) - np.array([255.3, 240.6])
        # A second edge, 3 px beside the first at one end and further away at the other.
        turn = angle + 0.15
        other = (offset - 40 * way - 3 * right) @ np.array([-np.sin(turn), np.cos(turn)])
        grey = 100 + 40 * ndtr((offset @ right) / BLUR) + 30 * ndtr(other / BLUR)
        grey = grey + np.random.default_rng(seed).normal(size=grey.shape)
        ends = np.array([255.3, 240.6]) + np.array([[-40], [40]]) * way
        found = answers(seen(as_levels(grey)), ends[None], gate=1.0)
        off = (found.ends_px[0] - ends) @ right
        blocks = found.covariance_px2[0].reshape(2, 2, 2, 2)
        sigma = np.sqrt(np.einsum("eiej,i,j->e", blocks, right, right))
        normalised += (off / sigma).tolist()
        away += sigma.tolist()
    assert np.mean(np.square(normalised)) < 1.5
    assert np.median(away) < 0.5


@in_float64
def sliver(gap_px: float, contrast: float = 60.0) -> Edge:
    """Two steps, one as high as the other, so near each other that they look like one."""
    edge = step_edge(0.4, 0.0, 0.5, seed=8, length=120)
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    across = (v - 240.6) * np.cos(0.4) - (u - 255.3) * np.sin(0.4)
    both = ndtr(across / BLUR) + ndtr((across - gap_px) / BLUR)
    return Edge(as_levels(edge.picture + contrast * (both / 2 - 0.5)), edge.ends_px)


def test_a_wider_ridge_than_usual_may_hide_an_edge_and_is_placed_so():
    sigma, off, width = [], [], []
    alone = seen(sliver(0.0).picture)
    usual = with_usual_width(alone, np.repeat(sliver(0.0).ends_px[None], 6, axis=0)).usual_px
    for gap in (0.0, 1.5, 2.5):
        edge = sliver(gap)
        picture = seen(edge.picture)._replace(usual_px=usual)
        found = answers(picture, edge.ends_px[None])
        way = edge.ends_px[1] - edge.ends_px[0]
        right = np.array([-way[1], way[0]]) / np.linalg.norm(way)
        across = (found.ends_px[0] - edge.ends_px) @ right
        blocks = found.covariance_px2[0].reshape(2, 2, 2, 2)
        sigma.append(np.sqrt(np.einsum("i,eiej,j->e", right, blocks, right)).mean())
        off.append(across.mean())
        width.append(found.width_px.mean())
        np.testing.assert_allclose(across, gap / 2, atol=0.2)
        assert abs(across.mean()) < 3 * sigma[-1]
    assert (np.diff(sigma) > 0).all()
    assert (np.diff(width) > 0).all()
    assert sigma[0] < 0.1
    assert width[0] == pytest.approx(usual, rel=0.05)
    # Where nobody knows what is usual, nothing is added.
    unknown = answers(seen(sliver(2.5).picture), sliver(2.5).ends_px[None])
    assert np.trace(unknown.covariance_px2[0]) < np.trace(found.covariance_px2[0])


def test_without_segments_nobody_knows_how_wide_ridges_are():
    picture = seen(sliver(0.0).picture)
    assert with_usual_width(picture, np.zeros((0, 2, 2))).usual_px == np.inf


def test_an_edge_all_along_another_makes_the_place_less_sure():
    variance = []
    for gap in (40.0, 4.0):
        edge = sliver(gap)
        found = answers(seen(edge.picture), edge.ends_px[None], gate=1.0)
        way = edge.ends_px[1] - edge.ends_px[0]
        right = np.array([-way[1], way[0]]) / np.linalg.norm(way)
        blocks = found.covariance_px2[0].reshape(2, 2, 2, 2)
        variance.append(np.einsum("i,eiej,j->e", right, blocks, right).mean())
        across = (found.ends_px[0] - edge.ends_px) @ right
        assert (np.abs(across) < 3 * np.sqrt(variance[-1])).all()
    assert variance[1] > 4 * variance[0]

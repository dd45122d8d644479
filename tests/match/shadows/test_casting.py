"""Where a lamp casts an edge: exact geometry, of lamps near and far."""

import numpy as np
import pytest

from tests.match.shadows.made_shadows import FAR_LAMP, NEAR_LAMP
from trinoc.match.bodies.casting import Lamps, cast_density, casting_pairs, likely_casts
from trinoc.match.tuning.bodies import ShadowTuning
from trinoc.numerics.tables import take_rows

TUNING, SIZE_MM = ShadowTuning(), 50.0
EDGE = np.array([[10.0, -20.0, 30.0], [35.0, 5.0, 42.0]])
SIGMA_MM = 0.05


def cast(lamp: np.ndarray, point_mm: np.ndarray) -> np.ndarray:
    """Where the ray from the lamp through a point meets the table."""
    ray = point_mm * lamp[3] - lamp[:3]
    return point_mm - ray * (point_mm[2] / ray[2])


def lamps_of(lamp: np.ndarray, middle_mm: np.ndarray) -> Lamps:
    way = lamp[:3] - lamp[3] * middle_mm
    size = np.linalg.norm(way)
    return Lamps((way / size)[None], np.array([lamp[3] / size]))


def density(edge, shadow, lamp, middle_mm=None) -> float:
    """Of the second line as the shadow of the first."""
    lines = np.stack([edge, shadow])
    middle = np.zeros(3) if middle_mm is None else middle_mm
    covariance = np.tile(SIGMA_MM**2 * np.eye(6), (2, 1, 1))
    pairs = casting_pairs(lines, covariance, middle, TUNING)
    own = take_rows(pairs, (pairs.shadow == 1) & (pairs.edge == 0))
    if len(own.shadow) == 0:
        return 0.0
    return float(cast_density(own, lamps_of(lamp, middle), 1e-6, SIZE_MM, TUNING)[0])


@pytest.mark.parametrize("lamp", [NEAR_LAMP, FAR_LAMP], ids=["near", "far"])
def test_the_shadow_of_an_edge_is_likeliest_where_the_lamp_casts_it(lamp) -> None:
    shadow = np.stack([cast(lamp, end) for end in EDGE])
    at = density(EDGE, shadow, lamp)
    assert at > 0.0
    for off in ([0.5, 0.0, 0.0], [0.0, 0.5, 0.0]):
        assert density(EDGE, shadow + off, lamp) < at
    # A part of it is as good as the whole, but what lies beside the edge's shadow is not.
    part = shadow[0] + np.array([[0.2], [0.7]]) * (shadow[1] - shadow[0])
    assert density(EDGE, part, lamp) > 0.0
    assert density(EDGE, shadow + 1.5 * (shadow[1] - shadow[0]), lamp) == 0.0


@pytest.mark.parametrize("lamp", [NEAR_LAMP, FAR_LAMP], ids=["near", "far"])
def test_nothing_casts_toward_the_lamp(lamp) -> None:
    shadow = np.stack([cast(lamp, end) for end in EDGE])
    assert density(shadow, EDGE, lamp) == 0.0


def test_the_scene_may_be_moved_and_ends_exchanged() -> None:
    exact = np.stack([cast(NEAR_LAMP, end) for end in EDGE])
    shadow = exact + np.array([0.05, 0.02, 0.0])
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    shift = np.array([40.0, -7.0, 12.0])
    moved = np.append(turn @ NEAR_LAMP[:3] + shift, 1.0)
    at = density(EDGE, shadow, NEAR_LAMP)
    again = density(EDGE @ turn.T + shift, shadow @ turn.T + shift, moved, shift)
    assert again == pytest.approx(at, rel=1e-6)
    assert density(EDGE[::-1], shadow, NEAR_LAMP) == pytest.approx(at, rel=1e-6)
    assert density(EDGE, shadow[::-1], NEAR_LAMP) == pytest.approx(at, rel=1e-6)


@pytest.mark.parametrize("nearest", [0.0, 0.1])
@pytest.mark.parametrize("turn_deg", [0.1, 2.0])
def test_what_is_left_out_unseen_is_as_good_as_zero(nearest: float, turn_deg: float) -> None:
    generator = np.random.default_rng(5)
    ends = generator.uniform(-SIZE_MM, SIZE_MM, (24, 2, 3))
    # Half of the lines lie in one plane, as shadows do.
    ends[::2, :, 2] = 0.0
    root = generator.normal(scale=SIGMA_MM, size=(24, 6, 6))
    pairs = casting_pairs(ends, root @ root.mT, ends.mean(axis=(0, 1)), TUNING)
    direction = generator.normal(size=(300, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    lamps = Lamps(direction, generator.uniform(0, nearest / SIZE_MM, 300))
    turn = float(np.radians(turn_deg))
    lamp, pair = (index.ravel() for index in np.indices((len(lamps.nearness), len(pairs.shadow))))
    every = take_rows(pairs, pair), take_rows(lamps, lamp)
    density = cast_density(*every, turn, SIZE_MM, TUNING).reshape(len(lamps.nearness), -1)
    seen = np.zeros(density.shape, dtype=bool)
    seen[likely_casts(pairs, lamps, turn, SIZE_MM, TUNING)] = True
    assert (density > 1e-5 * density.max(axis=0)).sum() > 200
    assert density[~seen].max() < 1e-5 * density.max()
    assert seen.mean() < 0.3

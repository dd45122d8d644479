"""The search guided by a sample finds the same lines as the exhaustive search."""

import numpy as np
import pytest

from tests.match.made import as_set, loose_lines, pictures, rig_of
from trinoc.match import MatchTuning
from trinoc.match.candidates.learned import Region, SearchPrior, bound_region
from trinoc.match.candidates.search import prepare_orders
from trinoc.match.candidates.table import prior_log_odds
from trinoc.match.candidates.triples import search_candidates
from trinoc.match.evidence.mixture import prior_parameters
from trinoc.match.matcher import match_segments
from trinoc.match.observations.clutter import fit_clutter
from trinoc.match.observations.match_input import prepare
from trinoc.match.scouting import _evenly_spaced, _learn_prior
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.numerics.precision import in_float64
from trinoc.numerics.tables import with_field

VIEWS = ("upper", "left", "right")
RIG = rig_of(*VIEWS)


def scouting(tuning: MatchTuning = DEFAULT) -> MatchTuning:
    """Tuning that applies the scouting of large pictures to pictures of a hundred segments."""
    for name, value in {"min_segments": 0, "sample_size": 50, "min_sure_triples": 10}.items():
        tuning = with_field(tuning, f"scouting.{name}", value)
    return tuning


@pytest.fixture(scope="module")
def lines_mm() -> np.ndarray:
    """Many lines above the sheet, and three far above all of them."""
    lines = loose_lines(110, seed=5)
    lines[-3:] += np.array([[-9, 4, 80], [0, -7, 88], [8, 9, 96]])[:, None] - middles(lines[-3:])
    return lines


@pytest.fixture(scope="module")
def pictures_px(lines_mm: np.ndarray) -> dict:
    return pictures(RIG, lines_mm, sigma_px=0.3, seed=6)


def test_tracks_are_those_of_the_search_of_everything(pictures_px: dict) -> None:
    exhaustive, scouted = (
        match_segments(pictures_px, RIG),
        match_segments(pictures_px, RIG, tuning=scouting()),
    )
    assert as_set(scouted, VIEWS) == as_set(exhaustive, VIEWS)
    assert len(scouted) >= 100


def test_lines_outside_the_box_are_found(pictures_px: dict, lines_mm: np.ndarray) -> None:
    narrow = with_field(
        with_field(scouting(), "scouting.trimmed_share", 0.05), "scouting.margin", 0.0
    )
    outside = ~inside(bound_region(lines_mm, narrow.scouting), lines_mm)
    assert outside.sum() > 20
    assert outside[-3:].all()
    tracks = as_set(match_segments(pictures_px, RIG, tuning=narrow), VIEWS)
    assert tracks == as_set(match_segments(pictures_px, RIG), VIEWS)
    assert tracks >= {(n, n, n) for n in range(len(lines_mm) - 3, len(lines_mm))}


def test_the_order_of_views_changes_nothing(pictures_px: dict) -> None:
    turned = {name: pictures_px[name] for name in reversed(VIEWS)}
    one, other = (
        match_segments(ordered, RIG, tuning=scouting()) for ordered in (pictures_px, turned)
    )
    assert as_set(one, VIEWS) == as_set(other, VIEWS)


def test_too_few_sure_lines_search_everything(pictures_px: dict) -> None:
    few = with_field(scouting(), "scouting.min_sure_triples", 1000)
    one, other = match_segments(pictures_px, RIG, tuning=few), match_segments(pictures_px, RIG)
    np.testing.assert_array_equal(one.posterior, other.posterior)


def test_the_box_holds_its_lines_wherever_the_world_begins() -> None:
    lines = loose_lines(200, seed=7)
    far = np.array([3e5, -2e6, 1e4])
    for shift in (np.zeros(3), far):
        assert inside(bound_region(lines + shift, DEFAULT.scouting), lines + shift).mean() > 0.98


def test_the_box_of_a_flat_scene_holds_what_lies_little_off_its_plane() -> None:
    """The box keeps a thickness even if all lines of the sample lie exactly in the plane."""
    flat = loose_lines(200, seed=7)
    flat[..., 2] = 0.2 * flat[..., 0]
    normal = np.array([-0.2, 0.0, 1.0]) / np.hypot(1.0, 0.2)
    side = np.ptp(flat.reshape(-1, 3), axis=0).max()
    region = bound_region(flat, DEFAULT.scouting)
    for share in (-0.9, 0.9):
        off = share * DEFAULT.scouting.min_side_share * side * normal
        assert inside(region, flat + off).mean() > 0.98


@in_float64
@pytest.mark.parametrize("sample", [20, 30])
def test_the_number_of_lines_does_not_depend_on_the_size_of_the_sample(
    pictures_px: dict, sample: int
) -> None:
    """All 110 lines are in every view: the search expects about as many, within the error of a
    count of 30."""
    inputs = prepare(pictures_px, RIG, None)
    clutter = fit_clutter(inputs.lines, inputs.counts)
    tuning = with_field(scouting(), "scouting.sample_size", sample)
    rows = tuple(_evenly_spaced(110, sample) for _ in VIEWS)
    every = tuple(np.arange(110) for _ in VIEWS)
    sample_candidates = search_candidates(orders_of(pictures_px), tuning, rows=(rows, every))
    learned = _learn_prior(sample_candidates, 110.0, clutter, tuning)
    assert learned is not None
    assert np.exp(float(learned.mixture.log_count)) == pytest.approx(110, rel=0.4)


@in_float64
def test_the_search_within_a_box_finds_what_has_its_common_part_there(pictures_px: dict) -> None:
    orders = orders_of(pictures_px)
    everywhere = search_candidates(orders)
    # A box whose walls are far from all ends, so that the fit to three views crosses none.
    region = Region(np.eye(3), np.array([-200.0, -200.0, -50.0]), np.array([200.0, 200.0, 100.0]))
    learned = SearchPrior(region, prior_parameters(everywhere.ends_mm, 110.0), -np.inf)
    in_box = search_candidates(orders, prior=learned)
    assert {tuple(row) for row in in_box.index} <= {tuple(row) for row in everywhere.index}
    true = {(n, n, n) for n in range(107)}
    numbers = np.stack(
        [order[in_box.index[:, v]] for v, order in enumerate(orders_seen(pictures_px))], 1
    )
    assert true <= {tuple(row) for row in numbers.tolist()}


@in_float64
def test_what_is_dropped_at_sight_is_unlikely(pictures_px: dict) -> None:
    orders = orders_of(pictures_px)
    all_candidates = search_candidates(orders)
    mixture = prior_parameters(all_candidates.ends_mm, 110.0)
    anywhere = mixture._replace(volume=mixture.volume._replace(precision=np.zeros((3, 3))))
    odds = prior_log_odds(all_candidates, anywhere)
    slack = DEFAULT.scouting.slack_log_odds
    for min_log_odds in (-5.0, 0.0, 5.0):
        candidates = search_candidates(orders, prior=SearchPrior(None, mixture, min_log_odds))
        likely = all_candidates.index[odds > min_log_odds + slack]
        found_tracks = {tuple(row) for row in candidates.index.tolist()}
        missing = {tuple(row) for row in likely.tolist()} - found_tracks
        assert len(likely) > 100
        assert len(missing) <= 0.01 * len(likely)
        assert (prior_log_odds(candidates, anywhere) > min_log_odds - slack).mean() > 0.95


def middles(lines_mm: np.ndarray) -> np.ndarray:
    """(n, 1, 3) the middle of each line."""
    return lines_mm.mean(axis=1, keepdims=True)


def inside(region: Region, lines_mm: np.ndarray) -> np.ndarray:
    """True for each line with both ends in the box."""
    coordinates = lines_mm @ region.axes.T
    return np.all((coordinates > region.low_mm) & (coordinates < region.high_mm), axis=(1, 2))


def orders_seen(pictures_px: dict) -> list[np.ndarray]:
    """For each of the matcher's views, the line number of each segment."""
    return list(prepare(pictures_px, RIG, None).order)


def orders_of(pictures_px: dict):
    """The three views, prepared for the search."""
    inputs = prepare(pictures_px, RIG, None)
    clutter = fit_clutter(inputs.lines, inputs.counts)
    return prepare_orders(inputs.lines, (0, 1, 2), inputs.counts, clutter)

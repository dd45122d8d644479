"""A made block whose matches lack something: what its pictures add, and what they deny."""

import cv2
import numpy as np
import pytest

from trinoc.errors import InputError
from trinoc.geometry.segments import Segments, covariance_of_ends
from trinoc.io.saving import load_matches, save
from trinoc.match import guide_matches
from trinoc.match.tracks.matches import Matches
from trinoc.synth import table1_rig

RIG = table1_rig()
VIEWS = RIG.names
FOLD = 4
# Corners of a block, by bits of x, y, z.
CORNERS = np.array(
    [[x, y, z] for z in (0.0, 40.0) for y in (-25.0, 25.0) for x in (-30.0, 30.0)]
) @ np.array([[0.94, 0.34, 0], [-0.34, 0.94, 0], [0, 0, 1]])
FACES = {
    (4, 5, 7, 6): 190,
    (0, 1, 5, 4): 120,
    (1, 3, 7, 5): 150,
    (3, 2, 6, 7): 90,
    (2, 0, 4, 6): 70,
}
TOP = [(4, 5), (5, 7), (7, 6), (6, 4)]
# The vertical edge between the two faces that all cameras see, and that below the front face.
UPRIGHT, FOOT = (1, 5), (0, 1)


def image_px(view, points):
    matrix = RIG[view].matrix_px
    image = points @ matrix[:, :3].T + matrix[:, 3]
    return image[..., :2] / image[..., 2:]


def shown(view, face):
    corners = CORNERS[list(face)]
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[1])
    return normal @ (RIG[view].centre_world_mm - corners[0]) > 0


def picture(view, seed):
    width, height = RIG[view].image_size_px
    grey = np.full((height * FOLD, width * FOLD), 50, np.float32)
    for face, level in FACES.items():
        if shown(view, face):
            corners = (image_px(view, CORNERS[list(face)]) + 0.5) * FOLD - 0.5
            cv2.fillConvexPoly(grey, np.rint(corners * 16).astype(np.int32), level, shift=4)
    grey = cv2.GaussianBlur(grey, (0, 0), 0.8 * FOLD)
    grey = cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA)
    noise = 1.5 * np.random.default_rng(seed).normal(size=grey.shape)
    return np.clip(np.rint(grey + noise), 0, 255).astype(np.uint8)


PICTURES = {view: picture(view, k) for k, view in enumerate(VIEWS)}


def matches_of(edges, lacking, part=(0.0, 1.0)):
    """Tracks of edges, the whole of them or a part; `lacking` (track, view) are not seen."""
    lines = np.stack([CORNERS[list(edge)] for edge in edges])
    lines[-1] = lines[-1, 0] + np.array(part)[:, None] * (lines[-1, 1] - lines[-1, 0])
    count = len(lines)
    segments, index = {}, np.full((count, len(VIEWS)), -1)
    for v, view in enumerate(VIEWS):
        rows = [t for t in range(count) if (t, v) not in lacking]
        index[rows, v] = np.arange(len(rows))
        ends = image_px(view, lines[rows])
        segments[view] = Segments.from_endpoints(ends, sigma_px=0.1, sigma_along_px=0.5)
    return segments, made(lines, index, segments, np.full(count, 0.9))


def made(lines, index, segments, posterior):
    seen = index >= 0
    fragments = np.where(
        seen[..., None, None], np.stack([image_px(v, lines) for v in VIEWS], axis=1), np.nan
    )
    return Matches(
        VIEWS,
        index,
        fragments,
        lines,
        np.tile(0.01 * np.eye(6), (len(lines), 1, 1)),
        np.where(seen.sum(axis=1) > 2, "trinocular", "binocular"),
        posterior,
        np.zeros(len(lines)),
        {view: np.full(len(segments[view]), "matched") for view in VIEWS},
        {},
    )


def distance_mm(lines, edge):
    first, second = CORNERS[list(edge)]
    unit = (second - first) / np.linalg.norm(second - first)
    off = lines - first
    return np.linalg.norm(off - (off @ unit)[..., None] * unit, axis=-1).max(axis=-1)


@pytest.fixture(scope="module")
def guided():
    """A pair of three, and the foot of the front face in no picture."""
    segments, matches = matches_of([*TOP, UPRIGHT], {(1, 2)})
    return segments, matches, guide_matches(matches, segments, RIG, PICTURES)


def test_an_edge_parallel_to_another_is_found_from_its_corner(guided):
    _, matches, found = guided
    new = found.matches.lines_mm[len(matches) :]
    near = distance_mm(new, FOOT) < 0.5
    assert near.any()
    length = np.linalg.norm(new[near][0, 1] - new[near][0, 0])
    assert 40 < length < 66
    assert found.matches.marks["guided"][len(matches) :][near].all() or near.sum() > 1


def test_what_was_given_keeps_its_place(guided):
    segments, matches, found = guided
    kept = found.matches.index[: len(matches)]
    assert (kept[matches.index >= 0] == matches.index[matches.index >= 0]).all()
    for view in VIEWS:
        given, after = segments[view], found.segments[view]
        np.testing.assert_allclose(after.endpoints_px[: len(given)], given.endpoints_px, atol=12.0)


def test_files_hold_what_is_guided(guided, tmp_path):
    save(guided[2].matches, tmp_path / "matches.npz")
    np.testing.assert_array_equal(
        load_matches(tmp_path / "matches.npz").marks["guided"], guided[2].matches.marks["guided"]
    )


def test_a_segment_grows_to_where_its_edge_ends():
    segments, matches = matches_of([*TOP[1:], TOP[0]], set(), part=(0.35, 0.6))
    found = guide_matches(matches, segments, RIG, PICTURES).matches
    whole = np.linalg.norm(CORNERS[5] - CORNERS[4])
    before, after = (np.linalg.norm(m.lines_mm[3, 1] - m.lines_mm[3, 0]) for m in (matches, found))
    assert before == pytest.approx(0.25 * whole, rel=1e-6)
    assert after > 0.8 * whole
    assert after < whole + 2.0
    assert distance_mm(found.lines_mm[3:4], TOP[0])[0] < 0.3
    assert found.marks["guided"][3].sum() >= 2


def test_order_of_views_and_ends_does_not_matter():
    segments, matches = matches_of([*TOP, UPRIGHT], {(1, 2)})
    turned = {
        view: Segments.from_endpoints(
            np.asarray(given.endpoints_px)[:, ::-1], sigma_px=0.1, sigma_along_px=0.5
        )
        for view, given in segments.items()
    }
    one = guide_matches(matches, segments, RIG, PICTURES)
    other = guide_matches(matches, turned, RIG, PICTURES)
    np.testing.assert_array_equal(one.matches.index, other.matches.index)
    np.testing.assert_allclose(one.matches.lines_mm, other.matches.lines_mm, atol=1e-6)


def test_views_without_a_picture_and_pictures_of_another_size_are_refused():
    segments, matches = matches_of(TOP, set())
    with pytest.raises(InputError, match="needs the picture of every view"):
        guide_matches(matches, segments, RIG, {VIEWS[0]: PICTURES[VIEWS[0]]})
    smaller = PICTURES | {VIEWS[1]: PICTURES[VIEWS[1]][:100]}
    with pytest.raises(InputError, match="has the shape"):
        guide_matches(matches, segments, RIG, smaller)


def test_covariance_of_ends_is_that_of_the_caller_where_nothing_grew(guided):
    segments, _, found = guided
    for view in VIEWS:
        given = np.asarray(segments[view].endpoints_px)
        same = (np.asarray(found.segments[view].endpoints_px)[: len(given)] == given).all((1, 2))
        expected = covariance_of_ends(given, 0.1, 0.5)
        np.testing.assert_allclose(
            np.asarray(found.segments[view].covariance_px2)[: len(given)][same], expected[same]
        )

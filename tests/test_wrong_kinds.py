"""Arguments of a wrong kind, and numbers that cannot be, are refused by name, in one sentence."""

from collections.abc import Callable, Iterator
from typing import Any

import jaxtyping
import numpy as np
import pytest

import trinoc
from tests.io.formats.bench import bench_matches
from trinoc.errors import InputError, TrinocError
from trinoc.io.demo import demo_pattern
from trinoc.synth import table1_rig

RIG, SHEET, MATCHES = table1_rig(), demo_pattern(), bench_matches()
LENS = RIG["upper"].intrinsics
GREY = {name: np.full((480, 512), 9 * k, np.uint8) for k, name in enumerate(RIG.names)}
ENDS = np.random.default_rng(2).uniform(20, 400, (9, 4))
SEGMENTS = {name: trinoc.Segments.from_endpoints(ENDS + 9 * k) for k, name in enumerate(RIG.names)}

CALLS: list[tuple[Callable[[Any], Any], Any, str]] = [
    (lambda lens: trinoc.calibrate(GREY, SHEET, lens), None, "The lens is None"),
    (lambda lens: trinoc.calibrate(GREY, SHEET, lens), SHEET, "The lens is of type Pattern"),
    (lambda sheet: trinoc.calibrate(GREY, sheet, LENS), "sheet.json", "The pattern is of type str"),
    (lambda images: trinoc.calibrate(images, SHEET, LENS), GREY["left"], "pictures is of type nda"),
    (
        lambda known: trinoc.calibrate(GREY, SHEET, LENS, systematics=known),
        0.1,
        "knowledge of the sheet is of type float",
    ),
    (lambda images: trinoc.calibrate_rig(images, SHEET), ["a.png"], "of pictures is of type list"),
    (lambda board: trinoc.calibrate_rig({"a": []}, board), "board.json", "board is of type str"),
    (lambda images: trinoc.calibrate_intrinsics(images, SHEET), None, "list of pictures is None"),
    (lambda board: trinoc.calibrate_intrinsics([], board), LENS, "pattern is of type Intrinsics"),
    (lambda result: trinoc.next_shot(result), RIG, "result is of type Rig"),
    (lambda rig: trinoc.match_segments(SEGMENTS, rig), "rig.json", "The rig is of type str"),
    (lambda given: trinoc.match_segments(given, RIG), RIG, "set of segments is of type Rig"),
    (lambda given: trinoc.match_segments(given, RIG), GREY, "find_segments finds"),
    (
        lambda depths: trinoc.match_segments(SEGMENTS, RIG, depth_range_mm=depths),
        (5.0, 1.0),
        "holds no depth",
    ),
    (
        lambda depths: trinoc.match_segments(SEGMENTS, RIG, depth_range_mm=depths),
        5.0,
        "holds no depth",
    ),
    (lambda sigma: trinoc.match_segments(SEGMENTS, RIG, sigma_px=sigma), -1.0, "no end is exact"),
    (lambda sigma: trinoc.match_segments(SEGMENTS, RIG, sigma_px=sigma), 0.0, "no end is exact"),
    (lambda rig: trinoc.refine(rig, MATCHES), MATCHES, "The rig is of type Matches"),
    (lambda matches: trinoc.refine(RIG, matches), GREY, "set of matches is of type dict"),
    (lambda rig: trinoc.check_rig(rig, MATCHES), "rig.json", "The rig is of type str"),
    (lambda lines: trinoc.evaluate(lines, np.zeros((1, 2, 3))), "m.npz", "The lines hold no ends"),
    (lambda edges: trinoc.evaluate(MATCHES, edges), None, "The known edges hold no ends"),
    (lambda lens: trinoc.find_segments(GREY["left"], intrinsics=lens), RIG, "lens is of type Rig"),
    (trinoc.undistort, "camera.json", "lens or rig is of type str"),
    (trinoc.rectify, LENS, "The rig is of type Intrinsics"),
    (trinoc.Segments.from_endpoints, "a.csv", "Segments of type str hold no numbers"),
    (
        lambda sigma: trinoc.Segments.from_endpoints(ENDS, sigma_px=sigma),
        0.0,
        "sigma_px is 0.0, but must be positive",
    ),
    (trinoc.Rig, [RIG["upper"]], "set of cameras is of type list"),
    (trinoc.Rig, {"upper": LENS}, 'camera "upper" is of type Intrinsics'),
    (RIG.value, "upper.focus", 'no parameter "focus"'),
    (RIG.sigma, "upper.focus", 'no parameter "focus"'),
    (RIG.sigma, "top.pan_deg", 'no camera "top"'),
    (
        lambda size: trinoc.Intrinsics(focal_length_px=900, image_size_px=size),
        (512.5, 480),
        "whole positive pixels",
    ),
]


@pytest.fixture
def as_installed() -> Iterator[None]:
    """Without the checks of annotations, which users do not have."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.mark.usefixtures("as_installed")
@pytest.mark.parametrize(("call", "given", "said"), CALLS, ids=[said for *_, said in CALLS])
def test_it_is_said_what_is_wrong(call: Callable[[Any], Any], given: Any, said: str) -> None:
    with pytest.raises(TrinocError, match=said) as caught:
        call(given)
    assert isinstance(caught.value, InputError)
    assert "\n" not in str(caught.value)


def test_what_is_not_known_of_a_lens_is_nan_and_no_error() -> None:
    assert np.isnan(RIG.sigma("upper.fx_px"))
    assert np.isnan(RIG.sigma("upper.pan_deg"))

"""Arguments of a wrong type and impossible numbers are refused by name, in one sentence."""

import itertools
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
    (lambda images: trinoc.calibrate(images, SHEET, LENS), GREY["left"], "images is of type nda"),
    (
        lambda value: trinoc.calibrate(GREY, SHEET, LENS, systematics=value),
        0.1,
        "knowledge of the sheet is of type float",
    ),
    (lambda images: trinoc.calibrate_rig(images, SHEET), ["a.png"], "of images is of type list"),
    (lambda board: trinoc.calibrate_rig({"a": []}, board), "board.json", "board is of type str"),
    (lambda images: trinoc.calibrate_intrinsics(images, SHEET), None, "list of pictures is None"),
    (lambda board: trinoc.calibrate_intrinsics([], board), LENS, "pattern is of type Intrinsics"),
    (lambda result: trinoc.next_shot(result), RIG, "result is of type Rig"),
    (lambda rig: trinoc.match_segments(SEGMENTS, rig), "rig.json", "The rig is of type str"),
    (lambda value: trinoc.match_segments(value, RIG), RIG, "set of segments is of type Rig"),
    (lambda value: trinoc.match_segments(value, RIG), GREY, "the result of find_segments"),
    (
        lambda depths: trinoc.match_segments(SEGMENTS, RIG, depth_range_mm=depths),
        (5.0, 1.0),
        "contains no depth",
    ),
    (
        lambda depths: trinoc.match_segments(SEGMENTS, RIG, depth_range_mm=depths),
        5.0,
        "contains no depth",
    ),
    (lambda sigma: trinoc.match_segments(SEGMENTS, RIG, sigma_px=sigma), -1.0, "no end is exact"),
    (lambda sigma: trinoc.match_segments(SEGMENTS, RIG, sigma_px=sigma), 0.0, "no end is exact"),
    (lambda rig: trinoc.refine(rig, MATCHES), MATCHES, "The rig is of type Matches"),
    (lambda matches: trinoc.refine(RIG, matches), GREY, "set of matches is of type dict"),
    (lambda rig: trinoc.check_rig(rig, MATCHES), "rig.json", "The rig is of type str"),
    (
        lambda lines: trinoc.evaluate(lines, np.zeros((1, 2, 3))),
        "m.npz",
        "The lines contain no ends",
    ),
    (lambda edges: trinoc.evaluate(MATCHES, edges), None, "The known edges contain no ends"),
    (lambda lens: trinoc.find_segments(GREY["left"], intrinsics=lens), RIG, "lens is of type Rig"),
    (trinoc.undistort, "camera.json", "lens or rig is of type str"),
    (trinoc.rectify, LENS, "The rig is of type Intrinsics"),
    (trinoc.Segments.from_endpoints, "a.csv", "Segments of type str contain no numbers"),
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
    (
        lambda value: trinoc.Intrinsics(
            focal_length_px=900, image_size_px=(640, 480), distortion=value
        ),
        [0.1, 0.2, 0.3],
        "p2 is missing",
    ),
    (
        lambda value: trinoc.Intrinsics(
            focal_length_px=900, image_size_px=(640, 480), distortion=value
        ),
        [np.nan],
        "must be finite",
    ),
    (
        lambda rows: trinoc.Chessboard(rows=rows, columns=9, square_mm=20.0),
        6.5,
        "rows is 6.5, but must be a whole number",
    ),
    (
        lambda rows: trinoc.AprilGrid(rows=rows, columns=6, tag_mm=20.0),
        "six",
        "rows is 'six', but must be a finite number",
    ),
    (
        lambda side: trinoc.Charuco(rows=5, columns=7, square_mm=side),
        None,
        "square_mm is None, but must be a finite number",
    ),
    (trinoc.find_segments, "x.png", 'The picture is the name "x.png", but must be an array'),
    (trinoc.find_segments, None, "The picture is None, but must be an array"),
    (trinoc.find_segments, np.ones((480, 512), bool), "has truth values"),
    (lambda grey: trinoc.calibrate({"a": grey}, SHEET, LENS), GREY["left"] > 3, "has truth values"),
    (RIG["left"].project, (1.0, 2.0), r"The point has shape \(2,\)"),
]

# Whatever is no such thing is given in each place.
JUNK: list[Any] = [None, "x", 5, -1.0, np.nan, True, b"x", [], {}, [1, 2, 3], {"a": None}, object()]
DOORS: dict[str, tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]] = {
    "load_rig": (trinoc.load_rig, ("none/rig.json",), {}),
    "load": (trinoc.load, ("none/rig.json",), {}),
    "load_matches": (trinoc.load_matches, ("none/matches.npz",), {}),
    "load_segments": (trinoc.load_segments, ("none/segments.npz",), {}),
    "load_pattern": (trinoc.load_pattern, ("none/sheet.json",), {}),
    "load_recording": (trinoc.load_recording, ("none",), {}),
    "save": (trinoc.save, (RIG, "none/rig.json"), {}),
    "Chessboard": (trinoc.Chessboard, (), {"rows": 5, "columns": 6, "square_mm": 10.0}),
    "Charuco": (
        trinoc.Charuco,
        (),
        {"rows": 5, "columns": 6, "square_mm": 10.0, "marker_mm": 7.0, "first": 0},
    ),
    "AprilGrid": (
        trinoc.AprilGrid,
        (),
        {"rows": 5, "columns": 6, "tag_mm": 10.0, "spacing": 0.3, "border": 2, "first": 0},
    ),
    "cross_grid": (
        trinoc.Pattern.cross_grid,
        (),
        {
            "rows": 5,
            "columns": 6,
            "pitch_mm": 20.0,
            "radius_mm": 5.0,
            "inner_radius_mm": 2.0,
            "line_width_mm": 1.0,
            "line_half_length_mm": (50.0, 50.0),
        },
    ),
    "circle_grid": (
        trinoc.Pattern.circle_grid,
        (),
        {"rows": 5, "columns": 6, "pitch_mm": 20.0, "radius_mm": 5.0},
    ),
    "asymmetric_circle_grid": (
        trinoc.Pattern.asymmetric_circle_grid,
        (),
        {"rows": 5, "columns": 6, "spacing_mm": 20.0, "radius_mm": 5.0},
    ),
    "Intrinsics": (
        trinoc.Intrinsics,
        (),
        {
            "image_size_px": (640, 480),
            "focal_length_px": 900.0,
            "skew_px": 0.0,
            "principal_point_px": (1.0, 2.0),
            "distortion": [0.1],
            "distortion_model": None,
        },
    ),
    "from_degrees": (
        trinoc.Camera.from_degrees,
        (LENS,),
        {"pan_deg": 0.0, "tilt_deg": 50.0, "swing_deg": 0.0, "distance_mm": 4.0, "aim_mm": (0, 0)},
    ),
    "from_matrices": (
        trinoc.Rig.from_matrices,
        ({"a": RIG["left"].matrix_px},),
        {"image_size_px": (512, 480)},
    ),
    "Rig": (trinoc.Rig, (dict(RIG.items()),), {"parameters": ("a",), "covariance": np.eye(1)}),
    "value": (RIG.value, ("left.pan_deg",), {}),
    "sigma": (RIG.sigma, ("left.pan_deg",), {}),
    "take": (RIG.take, (("left",),), {}),
    "project": (RIG["left"].project, ((0.0, 0.0, 0.0),), {}),
    "from_endpoints": (
        trinoc.Segments.from_endpoints,
        (ENDS,),
        {"sigma_px": 0.5, "sigma_along_px": 2.0},
    ),
    "rectify": (trinoc.rectify, (RIG,), {"alpha": 0.0, "image_size_px": (640, 480)}),
    "check_rig": (trinoc.check_rig, (RIG, None), {}),
    "match_recording": (
        trinoc.match_recording,
        ("none", RIG, "out"),
        {"frames_per_file": 16, "threads_at_most": None, "memory_gb": None},
    ),
}


@pytest.mark.usefixtures("as_installed")
@pytest.mark.parametrize("door", DOORS)
def test_junk_in_any_place_is_a_sentence(door: str, tmp_path, monkeypatch) -> None:
    """No argument of a public function causes an error of Python or of a library."""
    monkeypatch.chdir(tmp_path)
    function, arguments, named = DOORS[door]
    positions = [*range(len(arguments)), *named]
    for position, junk in itertools.product(positions, JUNK):
        values = [junk if position == k else each for k, each in enumerate(arguments)]
        options = {name: junk if position == name else each for name, each in named.items()}
        try:
            function(*values, **options)
        except TrinocError as error:
            sentence = str(error)
            assert sentence, (position, junk)
            assert "\n" not in sentence, (position, junk)


@pytest.fixture
def as_installed() -> Iterator[None]:
    """Run trinoc without the run-time checks of annotations, as users do."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.mark.usefixtures("as_installed")
@pytest.mark.parametrize(
    ("call", "value", "message"), CALLS, ids=[message for *_, message in CALLS]
)
def test_it_is_said_what_is_wrong(call: Callable[[Any], Any], value: Any, message: str) -> None:
    with pytest.raises(TrinocError, match=message) as caught:
        call(value)
    assert isinstance(caught.value, InputError)
    assert "\n" not in str(caught.value)


def test_what_is_not_known_of_a_lens_is_nan_and_no_error() -> None:
    assert np.isnan(RIG.sigma("upper.fx_px"))
    assert np.isnan(RIG.sigma("upper.pan_deg"))

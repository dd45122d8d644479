"""Lenses and rigs from many shots: corners of every kind of board, grey levels of a few."""

from functools import partial

import numpy as np
from intrinsics import LENS, image_of, random_poses

import trinoc
from golden_parts import records
from golden_parts.inputs import (
    EXACT,
    SIGMA_PX,
    TARGETS,
    board_pictures,
    digest,
    set_of_boards,
    shots,
)
from golden_parts.records import Values, attempt
from trinoc.calib import CalibrationResult
from trinoc.calib.result.summary import fixed_boards
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.polynomial import BrownConrady

TWO, THREE = ("left", "right"), ("left", "middle", "right")


def lens() -> Values:
    """A lens from simulated pictures of the sheet: circles, grey levels, fixed parameters."""
    noise = np.random.default_rng(6)
    images = [image_of(LENS, pose) for pose in random_poses(5, 5)]
    images = [np.rint(np.clip(p + 2 * noise.normal(size=p.shape), 0, 255)) for p in images]
    images = [image.astype(np.uint8) for image in images]
    yield "inputs", digest(*images)
    sheet = trinoc.Pattern.default()
    detections = [trinoc.calib.detect_pattern(image, sheet) for image in images]
    for label, options in {
        "default": {},
        "two coefficients": {"distortion": 2},
        "no distortion": {"distortion": 0},
        "held middle": {"principal_point": "centre", "aspect": "pitch", "distortion": 1},
        "fisheye": {"lens_model": "kannala_brandt", "distortion": 2},
    }.items():
        call = partial(trinoc.calibrate_intrinsics, detections, sheet, throw=False, **options)
        yield from attempt(label, call, records.lens_calibration)
    for label, subset in {"one picture": detections[:1], "two pictures": detections[:2]}.items():
        result = trinoc.calibrate_intrinsics(subset, sheet, throw=False)
        yield from records.lens_calibration(label, result)
        call = partial(trinoc.calibrate_intrinsics, subset, sheet)
        yield from attempt(f"{label} thrown", call, records.lens_calibration)
    by_pixels = trinoc.calibrate_intrinsics(images, sheet, method="pixels")
    yield from records.lens_calibration("pixels", by_pixels)


def rig_points() -> Values:
    """Rigs from corners of all boards, of two and three cameras, and few or wrong shots."""
    for title in TARGETS:
        yield from _rig(title, title, TWO, 6)
    yield from _rig("three cameras", "chessboard", THREE, 5, systematics=EXACT)
    yield from _rig("few shots", "chessboard", TWO, 3)
    yield from _rig("one shot", "sheet", TWO, 1)
    yield from _rig("one camera", "sheet", ("left",), 5)
    moved = shots("chessboard", TWO, 7, seed=4)
    moved["right"][2] = moved["right"][5]
    call = partial(trinoc.calibrate_rig, moved, TARGETS["chessboard"])
    yield from attempt("another moment", call, records.rig_of_shots)
    disjoint = shots("chessboard", TWO, 6, seed=5)
    disjoint["left"][3:] = disjoint["right"][:3] = [None] * 3
    call = partial(trinoc.calibrate_rig, disjoint, TARGETS["chessboard"])
    yield from attempt("no shot in common", call, records.rig_of_shots)
    target, detections = set_of_boards()
    call = partial(trinoc.calibrate_rig, detections, target, distortion=4)
    yield from attempt("board set", call, _rig_of_set)


def rig_options() -> Values:
    """Rigs with given, shared or fixed parameters."""
    yield from _rig("same lens", "charuco", TWO, 6, same_lens=True, distortion=2)
    yield from _rig("fisheye model", "chessboard", TWO, 6, lens_model="kannala_brandt")
    yield from _rig("world left", "sheet", TWO, 6, world="left", distortion=4)
    left_lens = Intrinsics.of_lens(BrownConrady.from_parameters(np.array(LEFT)), (640, 480))
    yield from _rig("left held", "chessboard", TWO, 6, lens={"left": left_lens})
    terms = trinoc.Systematics(print_size_sigma=0.002, flatness_mm=0.3)
    yield from _rig("terms", "aprilgrid", TWO, 6, systematics=terms)


LEFT = (800.0, 805.0, 322.0, 236.0, -0.20, 0.06, 0.001, -0.0005, 0.0)


def _rig(label: str, title: str, cameras: tuple[str, ...], count: int, **options) -> Values:
    detections = shots(title, cameras, count, seed=len(label))
    call = partial(trinoc.calibrate_rig, detections, TARGETS[title], throw=False, **options)
    yield from attempt(label, call, _with_advice if label in SIGMA_PX else records.rig_of_shots)


def _with_advice(prefix: str, result: CalibrationResult) -> Values:
    """A rig, its sigma over the field, and the most informative next shot."""
    yield from records.rig_of_shots(prefix, result)
    if not result.has_rig:
        return
    field = trinoc.calib.projection_sigma(result.rig, "left", 550.0)
    yield f"{prefix}.projection_sigma", field.sigma_px
    advice = trinoc.next_shot(result)
    if advice is not None:
        names = ("sentence", "cameras", "world_from_board", "error_now_px", "error_then_px")
        yield from records.fields(f"{prefix}.next_shot", advice, names)


def _rig_of_set(prefix: str, result: CalibrationResult) -> Values:
    yield from records.rig_of_shots(prefix, result)
    yield f"{prefix}.fixed_boards", fixed_boards(result)


def rig_pixels() -> Values:
    """Rigs of two cameras from the grey levels of four shots: the sheet, and a ChArUco board."""
    for title in ("sheet", "charuco"):
        pictures = board_pictures(title, TWO, 4)
        yield (
            f"{title}.inputs",
            digest(*(image for images in pictures.values() for image in images)),
        )
        call = partial(
            trinoc.calibrate_rig, pictures, TARGETS[title], method="pixels", distortion=2
        )
        yield from attempt(title, call, records.rig_of_shots)

"""Joint refinement of cameras and lines, and the test for knocked cameras."""

from functools import partial

import numpy as np

import trinoc
from golden_parts import records
from golden_parts.inputs import (
    blocks,
    calibrated_demo,
    demo_matches,
    demo_segments,
    five_view_rig,
    knocked_rig,
)
from golden_parts.records import Values, attempt
from simulation import Detector, simulate_segments
from simulation.scenes import see_through_boxes
from trinoc.io import demo_images, demo_pattern
from trinoc.synth import table1_lens, table1_rig


def refine() -> Values:
    """Joint refinement: with a sheet, a prior or neither, a free lens, a knocked camera, pairs."""
    calibrated, matches = calibrated_demo(), demo_matches()
    typical = trinoc.calibrate(demo_images("sheet"), demo_pattern(), table1_lens(), method="points")
    bare = trinoc.Rig(dict(calibrated.rig.items()))
    for label, rig, options in (
        ("sheet", calibrated, {}),
        ("typical", typical, {}),
        ("prior", calibrated.rig, {}),
        ("gauge held", bare, {}),
        ("aim-free", calibrated, {"pose_model": "aim-free"}),
        ("rigid", bare, {"pose_model": "rigid"}),
        ("lens free", calibrated, {"free_lens": True}),
        ("moved", calibrated, {"moved": ["left"]}),
        ("no such camera", calibrated, {"moved": ["lower"]}),
    ):
        call = partial(trinoc.refine, rig, matches, **options)
        yield from attempt(label, call, records.refinement)
    rematch = partial(trinoc.match_segments, demo_segments())
    call = partial(trinoc.refine, calibrated, matches, match_again=rematch)
    yield from attempt("matched again", call, records.refinement)
    two = {view: demo_segments()[view] for view in ("upper", "left")}
    pairs = trinoc.match_segments(two, calibrated.rig)
    yield from attempt("two views", partial(trinoc.refine, calibrated, pairs), records.refinement)


def refine_made() -> Values:
    """A knocked camera without a sheet, five views, and two cameras."""
    scene = see_through_boxes(900_002, count=12)
    segments, _ = simulate_segments(scene, table1_rig(), Detector(), seed=8)
    rig = knocked_rig()
    matches = trinoc.match_segments(segments, rig, sigma_px=1.0)
    call = partial(trinoc.refine, rig, matches, moved=["left"])
    yield from attempt("knocked", call, records.refinement)
    five = five_view_rig()
    segments, _ = simulate_segments(scene, five, Detector(), seed=9)
    call = partial(trinoc.refine, five, trinoc.match_segments(segments, five))
    yield from attempt("five views", call, records.refinement)
    two = {view: demo_images("sheet")[view] for view in ("upper", "left")}
    sheet = trinoc.calibrate(two, demo_pattern(), table1_lens(), method="points")
    pairs = trinoc.match_segments({view: demo_segments()[view] for view in two}, sheet.rig)
    call = partial(trinoc.refine, sheet, pairs)
    yield from attempt("two cameras", call, records.refinement)


def rig_check() -> Values:
    """An unchanged rig, one with a knocked camera, and a scene that is inconclusive."""
    calibrated, segments = calibrated_demo(), demo_segments()
    yield from records.check("stands", trinoc.check_rig(calibrated.rig, demo_matches()))
    knocked = _turned(calibrated.rig, "left", 0.15)
    match = partial(trinoc.match_segments, segments)
    loose = trinoc.match_segments(segments, knocked, sigma_px=1.5)
    call = partial(trinoc.check_rig, knocked, loose)
    yield from attempt("knocked", call, records.check)
    rematches = [partial(trinoc.match_segments, segments, sigma_px=2.0), match]
    call = partial(trinoc.check_rig, knocked, loose, match_again=rematches)
    yield from attempt("knocked, matched again", call, records.check)
    few = {
        view: _rows(view_segments, np.arange(0, len(view_segments), 6))
        for view, view_segments in segments.items()
    }
    matches = trinoc.match_segments(few, calibrated.rig)
    call = partial(trinoc.check_rig, calibrated.rig, matches)
    yield from attempt("few lines", call, records.check)
    made, _ = blocks()
    matches = trinoc.match_segments(made, table1_rig())
    call = partial(trinoc.check_rig, table1_rig(), matches)
    yield from attempt("without covariance", call, records.check)


def _turned(rig: trinoc.Rig, name: str, angle_deg: float) -> trinoc.Rig:
    camera = rig[name]
    moved = trinoc.Camera.from_degrees(
        camera.intrinsics,
        pan_deg=camera.pan_deg + angle_deg,
        tilt_deg=camera.tilt_deg,
        swing_deg=camera.swing_deg,
        distance_mm=camera.distance_mm,
    )
    cameras = {**dict(rig.items()), name: moved}
    return trinoc.Rig(cameras, parameters=rig.parameters, covariance=rig.covariance)


def _rows(segments: trinoc.Segments, rows: np.ndarray) -> trinoc.Segments:
    return trinoc.Segments.from_endpoints(np.asarray(segments.endpoints_px)[rows])

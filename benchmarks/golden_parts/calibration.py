"""Calibrations from one picture each: by circles, by grey levels, as cameras deliver, by points."""

from functools import partial

import numpy as np

import trinoc
from golden_parts import records
from golden_parts.inputs import EXACT, TERMS, delivered, digest
from golden_parts.records import Values, attempt
from simulation.camera_picture.render import render_sheet
from trinoc.calib import calibrate_detections
from trinoc.calib.rig_check.comparison import compare_rigs
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.io import demo_images, demo_pattern
from trinoc.synth import table1_lens, table1_rig


def calibrate_circles() -> Values:
    """The demo's sheet by the centres of its circles; detections, a plain grid."""
    pattern, images, lens = demo_pattern(), demo_images("sheet"), table1_lens()
    detections = {
        view: trinoc.calib.detect_pattern(image, pattern) for view, image in images.items()
    }
    for view, detection in detections.items():
        yield from records.detection(view, detection)
    results = {}
    for label, options in {
        "typical": {},
        "exact": {"systematics": EXACT},
        "six": {"pose_model": "aim-free"},
        "exact six": {"systematics": EXACT, "pose_model": "aim-free"},
        "terms": {"systematics": TERMS},
    }.items():
        results[label] = calibrate_detections(detections, pattern, lens, **options)
        yield from records.calibration(label, results[label])
    arguments = {"systematics": EXACT, "method": "points"}
    from_images = trinoc.calibrate(images, pattern, lens, **arguments)
    yield from records.calibration("images", from_images)
    carried = trinoc.calib.with_systematics(results["exact"], TERMS)
    yield from records.calibration("carried", carried)
    change = compare_rigs(results["typical"], results["exact six"])
    yield "compared.sentences", change.sentences
    yield "compared.sigmas", [camera.sigmas for camera in change.cameras.values()]
    yield from _uncertainty(results)
    yield from _plain_grid()


def _uncertainty(results) -> Values:
    for label in ("typical", "exact six"):
        rig = results[label].rig
        sigma = trinoc.calib.epipolar_sigma(rig, "upper", "left")
        yield f"{label}.epipolar_sigma_px", sigma.sigma_px
        point = np.array([5.0, 9.0, 3.0])
        yield f"{label}.point_covariance", trinoc.calib.point_covariance(rig, point)


def _plain_grid() -> Values:
    """A sheet that looks the same after a turn: refused, or oriented by the user."""
    grid = trinoc.Pattern.circle_grid(rows=6, columns=7, pitch_mm=20.0, radius_mm=6.0)
    rig = table1_rig()
    images = {name: render_sheet(grid, camera, seed=3) for name, camera in rig.items()}
    yield "grid.inputs", digest(*images.values())
    for label, orientation in {"open": None, "upright": "upright", "earlier": rig}.items():
        call = partial(
            trinoc.calibrate, images, grid, table1_lens(), method="points", orientation=orientation
        )
        yield from attempt(f"grid {label}", call, records.calibration)


def calibrate_pictures() -> Values:
    """The demo's sheet by all of its grey levels: four and six parameters, systematics."""
    pattern, images, lens = demo_pattern(), demo_images("sheet"), table1_lens()
    for label, options in {
        "typical": {},
        "exact": {"systematics": EXACT},
        "exact six": {"systematics": EXACT, "pose_model": "aim-free"},
        "terms": {"systematics": TERMS},
    }.items():
        result = trinoc.calibrate(images, pattern, lens, **options)
        yield from records.calibration(label, result)
    blank = {**images, "left": np.full_like(images["left"], 200)}
    yield from attempt(
        "blank", partial(trinoc.calibrate, blank, pattern, lens), records.calibration
    )
    partly = trinoc.calibrate(blank, pattern, lens, throw=False)
    yield from records.calibration("without left", partly)


def calibrate_delivered() -> Values:
    """Pictures as cameras deliver them, which the extended model fits."""
    yield from _conditions(
        *("sRGB", "motion 3 px", "raw RGGB, told", "JPEG 90"),
    )


def calibrate_lit() -> Values:
    """Pictures under uneven or too strong light, and pictures of more than eight bits."""
    yield from _conditions("vignette and broad glare", "overexposed", "16 bit")


def calibrate_suspect() -> Values:
    """Conditions that the model refutes: wrong lenses, bent paper, covered sheets."""
    yield from _conditions(
        *("focal length .05 % off", "aim .1 mm off", "bent .3 mm", "print 1 % larger", "card"),
        *("correlated noise", "principal point 5 px off, six"),
    )
    picture, _, _ = delivered("reference")
    wrong = Intrinsics(focal_length_px=(1030.0, 1200.0), image_size_px=(512, 480))
    call = partial(
        trinoc.calibrate, {"a": picture}, trinoc.Pattern.default(), wrong, systematics=EXACT
    )
    yield from attempt("another lens", call, records.calibration)


def _conditions(*names: str) -> Values:
    pattern = trinoc.Pattern.default()
    for name in names:
        picture, lens, condition = delivered(name)
        yield f"{name}.inputs", digest(picture)
        settings = condition.told
        options = {} if settings.exact == "nothing" else {"systematics": EXACT}
        call = partial(
            trinoc.calibrate, {"a": picture}, pattern, lens, bayer=settings.bayer,
            pose_model="aimed" if settings.parameters == 4 else "aim-free",
            response=settings.response, **options,
        )  # fmt: skip
        yield from attempt(name, call, records.calibration)


def points() -> Values:
    """One camera from known points, planar and not, with every choice of free parameters."""
    generator = np.random.default_rng(3)
    solid = generator.uniform(-80, 80, (60, 3))
    flat = np.column_stack([generator.uniform(-80, 80, (40, 2)), np.zeros(40)])
    camera, lens = table1_rig()["right"], table1_lens()
    off = Intrinsics(
        focal_length_px=np.asarray(lens.focal_length_px) * 1.01,
        principal_point_px=np.asarray(lens.principal_point_px) + 2.0,
        image_size_px=lens.image_size_px,
    )
    everything = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2")
    bare = {"image_size_px": lens.image_size_px}
    for label, points_mm, intrinsics, options in (
        ("solid", solid, lens, {}),
        ("solid exact", solid, lens, {"systematics": EXACT}),
        ("solid aim-free", solid, lens, {"pose_model": "aim-free"}),
        ("solid aimed", solid, lens, {"pose_model": "aimed"}),
        ("solid focal", solid, off, {"free": ("fx_px", "fy_px")}),
        ("solid lens", solid, off, {"free": everything}),
        ("solid terms", solid, lens, {"systematics": _lens_terms(), "free": ("k1",)}),
        ("bare", solid, None, bare),
        ("bare with k1", solid, None, {**bare, "free": everything[:5]}),
        ("flat", flat, lens, {}),
        ("flat aim-free", flat, lens, {"pose_model": "aim-free", "systematics": EXACT}),
        ("flat lens", flat, off, {"free": everything}),
        ("flat bare", flat, None, bare),
        ("five points", solid[:5], lens, {}),
        ("three points", solid[:3], lens, {}),
        ("one line", solid[:1] + np.arange(9)[:, None] * [1.0, 2, 3], lens, {}),
    ):
        image = points_mm @ camera.matrix_px[:, :3].T + camera.matrix_px[:, 3]
        pixels = image[:, :2] / image[:, 2:]
        pixels = pixels + 0.1 * np.random.default_rng(9).standard_normal(pixels.shape)
        if label == "solid":
            pixels[7] += 12.0
        call = partial(trinoc.calibrate_points, points_mm, pixels, intrinsics, **options)
        yield from attempt(label, call, records.points_calibration)


def _lens_terms() -> trinoc.Systematics:
    return trinoc.Systematics(lens_covariance=np.diag([4.0, 4.0, 9.0, 9.0]))

"""Frozen numbers and sentences of each result, as (name, array) pairs."""

import enum
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import cv2
import numpy as np

import trinoc
from trinoc.errors import TrinocError
from trinoc.synth import table1_rig

Values = Iterator[tuple[str, Any]]

SEGMENTS = (
    *("endpoints_px", "covariance_px2", "polarity", "contrast", "support", "chain"),
    *("side_levels", "reasons"),
)
MATCHES = (
    *("index", "fragments_px", "fragments_covariance_px2", "lines_mm", "covariance_mm2", "stage"),
    *("posterior", "rival_posterior", "misfit", "viewpoint_dependent", "noise_scale", "noise_tail"),
    *("notes", "counts"),
)
MARKS = ("measure", "silhouette")
FIT = ("status", "parameters", "values", "covariance")


def array_of(value: Any) -> np.ndarray:
    """Array of a value: numbers unchanged, unequal shapes flattened; other values as text."""
    match value:
        case None:
            return np.array("none")
        case enum.Enum():
            return np.array(value.name)
        case Mapping():
            return np.array(
                [f"{key}: {array_of(entry)}" for key, entry in value.items()], dtype=str
            )
        case tuple() | list() if not value or isinstance(value[0], str):
            return np.array(value, dtype=str)
        case tuple() | list() if len({np.shape(entry) for entry in value}) > 1:
            return np.concatenate([np.ravel(entry) for entry in value])
    return np.asarray(value)


def fields(prefix: str, value: Any, names: tuple[str, ...]) -> Values:
    """Named attributes of a result. A missing attribute is recorded and raises nothing."""
    for name in names:
        yield f"{prefix}.{name}", getattr(value, name, "no such field")


def attempt(prefix: str, call: Callable[[], Any], record: Callable[[str, Any], Values]) -> Values:
    """The result of a call, or the message of its exception."""
    try:
        value = call()
    except TrinocError as error:
        yield f"{prefix}.refusal", f"{type(error).__name__}: {error}"
    else:
        yield from record(prefix, value)


def detection(prefix: str, result: Any) -> Values:
    """Positions that a detector reports."""
    names = ("circle_index", "centres_px", "covariance_px2", "shape_px2", "lines_px")
    yield from fields(prefix, result, names)


def calibration(prefix: str, result: Any) -> Values:
    """A CalibrationResult with all fields of each camera's fit."""
    yield from fields(prefix, result, (*FIT, "failures", "systematics", "notes"))
    yield f"{prefix}.summary", result.summary()
    yield from rig(f"{prefix}.rig", result.rig)
    for name, fit in result.fits.items():
        camera_prefix = f"{prefix}.{name}"
        names = ("method", "used", "residuals_px", "rank", "gauge", "reduced_chi_square", "notes")
        yield from fields(camera_prefix, fit, names)
        for other in fit.fixed_parameter_tests:
            names = ("chi_square_drop", "p_value", "estimate", "sigma", "sentence")
            yield from fields(f"{camera_prefix}.{other.name}", other, names)
        if fit.image is not None:
            names = ("noise", "noise_floor", "pixels", "pixels_cut", "blur_px", "ink_spread_mm")
            names += ("ink_over_paper", "found", "bound")
            yield from fields(f"{camera_prefix}.image", fit.image, names)


def rig(prefix: str, value: Any) -> Values:
    """Projection matrices of a rig and its covariance."""
    yield f"{prefix}.matrices_px", value.matrices_px
    yield from fields(prefix, value, ("names", "parameters", "covariance"))


def points_calibration(prefix: str, result: Any) -> Values:
    """One camera from points."""
    fit = result.fits["camera"]
    names = tuple(name.removeprefix("camera.") for name in result.parameters)
    yield f"{prefix}.status", result.overall_status
    yield f"{prefix}.parameters", names
    yield from fields(prefix, result, ("covariance",))
    yield from fields(prefix, fit, ("residuals_px", "used"))
    yield f"{prefix}.noise_px", fit.sigma_factor
    yield f"{prefix}.cam_from_world", result.camera.cam_from_world
    yield f"{prefix}.lens", result.camera.intrinsics.lens.parameters
    numbers = _numbers_of(result.camera)
    yield f"{prefix}.values", [numbers.get(name, 0.0) for name in names]


def _numbers_of(camera: Any) -> dict[str, float]:
    """Pose and lens by the names of parameters; turns are those from the paper's right camera."""
    reference = np.asarray(table1_rig()["right"].cam_from_world)[:, :3]
    turn = cv2.Rodrigues(np.asarray(camera.cam_from_world)[:, :3] @ reference.T)[0].ravel()
    numbers = {f"turn_{axis}_deg": np.degrees(value) for axis, value in zip("xyz", turn)}
    numbers |= {f"centre_{axis}_mm": value for axis, value in zip("xyz", camera.centre_world_mm)}
    numbers |= {f"aim_{axis}_mm": value for axis, value in zip("xy", camera.aim_mm)}
    for name in ("pan_deg", "tilt_deg", "swing_deg", "distance_mm"):
        numbers[name] = getattr(camera, name)
    lens = camera.intrinsics.lens
    return numbers | dict(zip(lens.parameter_names, np.asarray(lens.parameters), strict=True))


def lens_calibration(prefix: str, result: Any) -> Values:
    """One lens from pictures."""
    names = result.lens_parameters
    rows = [result.parameters.index(f"camera.{name}") for name in names]
    yield f"{prefix}.status", result.overall_status
    yield f"{prefix}.parameters", names
    yield f"{prefix}.values", result.values[rows]
    yield f"{prefix}.covariance", result.covariance[np.ix_(rows, rows)]
    yield f"{prefix}.gauge", tuple(name.removeprefix("camera.") for name in result.gauge)
    factor = result.fits["camera"].sigma_factor
    yield f"{prefix}.reduced_chi_square", factor**2 * result.reduced_chi_square
    yield f"{prefix}.field_sigma_px", result.field_sigma_px
    yield f"{prefix}.cam_from_world", result.world_from_board
    yield f"{prefix}.residuals_px", list(result.residuals_px)
    yield f"{prefix}.used", [view.used for view in result.views]
    yield from fields(prefix, result, ("failures", "notes"))
    yield f"{prefix}.summary", result.summary()
    advice = trinoc.next_shot(result)
    if advice is not None:
        yield f"{prefix}.next_image.sentence", advice.sentence
        yield f"{prefix}.next_image.cam_from_world", advice.world_from_board
        yield f"{prefix}.next_image.sigma_then", advice.sigma_then.get(advice.parameter or "")


def rig_of_shots(prefix: str, result: Any) -> Values:
    """A rig from many shots."""
    names = ("gauge", "world", "shots", "world_from_board", "reference_from_board", "failures")
    names += ("place_shifts_mm", "reduced_chi_square", "refused", "systematics")
    yield f"{prefix}.status", result.overall_status
    yield f"{prefix}.sigma_factor", {name: fit.sigma_factor for name, fit in result.fits.items()}
    yield from fields(prefix, result, (*FIT[1:], *names, "notes"))
    yield f"{prefix}.summary", result.summary()
    yield f"{prefix}.residuals_px", np.concatenate(result.residuals_px)
    yield f"{prefix}.used", np.concatenate([view.used for view in result.views])
    if result.halves is not None:
        names = ("ratio", "worst", "worst_ratio", "parameters")
        yield from fields(f"{prefix}.halves", result.halves, names)
    if result.cross_validation is not None:
        yield from fields(f"{prefix}.held_out", result.cross_validation, ("own_px", "across_px"))
    if result.has_rig:
        yield from rig(f"{prefix}.rig", result.rig)


def refinement(prefix: str, result: Any) -> Values:
    """Cameras and lines together."""
    names = ("inlier", "distance_sigma", "rank", "gauge", "segment_sigma_factor", "history")
    names += ("sheet_sigma_factor", "sheet_chi_square", "chi_square", "log_posterior")
    yield from fields(prefix, result, (*FIT, *names))
    yield f"{prefix}.ends_mm", result.lines.ends_mm
    yield f"{prefix}.summary", result.summary()
    yield from rig(f"{prefix}.rig", result.rig)


def check(prefix: str, result: Any) -> Values:
    """Test for knocked cameras."""
    yield from fields(prefix, result, ("moved", "conclusive"))
    yield f"{prefix}.summary", result.summary()
    for motion in result.motions:
        names = ("sigmas", "parameters", "change", "sigma")
        yield from fields(f"{prefix}.{motion.name}", motion, names)
    if result.refined is not None:
        yield from refinement(f"{prefix}.refined", result.refined)


def segments(prefix: str, result: Any) -> Values:
    """Segments of one picture."""
    yield from fields(prefix, result, SEGMENTS)


def matches(prefix: str, result: Any) -> Values:
    """Tracks of one scene."""
    yield from fields(prefix, result, MATCHES)
    for name in MARKS:
        yield f"{prefix}.{name}", result.marks.get(name)
    for view, reasons in result.reasons.items():
        yield f"{prefix}.reasons.{view}", reasons

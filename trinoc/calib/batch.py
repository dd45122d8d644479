"""Many rigs or frames at once: a status for every picture."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.adjustment.each_camera import fit_cameras
from trinoc.calib.detection.detection import Detection
from trinoc.calib.detection.orientation import Orientation, resolve_orientation
from trinoc.calib.from_detections import Search, lens_of_each, outcome_of_search
from trinoc.calib.messages import failure_sentence
from trinoc.calib.result.calibration import Status
from trinoc.calib.rig_fit import Knowledge
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import PoseModel, pose_model_over_sheet
from trinoc.numerics.precision import in_float64


class BatchCalibration(NamedTuple):
    """Circle fits of many frames of a rig.

    Fields
    ------
    names : of the cameras, the order of axis v.
    parameters : of one camera, the order of axis p.
    status : for each frame, that of each camera by name.
    values : (n, v, p) degrees and mm; NaN where a picture gave no answer.
    covariance : (n, v, p, p)
    good : (n, v) whether a camera's pose may be used.
    failures : for each frame, a sentence for each camera that failed.
    """

    names: tuple[str, ...]
    parameters: tuple[str, ...]
    status: list[dict[str, Status]]
    values: Float[np.ndarray, "n v p"]
    covariance: Float[np.ndarray, "n v p p"]
    good: Bool[np.ndarray, "n v"]
    failures: list[dict[str, str]]


@in_float64
def calibrate_batch(
    frames: Sequence[Mapping[str, Detection]],
    pattern: Pattern,
    lens: Intrinsics | Mapping[str, Intrinsics],
    *,
    pose_model: PoseModel | str = PoseModel.AIMED,
    orientation: Orientation = None,
    systematics: Systematics | None = None,
) -> BatchCalibration:
    """`calibrate_detections` for many frames; a picture that fails spoils no other.

    systematics : as of `calibrate_detections`, each frame with errors of its own. `Systematics()`,
        everything exact, fits each camera by itself.

    A camera that is missing from a frame has the status NOT_DETECTED there, and one whose sheet
    looks the same turned AMBIGUOUS, unless `orientation` says which way round it lies. Raises
    InputError where no frame holds a camera, or a lens is missing.
    """
    names = tuple(dict.fromkeys(name for frame in frames for name in frame))
    lenses = lens_of_each(lens, dict.fromkeys(names))
    model = pose_model_over_sheet(pose_model)
    known = Knowledge(pattern, model, systematics or Systematics.typical(lenses))
    known.systematics.check()
    known.systematics.lens_factors(lenses)  # names that no camera has are refused
    batch = _nothing_yet(len(frames), names, model)
    if known.systematics.are_none:
        _fit_circles(batch, frames, known, lenses, orientation)
        return batch
    for k, frame in enumerate(frames):
        if frame:
            _calibrate_frame(batch, k, frame, known, lenses, orientation)
    return batch


def _nothing_yet(count: int, names: tuple[str, ...], model: PoseModel) -> BatchCalibration:
    shape = (count, len(names), model.size)
    return BatchCalibration(
        names,
        model.parameter_names,
        [dict.fromkeys(names, Status.NOT_DETECTED) for _ in range(count)],
        np.full(shape, np.nan),
        np.full((*shape, model.size), np.nan),
        np.zeros(shape[:2], dtype=bool),
        [{} for _ in range(count)],
    )


def _calibrate_frame(
    batch: BatchCalibration,
    k: int,
    frame: Mapping[str, Detection],
    known: Knowledge,
    lenses: Mapping[str, Intrinsics],
    orientation: Orientation,
) -> None:
    own = {name: lenses[name] for name in frame}
    search = Search(tuple(frame), frame, {}, {})
    frame_known = known._replace(systematics=known.systematics.of_cameras(own))
    status, failures, result = outcome_of_search(search, own, frame_known, orientation)
    batch.status[k].update(status if result is None else result.status)
    batch.failures[k].update(failures)
    if result is None:
        return
    for name in result.rig.names:
        v = batch.names.index(name)
        rows = [result.parameters.index(f"{name}.{key}") for key in batch.parameters]
        batch.good[k, v] = result.status[name] is Status.CONVERGED
        batch.values[k, v] = result.values[rows]
        batch.covariance[k, v] = result.covariance[np.ix_(rows, rows)]


def _fit_circles(
    batch: BatchCalibration,
    frames: Sequence[Mapping[str, Detection]],
    known: Knowledge,
    lenses: Mapping[str, Intrinsics],
    orientation: Orientation,
) -> None:
    """One fit of all pictures, which share nothing where all else is exact."""
    model = known.model
    settled = [resolve_orientation(frame, known.pattern, orientation) for frame in frames]
    frames = [detections for detections, _ in settled]
    places = [
        (k, name) for k, frame in enumerate(frames) for name in frame if name not in settled[k][1]
    ]
    fits = fit_cameras(
        [frames[k][name] for k, name in places],
        known.pattern,
        [lenses[name] for _, name in places],
        model,
    )
    for status, failures, (_, ambiguous) in zip(batch.status, batch.failures, settled, strict=True):
        status.update(dict.fromkeys(ambiguous, Status.AMBIGUOUS))
        failures.update(ambiguous)
    for (k, name), fit in zip(places, fits, strict=True):
        v = batch.names.index(name)
        sentence = failure_sentence(fit, frames[k][name], model, lenses[name])
        batch.status[k][name] = fit.status
        if sentence is not None:
            batch.failures[k][name] = sentence
            continue
        batch.good[k, v] = True
        batch.values[k, v] = fit.values[: model.size]
        batch.covariance[k, v] = fit.covariance

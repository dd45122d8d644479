"""Many rigs or frames at once: one vectorised fit, and a status for every picture."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.detection import Detection, Orientation, oriented
from trinoc.calib.from_detections import lens_of_each
from trinoc.calib.messages import failure_sentence
from trinoc.calib.pose import fit_views
from trinoc.calib.result import Status
from trinoc.calib.targets import Pattern
from trinoc.geometry import Intrinsics, PoseModel, pose_model_over_sheet
from trinoc.numerics import in_float64


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
    parameters: int | None = None,
    pose_model: PoseModel | str | None = None,
    orientation: Orientation = None,
) -> BatchCalibration:
    """`calibrate_detections` for many frames; a picture that fails spoils no other.

    A camera that is missing from a frame has the status NOT_DETECTED there, and one whose sheet
    looks the same turned AMBIGUOUS, unless `orientation` says which way round it lies. Raises
    InputError where no frame holds a camera, or a lens is missing.
    """
    names = tuple(dict.fromkeys(name for frame in frames for name in frame))
    lenses = lens_of_each(lens, dict.fromkeys(names))
    model = pose_model_over_sheet(pose_model, parameters)
    settled = [oriented(frame, pattern, orientation) for frame in frames]
    frames = [detections for detections, _ in settled]
    places = [
        (k, name) for k, frame in enumerate(frames) for name in frame if name not in settled[k][1]
    ]
    fits = fit_views(
        [frames[k][name] for k, name in places],
        pattern,
        [lenses[name] for _, name in places],
        model,
    )
    shape = (len(frames), len(names), model.size)
    batch = BatchCalibration(
        names,
        model.parameter_names,
        [dict.fromkeys(names, Status.NOT_DETECTED) for _ in frames],
        np.full(shape, np.nan),
        np.full((*shape, model.size), np.nan),
        np.zeros(shape[:2], dtype=bool),
        [dict(ambiguous) for _, ambiguous in settled],
    )
    for status, (_, ambiguous) in zip(batch.status, settled, strict=True):
        status.update(dict.fromkeys(ambiguous, Status.AMBIGUOUS))
    for (k, name), fit in zip(places, fits, strict=True):
        v = names.index(name)
        sentence = failure_sentence(fit, frames[k][name], model)
        batch.status[k][name] = fit.status
        if sentence is not None:
            batch.failures[k][name] = sentence
            continue
        batch.good[k, v] = True
        batch.values[k, v] = fit.values[: model.size]
        batch.covariance[k, v] = fit.covariance
    return batch

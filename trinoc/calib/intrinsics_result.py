"""The lens of a camera, which never travels without its status and its sigmas."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.advice.next_shot import NextImage
from trinoc.calib.detection.detection import Detection
from trinoc.calib.result.calibration import Status
from trinoc.calib.shots_result import value_words
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.splined import SPLINE_PARAMETERS
from trinoc.numerics.values import Value


class IntrinsicsResult(Value):
    """A calibrated lens with covariance, the fit of each picture, and what to do next.

    Fields
    ------
    lens : the intrinsics; None unless `status` is CONVERGED, so that nothing undetermined is
        ever read as a result.
    status : how the fit ended; SUSPECT for a lens that folds the picture before what was observed,
        or that leaves too little of it. Of a fold farther out, a note says what it costs.
    parameters : the names of the lens's q parameters, the rows of `covariance`.
    values : (q,) of `parameters`; NaN where not determined.
    covariance : (q, q); zero for parameters that were held, NaN where not determined.
    free : the parameters that were fitted; "fx_px" stands for both focal lengths where the
        aspect was held.
    gauge : the parameters that the pictures leave open.
    rank : of the column-scaled Jacobian, poses apart; len(free) where all is determined.
    reduced_chi_square : chi-square over degrees of freedom.
    field_sigma_px : (5, 5) standard deviation per axis of where the lens images a ray, from
        corner to corner of the picture, a common turn of the camera apart; NaN where it images
        none.
    cam_from_world : (k, 3, 4) pose of the board in each picture, mm; of each board in it, if there
        are several.
    detections, residuals_px, used : for each of these its circles or corners, (m, 2) predicted
        minus observed, and (m,) which took part; the others were located wrongly.
    image_index : which of the pictures given each of them is.
    failures : for each picture that was not used, by its index, a sentence that says why.
    notes : sentences on what a user should know.
    next_image : the picture that would teach most, or None.
    pattern : the board.
    systematics : the errors of the board that the covariance holds, in words.
    """

    lens: Intrinsics | None
    status: Status
    parameters: tuple[str, ...] = eqx.field(static=True)
    values: Float[np.ndarray, "q"]
    covariance: Float[np.ndarray, "q q"]
    free: tuple[str, ...] = eqx.field(static=True)
    gauge: tuple[str, ...] = eqx.field(static=True)
    rank: int = eqx.field(static=True)
    reduced_chi_square: float = eqx.field(static=True)
    field_sigma_px: Float[np.ndarray, "5 5"]
    cam_from_world: Float[np.ndarray, "k 3 4"]
    detections: Sequence[Detection]
    residuals_px: Sequence[Float[np.ndarray, "_ 2"]]
    used: Sequence[Bool[np.ndarray, "_"]]
    image_index: tuple[int, ...] = eqx.field(static=True)
    failures: dict[int, str] = eqx.field(static=True)
    notes: tuple[str, ...] = eqx.field(static=True)
    next_image: NextImage | None
    pattern: AbstractTarget
    systematics: tuple[str, ...] = eqx.field(static=True, default=())

    def sigma(self, parameter: str) -> float:
        """Standard deviation of a parameter such as "fx_px"; 0 if held, NaN if not determined."""
        row = self.parameters.index(parameter)
        return float(np.sqrt(self.covariance[row, row]))

    @property
    def rms_px(self) -> float:
        """Root mean square length of the residuals of the places that took part."""
        kept = [errors[used] for errors, used in zip(self.residuals_px, self.used, strict=True)]
        return float(np.sqrt(np.mean(np.sum(np.concatenate(kept) ** 2, axis=1))))

    def summary(self) -> str:
        """The parameters with their standard deviations, and how good the fit is, as text."""
        return summarise_lens(self)


def summarise_lens(result: IntrinsicsResult) -> str:
    """One line per parameter, and below them whatever a user should know."""
    lines = [
        f"{name:6} {_with_sigma(value, result.sigma(name), name in result.free)}"
        for name, value in zip(result.parameters, result.values, strict=True)
        if (name in result.free or value != 0.0) and name not in SPLINE_PARAMETERS
    ]
    count = sum(int(used.sum()) for used in result.used)
    places = "circles" if isinstance(result.pattern, Pattern) else "corners"
    lines.append(
        f"{count} {places} in {len(set(result.image_index))} pictures, rms {result.rms_px:.4f} px, "
        f"chi2/dof {result.reduced_chi_square:.2f}"
    )
    sigma = result.field_sigma_px
    sigma = sigma[np.isfinite(sigma)]
    if len(sigma):
        lines.append(
            f"the lens images a ray to {np.median(sigma):.2g} px (one sigma, median over the "
            f"image, a turn of the camera taken out; {sigma.max():.2g} px at the worst place)"
        )
    lines.append(f"sigmas include {', '.join(('noise', *result.systematics))}.")
    lines += [f"picture {index + 1}: {why}" for index, why in result.failures.items()]
    lines += list(result.notes)
    if result.next_image is not None:
        lines.append(result.next_image.sentence)
    return "\n".join(lines)


def _with_sigma(value: float, sigma: float, free: bool) -> str:
    if sigma == 0.0:
        return f"{value:.6g}" + ("" if free else " (held)")
    return value_words(value, sigma)

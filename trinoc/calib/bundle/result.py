"""Result of a joint refinement, with status, gauge and errors."""

import enum

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import LineObservations
from trinoc.geometry.uncertain_lines import UncertainLines
from trinoc.numerics.display import Displayable
from trinoc.numerics.values import Value


class RefineStatus(enum.Enum):
    """Status of a joint refinement. The value of each member is the sentence for the user."""

    CONVERGED = "The refinement converged and all parameters are determined."
    GAUGE_FREE = (
        "The refinement converged; segments do not determine the gauge, which is unchanged."
    )
    NOT_CONVERGED = "The refinement did not converge: the rig is unchanged."
    AMBIGUOUS = "Other rigs explain the segments about as well: the rig is unchanged."


class RefineResult(Displayable, Value):
    """Result of a joint refinement of cameras and 3-D lines.

    Attributes
    ----------
    status : how the refinement ended. If it is AMBIGUOUS, `rig` is the unrefined rig, and all other
        attributes are those of the rejected solution.
    rig : refined cameras, with `parameters` and `covariance` if all parameters are determined.
    parameters : names of the refined parameters, such as "upper.pan_deg".
    values : (p,) values of `parameters`, in degrees, mm and px.
    covariance : (p, p) covariance of `parameters`. Undetermined directions contribute no variance
        (pseudo-inverse, as with inner constraints).
    lines : 3-D segment of each track, with its covariance. The errors have two parts: from the
        noise of its images, and from the cameras, whose errors all segments share.
    inlier : (t, v) whether each fragment (part of a detected segment) agrees with its refined line.
    distance_sigma : (t, v) distance of each fragment from the image of its line, in sigmas; NaN if
        the track is not observed in the view.
    rank : number of determined directions of the camera parameters.
    gauge : description of the undetermined directions, such as the scale of the rig; empty if there
        are none.
    segment_sigma_factor : estimated noise of the segments divided by their stated sigmas.
    sheet_sigma_factor : estimated error of the given calibration divided by its stated sigmas.
    sheet_chi_square : squared Mahalanobis distance between refined and calibrated cameras, with the
        covariance of the calibration.
    chi_square : value of the robust cost at the end of the refinement, and at its start.
    log_posterior : log posterior of cameras and tracks, relative to the calibrated cameras without
        tracks. It compares different matches of the same segments.
    history : log posterior after each accepted round of matching, in order.
    tracks : observations of the refined tracks: the given matches, or those of the last round.
    """

    status: RefineStatus
    rig: Rig
    parameters: tuple[str, ...] = eqx.field(static=True)
    values: Float[np.ndarray, "p"]
    covariance: Float[np.ndarray, "p p"]
    lines: UncertainLines
    inlier: Bool[np.ndarray, "t v"]
    distance_sigma: Float[np.ndarray, "t v"]
    rank: int = eqx.field(static=True)
    gauge: str = eqx.field(static=True)
    segment_sigma_factor: float = eqx.field(static=True)
    sheet_sigma_factor: float = eqx.field(static=True)
    sheet_chi_square: float = eqx.field(static=True)
    chi_square: tuple[float, float] = eqx.field(static=True)
    log_posterior: float = eqx.field(static=True)
    history: tuple[float, ...] = eqx.field(static=True)
    tracks: LineObservations

    def sigma(self, parameter: str) -> float:
        """Standard deviation of a parameter such as "upper.pan_deg"; NaN if unknown.

        Raises `InputError` for a name that is not a parameter of the rig.
        """
        if parameter not in self.parameters:
            return self.rig.sigma(parameter)
        row = self.parameters.index(parameter)
        return float(np.sqrt(max(self.covariance[row, row], 0.0)))

    def summary(self) -> str:
        """Text with status, noise factors, and all parameters with their sigmas."""
        before, after = self.chi_square[1], self.chi_square[0]
        tracks, fragments = self.inlier.shape[0], int(np.isfinite(self.distance_sigma).sum())
        rows = [
            self.status.value + (f" Gauge: {self.gauge}." if self.gauge else ""),
            f"{tracks} lines, {int(self.inlier.sum())} of {fragments} fragments agree; "
            f"robust chi-square {before:.1f} -> {after:.1f}.",
            f"Noise over stated sigma: segments {self.segment_sigma_factor:.2f}, "
            f"sheet {self.sheet_sigma_factor:.2f}.",
        ]
        sigmas = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        rows += [
            f"  {name:<24} {value:12.5f} +- {sigma:.5f}"
            for name, value, sigma in zip(self.parameters, self.values, sigmas, strict=True)
        ]
        return "\n".join(rows)

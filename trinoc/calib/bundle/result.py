"""The answer of a joint refinement, with its status, its gauge and its errors."""

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
    """How a joint refinement ended; the value is the sentence shown to people."""

    CONVERGED = "The refinement converged and all parameters are determined."
    GAUGE_FREE = "The refinement converged; segments alone leave the named gauge as it was."
    NOT_CONVERGED = "The refinement did not converge: the rig is returned as it was."
    AMBIGUOUS = "Other rigs explain the segments about as well: the rig is returned as it was."


class RefineResult(Displayable, Value):
    """Cameras and lines refined together.

    Fields
    ------
    status : how it ended; the start is never shown as a result without saying so. Where it is
        AMBIGUOUS, all fields but `rig` are those of the answer that was refused.
    rig : the refined cameras, with `parameters` and `covariance` where these are determined.
    parameters : names such as "upper.pan_deg", the rows of `covariance`.
    values : (p,) of `parameters`, in degrees, mm and px.
    covariance : (p, p); where a gauge is free, that of the inner constraints.
    lines : 3-D segments with own and shared errors, one per track.
    inlier : (t, v) fragments that agree with the refined rig and line.
    distance_sigma : (t, v) distance of each fragment from its line in its own sigmas; NaN
        where not seen.
    rank : number of directions of the cameras that are determined.
    gauge : what stays as it was, in words; empty where nothing does.
    segment_sigma_factor : the segments' noise over what they claimed.
    sheet_sigma_factor : the same for the sheet.
    sheet_chi_square : squared distance, in the sheet's sigmas, by which segments pulled the
        cameras from where the sheet had placed them.
    chi_square : robust cost at the end, and at the start.
    log_posterior : of cameras and tracks, against cameras where the sheet placed them and no
        track (`bundle.estimate`); comparable for matches of the same segments.
    history : log posterior after each round of matching that was accepted, in order.
    tracks : what was refined: the matches given, or those found with the refined rig.
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
        """Standard deviation of a parameter such as "upper.pan_deg"; NaN if not known.

        Raises InputError for a name that is no parameter of the rig.
        """
        if parameter not in self.parameters:
            return self.rig.sigma(parameter)
        row = self.parameters.index(parameter)
        return float(np.sqrt(max(self.covariance[row, row], 0.0)))

    def summary(self) -> str:
        """What was refined, by how much it is known now, and what to make of it, as text."""
        before, after = self.chi_square[1], self.chi_square[0]
        tracks, fragments = self.inlier.shape[0], int(np.isfinite(self.distance_sigma).sum())
        rows = [
            self.status.value + (f" Gauge: {self.gauge}." if self.gauge else ""),
            f"{tracks} lines, {int(self.inlier.sum())} of {fragments} fragments agree; "
            f"robust chi-square {before:.1f} -> {after:.1f}.",
            f"Noise over claimed sigma: segments {self.segment_sigma_factor:.2f}, "
            f"sheet {self.sheet_sigma_factor:.2f}.",
        ]
        sigmas = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        rows += [
            f"  {name:<24} {value:12.5f} +- {sigma:.5f}"
            for name, value, sigma in zip(self.parameters, self.values, sigmas, strict=True)
        ]
        return "\n".join(rows)

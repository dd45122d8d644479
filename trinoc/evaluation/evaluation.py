"""Evaluation of 3-D lines against known edges.

Reports distances, precision, completeness and normalised errors.
"""

import enum
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from trinoc.errors import InputError
from trinoc.evaluation.alignment import RigidMotion, align
from trinoc.evaluation.distances import measure_near_lengths
from trinoc.evaluation.known_shape import KnownShape
from trinoc.evaluation.lines_of_rig import independent_lines
from trinoc.evaluation.lines_on_edges import angles_deg, edge_of_lines, offsets_across, select_lines
from trinoc.evaluation.normalised_errors import NormalisedErrors, normalised_errors
from trinoc.geometry.uncertain_lines import UncertainLines
from trinoc.numerics.display import Displayable
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.values import Value
from trinoc.synth.truth import SceneTruth

TOLERANCES_MM = (0.1, 0.25, 0.5, 1.0)
SAMPLE_STEP_MM = 0.25
# Largest number of samples: larger shapes get a larger step.
MOST_SAMPLES = 50_000
# Fewest lines that determine a rigid motion.
LEAST_LINES_TO_ALIGN = 3


class EvaluationStatus(enum.Enum):
    """Result of an evaluation: lines were compared with edges, or the reason why not.

    Each value is a sentence for the user; a reason also has a remedy.
    """

    COMPARED = "Lines were compared with the known edges."
    NO_LINES = "There is no line to compare. Match segments first, or accept a lower posterior."
    NO_EDGES = "The known shape has no edge. Give a file with edges."
    NOTHING_NEAR = (
        "No line lies on a known edge. Check that both are in millimetres and in the same frame."
    )


class ErrorQuantiles(NamedTuple):
    """Quantiles of errors, in the unit of the errors: median, 90 % and 95 %."""

    median: float
    at_90: float
    at_95: float


@runtime_checkable
class LinesInSpace(Protocol):
    """Interface of a value with 3-D segments and their covariance, such as `Matches`."""

    @property
    def lines_mm(self) -> Float[np.ndarray, "t 2 3"]:
        """Ends of each segment in the world frame, (t, 2, 3)."""
        ...

    @property
    def covariance_mm2(self) -> Float[np.ndarray, "t 6 6"]:
        """Covariance of the two ends of each segment, (t, 6, 6)."""
        ...


class Evaluation(Displayable, Value):
    """Result of a comparison of estimated 3-D lines with known edges.

    Attributes
    ----------
    status : EvaluationStatus
        COMPARED, or the reason why nothing was compared. Numbers are then 0 or NaN.
    wanted : str
        Description of the wanted parts: the parts of edges that should be detected.
    lines : (t,)
        Index of the edge that each line lies on; -1 for none.
    length_put_out_mm : float
        Total length of the estimated lines.
    length_wanted_mm : float
        Total length of the wanted parts.
    tolerances_mm : tuple of float
        Distances at which `precision` and `completeness` are computed.
    precision : tuple of float
        For each tolerance: the share of the lines' length at most this far from an edge.
    completeness : tuple of float
        For each tolerance: the share of the wanted length at most this far from a line.
    distance_mm : ErrorQuantiles
        Distance of points on the lines from the nearest edge.
    angle_deg : ErrorQuantiles
        Angle between each line and its edge.
    normalised : NormalisedErrors
        Errors perpendicular to the lines, divided by their sigma, for lines that lie on an edge.
    motion : RigidMotion or None
        Motion that was applied to the lines before the comparison, if requested.
    """

    status: EvaluationStatus = eqx.field(static=True)
    wanted: str = eqx.field(static=True)
    lines: Int[np.ndarray, "t"]
    length_put_out_mm: float
    length_wanted_mm: float
    tolerances_mm: tuple[float, ...] = eqx.field(static=True)
    precision: tuple[float, ...]
    completeness: tuple[float, ...]
    distance_mm: ErrorQuantiles
    angle_deg: ErrorQuantiles
    normalised: NormalisedErrors
    motion: RigidMotion | None

    def record(self) -> dict[str, Any]:
        """All numbers of the evaluation, keyed by name, as one row of a table; NaN if undefined."""
        shares = {
            f"{name}_{tolerance:g}mm": share
            for name in ("precision", "completeness")
            for tolerance, share in zip(self.tolerances_mm, getattr(self, name), strict=True)
        }
        return {
            "lines": len(self.lines),
            "lines_on_edges": int((self.lines >= 0).sum()),
            "length_put_out_mm": self.length_put_out_mm,
            "length_wanted_mm": self.length_wanted_mm,
            **_name_quantiles("distance", "mm", self.distance_mm),
            **shares,
            **_name_quantiles("angle", "deg", self.angle_deg),
            "normalised_variance": self.normalised.variance,
            "normalised_spread": self.normalised.spread,
            "share_within_1.96_sigma": self.normalised.share_within,
            "share_of_lines_within_95": self.normalised.share_of_lines,
        }


def evaluate(
    lines: LinesInSpace | UncertainLines | Float[ArrayLike, "t 2 3"],
    shape: KnownShape | SceneTruth | Float[ArrayLike, "m 2 3"],
    *,
    tolerances_mm: Sequence[float] = TOLERANCES_MM,
    aligned: bool = False,
) -> Evaluation:
    """Compare estimated 3-D lines with known edges.

    Parameters
    ----------
    lines : Matches, Wireframe, UncertainLines or (t, 2, 3)
        Lines with covariance, or only their ends, mm. To include the errors of the cameras, give
        `lines` of a refinement.
    shape : KnownShape, SceneTruth or (m, 2, 3)
        Known edges in the same frame, for example from `trinoc.io.load_shape`, or their ends, mm.
        Of a synthetic scene, the parts visible in two images should be detected.
    tolerances_mm : sequence of float
        Distances for precision and completeness. A line lies on an edge if it is within the
        largest.
    aligned : bool
        True: first align the lines with the edges by a rigid motion. This removes six parameters
        from the errors; `Evaluation.motion` contains the motion.

    Returns
    -------
    Evaluation
        Lengths are sampled every 0.25 mm, or at 50,000 points if these are fewer.

    Raises
    ------
    InputError
        If a tolerance is not positive or a coordinate is not finite.
    """
    lines_with_errors, known_shape = _as_lines(lines), _as_shape(shape)
    tolerances = tuple(sorted(float(tolerance) for tolerance in tolerances_mm))
    if not tolerances or not tolerances[0] > 0:
        raise InputError("The tolerances must be one or more positive distances in millimetres.")
    motion = None
    if aligned and len(lines_with_errors) >= LEAST_LINES_TO_ALIGN and len(known_shape.edges_mm):
        motion = align(lines_with_errors.ends_mm, known_shape.edges_mm)
        lines_with_errors = motion.move_lines(lines_with_errors)
    ends, edges, largest_tolerance = lines_with_errors.ends_mm, known_shape.edges_mm, tolerances[-1]
    line_lengths = measure_near_lengths(ends, edges, _step_mm(ends))
    wanted_lengths = measure_near_lengths(
        known_shape.wanted_mm, ends, _step_mm(known_shape.wanted_mm)
    )
    edge_of = edge_of_lines(ends, edges, largest_tolerance)
    matched = np.flatnonzero(edge_of >= 0)
    offsets = offsets_across(select_lines(lines_with_errors, matched), edges[edge_of[matched]])
    angles = angles_deg(ends[matched], edges[edge_of[matched]])
    return Evaluation(
        _status(lines_with_errors, known_shape, line_lengths.share_within(largest_tolerance)),
        known_shape.wanted,
        edge_of,
        float(line_lengths.length_mm.sum()),
        float(wanted_lengths.length_mm.sum()),
        tolerances,
        tuple(line_lengths.share_within(tolerance) for tolerance in tolerances),
        tuple(wanted_lengths.share_within(tolerance) for tolerance in tolerances),
        _quantiles(*line_lengths),
        _quantiles(angles, np.ones(len(angles))),
        normalised_errors(offsets, lines_with_errors.parameter_covariance),
        motion,
    )


def _as_lines(lines: LinesInSpace | UncertainLines | ArrayLike) -> UncertainLines:
    if not isinstance(lines, UncertainLines):
        if isinstance(lines, LinesInSpace):
            ends, covariance = np.asarray(lines.lines_mm), np.asarray(lines.covariance_mm2)
        else:
            ends = _as_ends(lines, "lines", "Matches, such as match_segments finds")
            covariance = np.zeros((len(ends), 6, 6))
        if covariance.shape != (len(ends), 6, 6):
            raise InputError(
                f"The covariance has shape {covariance.shape}, but {len(ends)} lines need "
                "(t, 6, 6). Give `independent_lines(lines_mm, covariance_mm2)`."
            )
        lines = independent_lines(ends, covariance)
    if not np.isfinite(lines.ends_mm).all():
        raise InputError("The lines have ends that are not finite. Remove such lines.")
    # A line of length 0 has no direction.
    length = np.linalg.norm(lines.ends_mm[:, 1] - lines.ends_mm[:, 0], axis=1)
    return select_lines(lines, np.flatnonzero(length > 0))


def _as_ends(value: object, name: str, expected: str) -> Float[np.ndarray, "n 2 3"]:
    try:
        return np.asarray(value, dtype=np.float64).reshape(-1, 2, 3)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"The {name} contain no ends of 3-D lines. Give {expected}, or (n, 2, 3) numbers in mm."
        ) from error


def _as_shape(shape: KnownShape | SceneTruth | ArrayLike) -> KnownShape:
    if isinstance(shape, SceneTruth):
        return KnownShape.of_scene(shape)
    if isinstance(shape, KnownShape):
        return shape
    edges = _as_ends(shape, "known edges", "the result of load_shape")
    if not np.isfinite(edges).all():
        raise InputError("The known edges have ends that are not finite. Remove such edges.")
    return KnownShape.of_edges(edges)


def _status(lines: UncertainLines, shape: KnownShape, share_near: float) -> EvaluationStatus:
    if len(shape.edges_mm) == 0:
        return EvaluationStatus.NO_EDGES
    if len(lines) == 0:
        return EvaluationStatus.NO_LINES
    return EvaluationStatus.COMPARED if share_near > 0 else EvaluationStatus.NOTHING_NEAR


def _step_mm(segments_mm: Float[np.ndarray, "n 2 3"]) -> float:
    total = float(np.linalg.norm(segments_mm[:, 1] - segments_mm[:, 0], axis=1).sum())
    return max(SAMPLE_STEP_MM, total / MOST_SAMPLES)


def _quantiles(errors: Float[np.ndarray, "k"], weight: Float[np.ndarray, "k"]) -> ErrorQuantiles:
    """Weighted quantiles of errors; NaN if there are no errors."""
    if weight.sum() == 0 or not np.isfinite(errors).all():
        return ErrorQuantiles(*[float("nan")] * 3)
    quantiles = np.quantile(errors, [0.5, 0.9, 0.95], weights=weight, method="inverted_cdf")
    return ErrorQuantiles(*quantiles.tolist())


def _name_quantiles(name: str, unit: str, quantiles: ErrorQuantiles) -> dict[str, float]:
    return {
        f"{name}_{level}_{unit}": q for level, q in zip(("median", 90, 95), quantiles, strict=True)
    }

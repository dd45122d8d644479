"""How accurate is a shape that segments give? Lines in space against known edges."""

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
from trinoc.evaluation.lines_of_rig import certain_lines
from trinoc.evaluation.lines_on_edges import angles_deg, edge_of_lines, offsets_across, select_lines
from trinoc.evaluation.normalised_errors import NormalisedErrors, normalised_errors
from trinoc.geometry.uncertain_lines import UncertainLines
from trinoc.numerics.display import Displayable
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.values import Value
from trinoc.synth.truth import SceneTruth

TOLERANCES_MM = (0.1, 0.25, 0.5, 1.0)
SAMPLE_STEP_MM = 0.25
# Longer shapes are sampled at this many places, so that a house takes no longer than a block.
MOST_SAMPLES = 50_000
# Fewer lines than this do not hold a rigid motion down.
LEAST_LINES_TO_ALIGN = 3


class EvaluationStatus(enum.Enum):
    """Whether there was something to compare, in a sentence."""

    COMPARED = "Lines were compared with the known edges."
    NO_LINES = "There is no line to compare: match segments first, or ask for a lower posterior."
    NO_EDGES = "The known shape has no edge: give a file that has some."
    NOTHING_NEAR = (
        "No line lies on a known edge: check that both are in millimetres and in the same frame."
    )


class ErrorQuantiles(NamedTuple):
    """Half, 90 % and 95 % of all errors are at most this."""

    median: float
    at_90: float
    at_95: float


@runtime_checkable
class LinesInSpace(Protocol):
    """Anything that holds 3-D segments with covariance, as the matcher's answer does."""

    @property
    def lines_mm(self) -> Float[np.ndarray, "t 2 3"]:
        """Their ends."""
        ...

    @property
    def covariance_mm2(self) -> Float[np.ndarray, "t 6 6"]:
        """Of the ends of each."""
        ...


class Evaluation(Displayable, Value):
    """Lines in space beside known edges.

    Fields
    ------
    status : whether there was something to compare. Where not, numbers are 0 or NaN.
    wanted : in words, what completeness asks for.
    lines : (t,) the edge on which each line lies, -1 where on none.
    length_put_out_mm : of all lines together.
    length_wanted_mm : of all that ought to be found.
    tolerances_mm : distances at which the next two are given.
    precision : share of the length put out that lies within each distance of an edge.
    completeness : share of the wanted length within each distance of a line.
    distance_mm : of the length put out from the nearest edge.
    angle_deg : of the lines that lie on an edge, with it.
    normalised : errors across of the lines that lie on an edge, in units of what they claim.
    motion : what laid the lines on the shape, where that was asked for; figures are those after.
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
        """All numbers by name, as a row of a table; NaN where there is none."""
        shares = {
            f"{name}_{at:g}mm": share
            for name in ("precision", "completeness")
            for at, share in zip(self.tolerances_mm, getattr(self, name), strict=True)
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
    """Distances, precision, completeness and normalised errors of lines against known edges.

    Parameters
    ----------
    lines : Matches, a Wireframe, or a refinement's `lines` (then with the errors that the cameras
        share), or bare ends, of which nothing is claimed.
    shape : known edges in the same frame, of `trinoc.io.load_shape` or as ends in mm; of a made
        scene those parts are wanted that two pictures show.
    tolerances_mm : distances at which precision and completeness are given; within the largest, a
        line lies on an edge.
    aligned : lay the lines on the shape by a rigid motion first. It takes up six numbers of the
        error, and `motion` says which.

    Lengths are sampled every quarter of a millimetre, or at 50,000 places where those are fewer.
    Raises InputError for tolerances that are not positive and for coordinates that are not finite.
    """
    claimed, known = _as_lines(lines), _as_shape(shape)
    tolerances = tuple(sorted(float(tolerance) for tolerance in tolerances_mm))
    if not tolerances or not tolerances[0] > 0:
        raise InputError("The tolerances must be one or more positive distances in millimetres.")
    motion = None
    if aligned and len(claimed) >= LEAST_LINES_TO_ALIGN and len(known.edges_mm):
        motion = align(claimed.ends_mm, known.edges_mm)
        claimed = motion.of_lines(claimed)
    ends, edges, reach = claimed.ends_mm, known.edges_mm, tolerances[-1]
    put_out = measure_near_lengths(ends, edges, _step_mm(ends))
    wanted = measure_near_lengths(known.wanted_mm, ends, _step_mm(known.wanted_mm))
    edge_of = edge_of_lines(ends, edges, reach)
    on = np.flatnonzero(edge_of >= 0)
    offsets = offsets_across(select_lines(claimed, on), edges[edge_of[on]])
    angles = angles_deg(ends[on], edges[edge_of[on]])
    return Evaluation(
        _status(claimed, known, put_out.share_within(reach)),
        known.wanted,
        edge_of,
        float(put_out.length_mm.sum()),
        float(wanted.length_mm.sum()),
        tolerances,
        tuple(put_out.share_within(at) for at in tolerances),
        tuple(wanted.share_within(at) for at in tolerances),
        _quantiles(*put_out),
        _quantiles(angles, np.ones(len(angles))),
        normalised_errors(offsets, claimed.parameter_covariance),
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
                f"The covariance has shape {covariance.shape}, but that of the ends of {len(ends)} "
                "lines is needed, (t, 6, 6): give `certain_lines(lines_mm, covariance_mm2)`."
            )
        lines = certain_lines(ends, covariance)
    if not np.isfinite(lines.ends_mm).all():
        raise InputError("The lines have ends that are not finite: leave such lines out.")
    # A line without length has no direction, and nothing lies on it.
    length = np.linalg.norm(lines.ends_mm[:, 1] - lines.ends_mm[:, 0], axis=1)
    return select_lines(lines, np.flatnonzero(length > 0))


def _as_ends(given: object, name: str, wanted: str) -> Float[np.ndarray, "n 2 3"]:
    try:
        return np.asarray(given, dtype=np.float64).reshape(-1, 2, 3)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"The {name} hold no ends of lines in space: give {wanted}, or (n, 2, 3) numbers in mm."
        ) from error


def _as_shape(shape: KnownShape | SceneTruth | ArrayLike) -> KnownShape:
    if isinstance(shape, SceneTruth):
        return KnownShape.of_scene(shape)
    if isinstance(shape, KnownShape):
        return shape
    edges = _as_ends(shape, "known edges", "what load_shape reads from a file")
    if not np.isfinite(edges).all():
        raise InputError("The known edges have ends that are not finite: leave such edges out.")
    return KnownShape.of_edges(edges)


def _status(lines: UncertainLines, shape: KnownShape, near: float) -> EvaluationStatus:
    if len(shape.edges_mm) == 0:
        return EvaluationStatus.NO_EDGES
    if len(lines) == 0:
        return EvaluationStatus.NO_LINES
    return EvaluationStatus.COMPARED if near > 0 else EvaluationStatus.NOTHING_NEAR


def _step_mm(segments_mm: Float[np.ndarray, "n 2 3"]) -> float:
    total = float(np.linalg.norm(segments_mm[:, 1] - segments_mm[:, 0], axis=1).sum())
    return max(SAMPLE_STEP_MM, total / MOST_SAMPLES)


def _quantiles(errors: Float[np.ndarray, "k"], weight: Float[np.ndarray, "k"]) -> ErrorQuantiles:
    """Of errors that stand for lengths, or count one each; NaN where there is none."""
    if weight.sum() == 0 or not np.isfinite(errors).all():
        return ErrorQuantiles(*[float("nan")] * 3)
    at = np.quantile(errors, [0.5, 0.9, 0.95], weights=weight, method="inverted_cdf")
    return ErrorQuantiles(*at.tolist())


def _name_quantiles(name: str, unit: str, quantiles: ErrorQuantiles) -> dict[str, float]:
    return {f"{name}_{at}_{unit}": q for at, q in zip(("median", 90, 95), quantiles, strict=True)}

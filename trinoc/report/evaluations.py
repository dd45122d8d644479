"""An evaluation as text for a terminal."""

from trinoc.evaluation.evaluation import Evaluation
from trinoc.report.numbers import with_decimals
from trinoc.report.report_table import text_table


def evaluation_text(evaluation: Evaluation) -> str:
    """Evaluation as text: shares within each distance, distances, angles and normalised errors."""
    head = ["within (mm)", *(f"{tolerance:g}" for tolerance in evaluation.tolerances_mm)]
    table = [
        [name, *(_number(share, 3) for share in shares)]
        for name, shares in (
            ("precision", evaluation.precision),
            ("completeness", evaluation.completeness),
        )
    ]
    distance, normalised = evaluation.distance_mm, evaluation.normalised
    figures = [
        f"lines: {len(evaluation.lines)}, {int((evaluation.lines >= 0).sum())} of them on edges",
        f"wanted: {evaluation.wanted}, {evaluation.length_wanted_mm:.0f} mm",
        f"distance from the nearest edge: median {_number(distance.median, 3)} mm, 90 % "
        f"{_number(distance.at_90, 3)} mm, 95 % {_number(distance.at_95, 3)} mm",
        f"angle with the edge: median {_number(evaluation.angle_deg.median, 3)} deg",
        f"errors across within 1.96 sigma: {_number(normalised.share_within, 3)} (true sigmas: "
        f"0.95); the sigma of the median line is too small by {_number(normalised.spread, 2)} "
        "(true: 1)",
    ]
    parts = [text_table(head, table, left_columns=0), "\n".join(figures)]
    motion = evaluation.motion
    if motion is not None:
        shift = " ".join(f"{component:.3f}" for component in motion.shift_mm)
        parts.append(
            f"after laying the segments on the shape: turned by {motion.turn_deg:.4f} deg, "
            f"shifted by ({shift}) mm"
        )
        if motion.rank < 6:
            parts.append(
                "the edges do not determine a part of this motion, and this part was not applied"
            )
    return "\n\n".join(parts)


def _number(value: float, decimals: int) -> str:
    text = with_decimals(value, decimals)
    return "-" if text == "not known" else text

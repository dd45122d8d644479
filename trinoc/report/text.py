"""Results as tables for a terminal."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from trinoc.match.tracks.matches import Matches
from trinoc.report.matches_part import counts_table, reasons_table
from trinoc.report.numbers import significant_decimals, with_decimals, with_sigma, with_sign
from trinoc.report.report_table import draw_text, text_table

if TYPE_CHECKING:
    from trinoc.report.parameter_table import ParameterError


def errors_text(errors: "Sequence[ParameterError]", reference_name: str) -> str:
    """Table as text: estimated parameters, their sigmas, and their errors against known values."""
    # Here, because it brings the calibrations with it, and a match wants none.
    from trinoc.report.parameter_table import LABELS

    rows = []
    for number, error in enumerate(errors):
        first = number == 0 or errors[number - 1].camera != error.camera
        rows.append(
            (
                error.camera if first else "",
                LABELS[error.parameter],
                with_sigma(error.value, error.sigma),
                with_decimals(error.known, 3),
                with_sign(error.error, significant_decimals(error.sigma)),
                with_sign(error.over_sigma, 1),
            )
        )
    head = ("camera", "parameter", "found", reference_name, "error", "error/sigma")
    return text_table(head, rows, left_columns=2)


def counts_text(matches: Matches) -> str:
    """Numbers of candidates and tracks that each step of the matching kept, and the notes."""
    return "\n".join([draw_text(counts_table(matches)), *matches.notes])


def reasons_text(matches: Matches) -> str:
    """Table as text: number of segments for each reason, for each view and in total."""
    return draw_text(reasons_table(matches))

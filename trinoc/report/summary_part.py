"""The few figures that stand at the top of the page."""

from typing import NamedTuple

import numpy as np

from trinoc.calib import CalibrationResult, Status
from trinoc.match import BINOCULAR, TRINOCULAR, Matches
from trinoc.report.matches_part import share_matched
from trinoc.report.numbers import with_decimals
from trinoc.report.track_sigmas import track_sigmas


class Headline(NamedTuple):
    """One figure and what it counts or measures."""

    figure: str
    words: str


def summary_part(result: CalibrationResult | None, matches: Matches | None) -> list[Headline]:
    """Headlines of the calibration and of the matches, as far as there are any."""
    headlines = []
    if result is not None:
        converged = sum(status is Status.CONVERGED for status in result.status.values())
        residuals = np.concatenate([fit.residuals_px[fit.used] for fit in result.fits.values()])
        rms = float(np.sqrt(np.mean(np.sum(residuals**2, axis=1)))) if len(residuals) else np.nan
        headlines += [
            Headline(f"{converged} of {len(result.status)}", "cameras calibrated"),
            Headline(f"{with_decimals(rms, 4)} px", "rms residual of the circles' centres"),
        ]
    if matches is not None:
        stage = np.asarray(matches.stage)
        headlines += [
            Headline(str(int((stage == TRINOCULAR).sum())), "tracks seen in three or more views"),
            Headline(str(int((stage == BINOCULAR).sum())), "tracks seen in two views"),
            Headline(share_matched(matches), "of all segments are on a track"),
        ]
        if len(matches):
            across = float(np.nanmedian(track_sigmas(matches).across_sigma_mm))
            headlines.append(
                Headline(f"{with_decimals(across, 3)} mm", "median sigma across a 3-D segment")
            )
    return headlines

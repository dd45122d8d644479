"""Why a segment is on no track: every segment has an answer."""

from collections import Counter

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from trinoc.match.tuning import DEFAULT, TrackTuning

MATCHED = "matched"
NO_PARTNER = "no partner in the zone"
OUTSIDE = "outside depth"
ALONG = "along the epipolar lines"
WEAK = "evidence too weak"
MISSED = "missing in a third view"
LOST = "lost to a neighbour"
AMBIGUOUS = "ambiguous with {}"


def reasons(
    segment: Int[np.ndarray, "m"],
    log_odds: Float[np.ndarray, "m"],
    outside: Bool[np.ndarray, "n"],
    along: Bool[np.ndarray, "n"],
    matched: Bool[np.ndarray, "n"],
    missed: Bool[np.ndarray, "n"],
    tuning: TrackTuning = DEFAULT.tracks,
) -> Shaped[np.ndarray, "n"]:
    """(n,) words for the segments of one view, given the candidates that held each of them.

    `segment` is the segment of this view in each candidate (-1 for none), `log_odds` the
    candidate's evidence before rivals, `outside` whether the depth range excluded one,
    `along` whether the best lies along the epipolar lines of all pairs of its views, and
    `missed` whether one fits in two views, and a third should show it but does not: the rims of
    round bodies, and shadows and lights that move with the viewpoint, among others.
    """
    count = len(matched)
    held = segment >= 0
    segment, log_odds = segment[held], log_odds[held]
    best = np.full(count, -np.inf)
    np.maximum.at(best, segment, log_odds)
    serious = (log_odds > best[segment] - tuning.rival_log_odds) & (log_odds > 0)
    rivals = np.bincount(segment[serious], minlength=count)
    words = np.full(count, NO_PARTNER, dtype="U40")
    words[outside] = OUTSIDE
    words[np.isfinite(best)] = WEAK
    words[missed & np.isfinite(best)] = MISSED
    words[best > 0] = LOST
    for n in np.flatnonzero((best > 0) & (rivals > 1)):
        words[n] = AMBIGUOUS.format(rivals[n])
    words[along] = ALONG
    words[matched] = MATCHED
    return words


def counted(words: dict[str, Shaped[np.ndarray, "_"]]) -> dict[str, int]:
    """How many segments of all views share each reason; ambiguous ones are one kind."""
    number: Counter[str] = Counter()
    # Few words are different: those are taken apart, not every segment's.
    for word, count in Counter(word for view in words.values() for word in view.tolist()).items():
        number[word.split(" with ")[0]] += count
    return {f"segments {kind}": number[kind] for kind in sorted(number)}

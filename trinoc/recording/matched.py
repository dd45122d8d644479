"""The segments of the frames of a part to their matches."""

from collections.abc import Mapping, Sequence

from trinoc.geometry import Rig, Segments
from trinoc.match import MatchBatch, match_many
from trinoc.recording.frame import OK, FrameMatches


def matched_frames(
    found: Mapping[str, Mapping[str, Segments] | str],
    rig: Rig,
    *,
    depth_range_mm: tuple[float, float] | None = None,
) -> list[FrameMatches]:
    """What becomes of each frame, given its segments, or the sentence why it has none.

    The frames go to the matcher together. Where that fails as a whole they go one by one, and the
    one that fails, be it by a defect of this package or for want of memory, has a sentence that
    says so.
    """
    usable = {name: views for name, views in found.items() if not isinstance(views, str)}
    frames = list(usable.values())
    try:
        batch = match_many(frames, rig, depth_range_mm=depth_range_mm)
    except Exception:
        outcomes = [_alone(views, rig, depth_range_mm) for views in frames]
    else:
        outcomes = _outcomes(batch)
    of_name = {n: FrameMatches(n, why, None) for n, why in found.items() if isinstance(why, str)}
    of_name |= {n: outcome._replace(name=n) for n, outcome in zip(usable, outcomes, strict=True)}
    return [of_name[name] for name in found]


def _outcomes(batch: MatchBatch) -> Sequence[FrameMatches]:
    return [
        FrameMatches("", OK if matches is not None else str(status), matches)
        for matches, status in zip(batch.matches, batch.status, strict=True)
    ]


def _alone(
    views: Mapping[str, Segments], rig: Rig, depth_range_mm: tuple[float, float] | None
) -> FrameMatches:
    try:
        (outcome,) = _outcomes(match_many([views], rig, depth_range_mm=depth_range_mm))
    except Exception as error:
        return FrameMatches("", unexpected(error), None)
    return outcome


def unexpected(error: Exception) -> str:
    """The sentence for a failure that nobody foresaw."""
    if isinstance(error, MemoryError):
        return "The memory does not suffice for this frame: give smaller pictures or fewer threads."
    said = " ".join(str(error).split())[:200]
    return f"The matcher failed ({type(error).__name__}: {said}): please report this frame."

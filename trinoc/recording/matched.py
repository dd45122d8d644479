"""The segments of the frames of a part to their matches."""

from collections.abc import Mapping, Sequence

from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.batch import match_many
from trinoc.recording.frame import OK, FrameMatches


def match_part_frames(
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

    def match_all(names: Sequence[str]) -> list[FrameMatches]:
        try:
            batch = match_many([usable[n] for n in names], rig, depth_range_mm=depth_range_mm)
        except Exception as error:
            if len(names) == 1:
                return [FrameMatches(names[0], matcher_failure(error), None)]
            return [result for name in names for result in match_all([name])]
        outcomes = zip(names, batch.matches, batch.status, strict=True)
        return [FrameMatches(n, OK if m is not None else str(why), m) for n, m, why in outcomes]

    of_name = {n: FrameMatches(n, why, None) for n, why in found.items() if isinstance(why, str)}
    of_name |= {result.name: result for result in match_all(list(usable))}
    return [of_name[name] for name in found]


def matcher_failure(error: Exception) -> str:
    """The sentence for a failure that nobody foresaw."""
    if isinstance(error, MemoryError):
        return "The memory does not suffice for this frame: give smaller pictures or fewer threads."
    said = " ".join(str(error).split())[:200]
    return f"The matcher failed ({type(error).__name__}: {said}): please report this frame."

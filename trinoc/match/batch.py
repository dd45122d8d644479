"""Many rigs, or many frames of one, matched in one call that no single failure ends."""

from collections.abc import Iterable, Mapping, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Shaped

from trinoc.errors import TrinocError
from trinoc.geometry import Rig, Segments
from trinoc.match.matcher import match_segments
from trinoc.match.tracks import Matches
from trinoc.match.tuning import DEFAULT, MatchTuning
from trinoc.numerics import ArrayLike

OK = "ok"


class MatchBatch(eqx.Module):
    """Matches of each item, None where there are none; `status` (n,) is "ok" or says why."""

    matches: tuple[Matches | None, ...]
    status: Shaped[np.ndarray, "n"]

    def __len__(self) -> int:
        return len(self.matches)


def match_many(
    segments: Sequence[Mapping[str, Segments | ArrayLike]],
    rigs: Rig | Iterable[Rig],
    *,
    sigma_px: float | None = None,
    depth_range_mm: tuple[float, float] | None = None,
    tuning: MatchTuning = DEFAULT,
) -> MatchBatch:
    """`match_segments` for each item: segments of one frame, with a rig each or one for all.

    An item that cannot be matched has its sentence for a status, and the others their
    matches. Items run one after the other on the same compiled kernels, which their bucket of
    sizes shares: candidates are sparse, and a single kernel over the batch would pad all items
    to the worst of them.

    Raises ValueError where there are not as many rigs as items.
    """
    each = [rigs] * len(segments) if isinstance(rigs, Rig) else list(rigs)
    found: list[Matches | None] = []
    status: list[str] = []
    for item, rig in zip(segments, each, strict=True):
        try:
            matches = match_segments(
                item, rig, sigma_px=sigma_px, depth_range_mm=depth_range_mm, tuning=tuning
            )
        except TrinocError as error:
            found.append(None)
            status.append(str(error))
        else:
            found.append(matches)
            status.append(OK)
    return MatchBatch(tuple(found), np.array(status, dtype=np.str_))

"""From what was selected to tracks: fragments, lines in space with covariance, and reasons."""

import jax
import numpy as np
from jaxtyping import Float, Int

from trinoc.geometry.segments import covariance_of_ends
from trinoc.geometry.triangulation import triangulate_segment
from trinoc.match.evidence import probability
from trinoc.match.matches import BINOCULAR, TRINOCULAR, Matches
from trinoc.match.observed import Observed, distorted
from trinoc.match.occluded import Pairs
from trinoc.match.padding import bucket, padded
from trinoc.match.reasons import counted, reasons
from trinoc.match.selection import Selection

_triangulated = jax.jit(jax.vmap(triangulate_segment, in_axes=(None, 0, 0, 0)))


def assemble(
    seen: Observed, chosen: Selection, pairs: Pairs, names: tuple[str, ...]
) -> Matches:
    """Matches in the caller's order of views and numbers of segments."""
    index = np.concatenate([found.candidates.index[found.taken] for found in (chosen, pairs)])
    part = np.concatenate([found.candidates.part[found.taken] for found in (chosen, pairs)])
    belief = np.concatenate([found.belief[found.taken] for found in (chosen, pairs)])
    fragments, covariance = fragments_of(seen, index, part)
    ends_mm, covariance_mm2 = lines_in_space(seen, index, fragments, covariance)
    views = len(names)
    given = np.full(index.shape, -1)
    for view in range(views):
        on = index[:, view] >= 0
        given[on, view] = seen.order[view][index[on, view]]
        fragments[on, view] = distorted(seen.intrinsics[view], fragments[on, view])
    turn = [seen.names.index(name) for name in names]
    given, fragments = given[:, turn], fragments[:, turn]
    sort = np.lexsort(given.T[::-1])
    why = _reasons(seen, chosen, pairs, index)
    counts = {
        "triples considered": len(chosen.candidates.index),
        "triples matched": int(chosen.taken.sum()),
        "pairs considered": len(pairs.candidates.index),
        "pairs matched": int(pairs.taken.sum()),
    }
    return Matches(
        names,
        given[sort],
        fragments[sort],
        ends_mm[sort],
        covariance_mm2[sort],
        np.where((given >= 0).sum(axis=1) > 2, TRINOCULAR, BINOCULAR)[sort],
        probability(belief)[sort],
        np.zeros(len(sort)),
        {name: why[name] for name in names},
        counts | counted(why),
    )


def _reasons(
    seen: Observed, chosen: Selection, pairs: Pairs, index: Int[np.ndarray, "t v"]
) -> dict[str, np.ndarray]:
    found = {}
    candidate = np.concatenate([chosen.candidates.index, pairs.candidates.index])
    log_odds = np.concatenate([chosen.log_odds, pairs.log_odds])
    for view, name in enumerate(seen.names):
        matched = np.zeros(seen.counts[view], dtype=bool)
        matched[index[index[:, view] >= 0, view]] = True
        words = reasons(seen.counts[view], candidate[:, view], log_odds, matched)
        found[name] = np.empty_like(words)
        found[name][seen.order[view]] = words
    return found


def fragments_of(
    seen: Observed, index: Int[np.ndarray, "t v"], part: Float[np.ndarray, "t v 2"]
) -> tuple[Float[np.ndarray, "t v 2 2"], Float[np.ndarray, "t v 4 4"]]:
    """(common parts on the segments, undistorted; their covariances), NaN where not seen."""
    tracks, views = index.shape
    fragments = np.full((tracks, views, 2, 2), np.nan)
    covariance = np.full((tracks, views, 4, 4), np.nan)
    for view in range(views):
        on = np.flatnonzero(index[:, view] >= 0)
        segment = index[on, view]
        ends, share = seen.ends_px[view][segment], part[on, view]
        weight = np.stack([1 - share, share], axis=2)
        fragments[on, view] = weight @ ends
        # Each end of the fragment is a mean of the segment's ends; so is its error.
        spread = np.einsum("tef,ij->teifj", weight, np.eye(2)).reshape(-1, 4, 4)
        covariance[on, view] = spread @ seen.covariance_px2[view][segment] @ spread.mT
    return fragments, covariance


def lines_in_space(
    seen: Observed,
    index: Int[np.ndarray, "t v"],
    fragments_px: Float[np.ndarray, "t v 2 2"],
    covariance_px2: Float[np.ndarray, "t v 4 4"],
) -> tuple[Float[np.ndarray, "t 2 3"], Float[np.ndarray, "t 6 6"]]:
    """Maximum-likelihood ends from all fragments, with covariance."""
    size, count = bucket(len(index)), len(index)
    # What pads the table is left out of the answer: any segment does.
    shape = fragments_px.shape[1:]
    filler = np.broadcast_to(np.array([[0.0, 0.0], [1.0, 0.0]]), shape)
    found = _triangulated(
        seen.lines.matrix_px,
        padded(fragments_px, size, filler),
        padded(covariance_px2, size, covariance_of_ends(np.array([[[0, 0], [1.0, 0]]]), 1, 1)[0]),
        padded(index >= 0, size, True),
    )
    return np.asarray(found.ends_mm)[:count], np.asarray(found.covariance_mm2)[:count]

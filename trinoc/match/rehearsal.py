"""The kernels of a first call, compiled several at a time.

Each step is run on no segments at all, which compiles what it needs, in a thread of its own: XLA
compiles outside Python's lock.
"""

from collections.abc import Callable, Hashable
from functools import partial

import jax
import numpy as np

from trinoc.match.candidates.search import gate_triples, prepare_orders
from trinoc.match.candidates.triples import evaluate_triples
from trinoc.match.observations.clutter import fit_clutter
from trinoc.match.observations.match_input import MatchInput
from trinoc.match.occlusion.possible_pairs import rehearse_pairs
from trinoc.match.tracks.line_fit import lines_in_space
from trinoc.match.tracks.multiview import view_triplets
from trinoc.match.tuning.every_group import MatchTuning
from trinoc.numerics.programs import at_once

# For which tables it was done.
_rehearsed: set[Hashable] = set()


def compile_together(seen: MatchInput, tuning: MatchTuning) -> None:
    """Compile what `match_frames` runs on tables of this size, unless that was done."""
    shapes = tuple((leaf.shape, str(leaf.dtype)) for leaf in jax.tree.leaves(seen.lines))
    if (shapes, tuning) in _rehearsed:
        return
    _rehearsed.add((shapes, tuning))
    lines, counts = seen.lines, seen.counts
    clutter, views = fit_clutter(lines, counts, tuning.clutter), len(counts)
    nothing = np.zeros(0, np.int32)
    works: list[Callable[[], object]] = []
    for own in view_triplets(lines, tuning.tracks)[:1]:
        three = prepare_orders(lines, own, counts, clutter, tuning)
        order, planes, single, table = three.each[0]
        search = three.lines, single, table, nothing, nothing, tuning.candidates
        judge = three.lines, order, planes, nothing.reshape(0, 3), three.clutter, tuning
        works += [partial(gate_triples, *search), partial(evaluate_triples, *judge)]
    works.append(partial(rehearse_pairs, lines, clutter, tuning))
    no_tracks = nothing.reshape(0, views), np.zeros((0, 2, 3))
    works.append(partial(lines_in_space, seen, *no_tracks))
    at_once(*works)

"""Which segments of the third view are where pairs of the first two predict them."""

from functools import partial

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.candidates.gate import passes_third_view_gate
from trinoc.match.candidates.index import Grid, SpatialIndex
from trinoc.match.candidates.lookup import keys_of, segments_near
from trinoc.match.candidates.single_precision import SingleOrder
from trinoc.match.candidates.transfer import Prediction, predict
from trinoc.match.observations import PAIRS_IN_BLOCK, SegmentTable, block_of
from trinoc.match.tuning import CandidateTuning
from trinoc.match.two_view import PencilSegments, row_of
from trinoc.numerics import ArrayLike, blocks, in_blocks, kept_jit, padded


def gated_triples(
    lines: SegmentTable,
    single: SingleOrder,
    table: SpatialIndex,
    i: Int[np.ndarray, "p"],
    j: Int[np.ndarray, "p"],
    tuning: CandidateTuning,
    any_order: bool = False,
) -> Int[np.ndarray, "h 3"]:
    """(segments in the views of an order) of what passes the gate in the third view; in
    `any_order`, also of pairs that predict it worse than another pair of the three would."""
    size = block_of(lines, PAIRS_IN_BLOCK)
    found = [np.zeros((0, 3), dtype=np.int32)]
    for block in blocks(len(i), size):
        rows = padded(i[block], size), padded(j[block], size)
        guess, keys = _predicted(single, table.grid, *rows, np.asarray(any_order), tuning=tuning)
        keys = np.stack([np.asarray(key)[: block.stop - block.start] for key in keys])
        pair, k = segments_near(table, keys)

        def gated(pair: np.ndarray, k: np.ndarray, guess: Prediction = guess) -> ArrayLike:
            return _passes_gate(single.segments, guess, pair, k, tuning=tuning)

        near_enough = in_blocks(gated, size, pair, k)
        # Several samples of one prediction may find one segment.
        both = np.unique((pair[near_enough].astype(np.int64) << 32) | k[near_enough])
        pair, k = (both >> 32) + block.start, both & 0xFFFFFFFF
        found.append(np.stack([i[pair], j[pair], k], axis=1).astype(np.int32))
    return np.concatenate(found)


@partial(kept_jit, static_argnames=("tuning",), beside_others=True)
def _predicted(
    single: SingleOrder,
    grid: Grid,
    i: Int[ArrayLike, "p"],
    j: Int[ArrayLike, "p"],
    any_order: Bool[ArrayLike, ""],
    tuning: CandidateTuning,
) -> tuple[Prediction, list[Int[ArrayLike, "_p"]]]:
    def predicted(
        i: ArrayLike, first: PencilSegments, second: PencilSegments
    ) -> tuple[Prediction, list[ArrayLike]]:
        own = single.view, grid
        if single.frame is not None:
            frame = single.frame[i]
            own = jax.tree.map(lambda column: column[frame], own)
        guess = predict(own[0], first, second, tuning, any_order)
        return guess, keys_of(own[1], guess, tuning)

    pairs = row_of(single.first, i), row_of(single.second, j)
    return jax.vmap(predicted, in_axes=(0, 1, 1))(i, *pairs)


@partial(kept_jit, static_argnames=("tuning",), beside_others=True)
def _passes_gate(
    segments: Float[ArrayLike, "n 11"],
    guesses: Prediction,
    pair: Int[ArrayLike, "h"],
    k: Int[ArrayLike, "h"],
    tuning: CandidateTuning,
) -> Bool[ArrayLike, "h"]:
    def gated(pair: ArrayLike, k: ArrayLike) -> ArrayLike:
        guess, own = jax.tree.map(lambda column: column[pair], guesses), segments[k]
        columns = own[:4].reshape(2, 2), own[4:7], own[7:].reshape(2, 2)
        return passes_third_view_gate(guess, *columns, tuning)

    return jax.vmap(gated)(pair, k)

"""What a search for triples in three views needs, prepared once for all that is asked of it."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from trinoc.match.candidates.index import SpatialIndex
from trinoc.match.candidates.lookup import lookup
from trinoc.match.candidates.single_precision import SingleOrder, prepared_order
from trinoc.match.observations import ClutterModel, SegmentTable
from trinoc.match.tuning import DEFAULT, MatchTuning
from trinoc.match.two_view import Pencil
from trinoc.numerics import ArrayLike


class Order(NamedTuple):
    """An ordering of the views: the pencil of the first two, what single precision needs of it, and
    the third by place and direction."""

    order: Int[np.ndarray, "3"]
    planes: Pencil
    single: SingleOrder
    table: SpatialIndex


class Orders(NamedTuple):
    """Tables of three of the views, `counts` of all of them, and the three orderings."""

    views: tuple[int, int, int]
    counts: list[int]
    lines: SegmentTable
    clutter: ClutterModel
    each: list[Order]

    @property
    def numbers(self) -> list[int]:
        """Segments of each of the three views."""
        return [self.counts[view] for view in self.views]


def prepared_orders(
    lines: SegmentTable,
    views: tuple[int, int, int],
    counts: list[int],
    clutter: ClutterModel,
    tuning: MatchTuning = DEFAULT,
) -> Orders:
    """Three of the views of a table, ready to be searched."""
    # Tables of three views, whichever and of how many, so that kernels compile once for all.
    if views != tuple(range(len(counts))):
        lines, clutter = _views_of(lines, clutter, np.array(views))
    each = []
    for turn in range(3):
        order = np.roll(np.arange(3), turn)
        third = int(order[2])
        table = lookup(lines, third, counts[views[third]], tuning.candidates)
        each.append(Order(order, *prepared_order(lines, order), table))
    return Orders(views, counts, lines, clutter, each)


@jax.jit
def _views_of(
    lines: SegmentTable, clutter: ClutterModel, views: Int[ArrayLike, "k"]
) -> tuple[SegmentTable, ClutterModel]:
    densities = jnp.asarray(clutter.log_density)[views]
    cameras = ("matrix_px", "centre_mm", "inverse", "size_px")
    shapes = {name: getattr(lines, name) for name in cameras}
    if lines.frame is not None:
        shapes = {name: jnp.moveaxis(column, 1, 0) for name, column in shapes.items()}
    three = jax.tree.map(lambda table: table[views], lines._replace(**shapes))
    if lines.frame is not None:
        moved = {name: jnp.moveaxis(getattr(three, name), 0, 1) for name in cameras}
        three = three._replace(**moved)
    return three, ClutterModel(densities, clutter.typical_px)

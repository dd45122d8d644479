"""A batch is its items, each with its own status."""

import numpy as np
import pytest

from tests.match.made import loose_lines, pictures, rig_of
from trinoc.match import match_many, match_segments
from trinoc.match.batch import OK

VIEWS = ("upper", "left", "right")


def test_a_batch_gives_what_its_items_give_and_a_bad_item_spoils_no_other() -> None:
    rigs = [rig_of(*VIEWS), rig_of("upper", "right"), rig_of(*VIEWS)]
    seen = [pictures(rig_of(*VIEWS), loose_lines(20 + k, seed=k), 0.3, seed=k) for k in range(3)]
    batch = match_many(seen, rigs)
    assert len(batch) == 3
    assert (batch.status[0], batch.status[2]) == (OK, OK)
    assert '"left"' in batch.status[1]
    assert batch.matches[1] is None
    for k in (0, 2):
        alone, found = match_segments(seen[k], rigs[k]), batch.matches[k]
        assert found is not None
        np.testing.assert_array_equal(found.index, alone.index)
        np.testing.assert_array_equal(found.lines_mm, alone.lines_mm)


def test_one_rig_serves_all_items_and_no_items_are_no_matches() -> None:
    rig = rig_of(*VIEWS)
    seen = [pictures(rig, loose_lines(20, seed=k)) for k in range(2)]
    assert (match_many(seen, rig).status == OK).all()
    assert len(match_many([], rig)) == 0
    with pytest.raises(ValueError, match="zip"):
        match_many(seen, [rig])

"""A proposed sheet fits the paper and the field, and its circles are wide enough."""

import pytest
from hypothesis import given, strategies as st

from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.targets.printing import printed_sheet, propose_sheet
from trinoc.calib.tuning.every_group import TUNING
from trinoc.errors import InputError
from trinoc.io.pattern_page import PAPER_SIZES_MM, drawing_room_mm, lay_out
from trinoc.numerics.tables import with_field

SIZE_PX = (1280, 960)


@given(
    width=st.floats(60, 5000),
    paper=st.sampled_from(sorted(PAPER_SIZES_MM)),
    across=st.integers(640, 8000),
)
def test_it_fits_paper_and_field(width: float, paper: str, across: int) -> None:
    field, size = (width, 0.75 * width), (across, across * 3 // 4)
    try:
        proposal = propose_sheet(field_mm=field, size_px=size, room_mm=drawing_room_mm(paper))
    except InputError:
        # Six circles of 10 px would not fit.
        side = min(0.6 * min(field), *drawing_room_mm(paper))
        assert 0.6 * side / 6.5 * across / width < 10.5 + 0.3 * across / width
        return
    assert proposal.circle_px >= 10
    assert proposal.field_share <= 0.6 + 1e-9
    sheet = Pattern.cross_grid(
        rows=proposal.count,
        columns=proposal.count,
        pitch_mm=proposal.pitch_mm,
        radius_mm=proposal.radius_mm,
    )
    assert sorted(lay_out(sheet, paper).size_mm) == sorted(PAPER_SIZES_MM[paper])
    scale = size[0] / field[0]
    assert proposal.circle_px == pytest.approx(2 * proposal.radius_mm * scale, rel=0.01)


def test_more_pixels_allow_more_circles_and_distance_takes_them() -> None:
    room = drawing_room_mm("a4")
    counts = [
        propose_sheet(field_mm=(400 * far, 300 * far), size_px=SIZE_PX, room_mm=room).count
        for far in (1.0, 1.6, 3.0)
    ]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > counts[-1]
    with pytest.raises(InputError, match="less than 10 px"):
        propose_sheet(field_mm=(40000.0, 30000.0), size_px=SIZE_PX, room_mm=room)
    with pytest.raises(InputError, match="no room for a sheet"):
        propose_sheet(field_mm=(0.4, 0.3), size_px=SIZE_PX, room_mm=room)


def test_a_proposal_and_a_printed_sheet_follow_the_tuning() -> None:
    room = drawing_room_mm("a4")
    usual = propose_sheet(field_mm=(400, 300), size_px=SIZE_PX, room_mm=room)
    wider = with_field(TUNING, "targets.good_px", 2 * usual.circle_px)
    other = propose_sheet(field_mm=(400, 300), size_px=SIZE_PX, room_mm=room, tuning=wider)
    assert other.count < usual.count
    exact = with_field(TUNING, "targets.largest_change", 1e-3)
    drawn, measured = (100.0, 100.0), (101.0, 101.0)
    sheet = Pattern.default()
    printed_sheet(sheet, nominal_mm=drawn, measured_mm=measured)
    with pytest.raises(InputError, match="check the unit"):
        printed_sheet(sheet, nominal_mm=drawn, measured_mm=measured, tuning=exact)

"""Tables of segments are read by the names of their columns, or refused by name."""

import itertools

import numpy as np
import pytest

from trinoc.errors import InputError
from trinoc.io.column_names import LEFT_OUT, _plain
from trinoc.io.known_shape import load_shape
from trinoc.io.segment_table import load_segments

ENDS = np.array([[10.0, 20, 30, 44], [50, 61, -7, 90], [300, 5.5, 300, 1.25]])
MIDDLE = (ENDS[:, :2] + ENDS[:, 2:]) / 2
VECTOR = ENDS[:, 2:] - ENDS[:, :2]
LENGTH = np.linalg.norm(VECTOR, axis=1)[:, None]
ANGLE = np.arctan2(VECTOR[:, 1], VECTOR[:, 0])[:, None]
MORE = np.full((3, 1), 7.0)

# The same three segments as tables of different names.
TABLES = {
    "x1,y1,x2,y2": ENDS,
    "X1;Y1;X2;Y2": ENDS,
    "x_1 y_1 x_2 y_2": ENDS,
    "x1_px,y1_px,x2_px,y2_px": ENDS,
    "x1 [px],y1 [px],x2 [px],y2 [px]": ENDS,
    '"x1","y1","x2","y2"': ENDS,
    "start_x,start_y,end_x,end_y": ENDS,
    "startPointX,startPointY,endPointX,endPointY": ENDS,
    "x0,y0,x1,y1": ENDS,
    "u1 v1 u2 v2": ENDS,
    "r1,c1,r2,c2": ENDS[:, [1, 0, 3, 2]],
    "row1,col1,row2,col2": ENDS[:, [1, 0, 3, 2]],
    "Row_start,Column_start,Row_end,Column_end": ENDS[:, [1, 0, 3, 2]],
    "xm,ym,full_dx,full_dy": np.hstack([MIDDLE, VECTOR]),
    "center_x,center_y,dx_half,dy_half": np.hstack([MIDDLE, VECTOR / 2]),
    "mid_row,mid_col,half_drow,half_dcol": np.hstack([MIDDLE, VECTOR / 2])[:, [1, 0, 3, 2]],
    "xm,ym,dx,dy,length": np.hstack([MIDDLE, VECTOR / 9, LENGTH]),
    "xc,yc,length,angle_deg": np.hstack([MIDDLE, LENGTH, np.rad2deg(ANGLE)]),
    "x_mid,y_mid,length_px,theta [rad]": np.hstack([MIDDLE, LENGTH, ANGLE]),
    "x1,y1,x2,y2,width,score,NFA": np.hstack([ENDS, MORE, MORE, MORE]),
    "x1,y1,x2,y2,angle,length,xm": np.hstack([ENDS, MORE, MORE, MORE]),
}


def read(folder, heading, rows, suffix="csv"):
    separator = next((sign for sign in ";," if sign in heading), " ")
    file = folder / f"ends.{suffix}"
    lines = [separator.join(map(repr, row)) for row in np.asarray(rows).tolist()]
    file.write_text("\n".join([heading, *lines]) + "\n")
    return load_segments(file).endpoints_px.reshape(-1, 4)


@pytest.mark.parametrize("heading", TABLES)
def test_every_way_to_write_segments_gives_the_same_ends(tmp_path, heading):
    ends = read(tmp_path, heading, TABLES[heading])
    np.testing.assert_allclose(ends, ENDS, rtol=0, atol=1e-12)


@pytest.mark.parametrize("heading", ["x1,y1,x2,y2", "xm,ym,length,angle_deg"])
def test_the_order_of_columns_changes_nothing(tmp_path, heading):
    names = heading.split(",")
    rows = ENDS if names[0] == "x1" else np.hstack([MIDDLE, LENGTH, np.rad2deg(ANGLE)])
    for order in itertools.permutations(range(4)):
        permuted = ",".join(names[k] for k in order)
        ends = read(tmp_path, permuted, rows[:, order])
        np.testing.assert_allclose(ends, ENDS, rtol=0, atol=1e-12)
        ends = read(tmp_path, f"# {permuted}", rows[:, order])
        np.testing.assert_allclose(ends, ENDS, rtol=0, atol=1e-12)


def test_ends_that_are_exchanged_stay_exchanged(tmp_path):
    exchanged = read(tmp_path, "x2,y2,x1,y1", ENDS)
    np.testing.assert_array_equal(exchanged, ENDS[:, [2, 3, 0, 1]])


def test_the_row_numbers_of_a_data_frame_are_left_out(tmp_path):
    rows = np.hstack([np.arange(3.0)[:, None], ENDS])
    np.testing.assert_array_equal(read(tmp_path, ",x1,y1,x2,y2", rows), ENDS)


@pytest.mark.parametrize(
    ("comment", "order"),
    [
        ("# made by a detector in 2020", [0, 1, 2, 3]),
        ("# lines: x1 x2 y1 y2", [0, 2, 1, 3]),
        ("# all of x1 x2 y1 y2 in px", [0, 2, 1, 3]),
        ("#", [0, 1, 2, 3]),
    ],
)
def test_a_comment_names_columns_or_is_skipped(tmp_path, comment, order):
    np.testing.assert_array_equal(read(tmp_path, comment, ENDS[:, order]), ENDS)


@pytest.mark.parametrize(
    ("heading", "why"),
    [
        ("x,y,w,h", "names the columns x, y, w, h, which do not give"),
        ("a,b,c,d", "names the columns a, b, c, d, which do not give"),
        ("x1,y1,w,h", "names the columns x1, y1, w, h, which do not give"),
        ("rho,theta,id,score", "which do not give the ends of a segment"),
        ("xm,ym,dx,dy", "dx, dy are measured from end to end or from the middle to an end"),
        ("xm,ym,length,angle", "does not state the unit of the angle: .* angle_deg or angle_rad"),
        ("x1,y1,x2,y2,foo", 'names a column "foo" that trinoc does not know'),
        ("x1,y1,z1,x2,y2,z2", 'names a column "z1" that'),
        ("x1_mm,y1_mm,x2_mm,y2_mm", "which do not give the ends"),
        ("x1,x1,y1,y2", 'has columns "x1" and "x1", which may be the same quantity'),
        ("x1,y1,x2,y2,start_x", 'has columns "x1" and "start_x"'),
        ("x0,y0,x1,y1,x2,y2", "may be the same quantity"),
    ],
)
def test_a_heading_that_is_not_known_is_refused_with_those_that_are(tmp_path, heading, why):
    rows = np.arange(1.0, 2 * len(heading.split(",")) + 1).reshape(2, -1)
    for first in (heading, f"# {heading}") if "x1,y1" in heading else (heading,):
        with pytest.raises(InputError, match=rf"ends\.csv, line 1, .*{why}") as caught:
            read(tmp_path, first, rows)
        if "dx" not in heading and "angle" not in heading:
            assert "x1 y1 x2 y2; row1 col1 row2 col2" in str(caught.value)


def test_a_heading_names_as_many_columns_as_the_rows_have(tmp_path):
    with pytest.raises(InputError, match="names 4 columns, but the rows have 5 numbers"):
        read(tmp_path, "x1,y1,x2,y2", np.hstack([ENDS, MORE]))


def test_a_heading_alone_is_an_empty_table(tmp_path):
    assert len(read(tmp_path, "xm,ym,length,angle_deg", np.zeros((0, 4)))) == 0


def test_names_that_are_left_out_are_in_their_plain_form():
    assert {name for name in LEFT_OUT if _plain(name) != name} == set()


def test_edges_of_a_shape_are_read_by_their_names_too(tmp_path):
    edge = np.arange(6.0)
    file = tmp_path / "shape.csv"
    for order in ([0, 3, 1, 4, 2, 5], [5, 4, 3, 2, 1, 0]):
        names = ",".join(["x1", "y1", "z1", "x2", "y2", "z2"][k] for k in order)
        file.write_text(f"{names}\n{','.join(map(str, edge[order]))}\n")
        np.testing.assert_array_equal(load_shape(file).edges_mm.reshape(-1), edge)
    file.write_text("a,b,c,d,e,f\n0,1,2,3,4,5\n")
    with pytest.raises(InputError, match=r"line 1, names the columns a, b, .* in any order"):
        load_shape(file)

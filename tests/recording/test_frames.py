"""Names and tables to frames, and frames to parts: laws for any names."""

import re

import pytest
from hypothesis import given, strategies as st

from trinoc.errors import InputError
from trinoc.recording.frame_table import Frame, frames_of_table
from trinoc.recording.name_templates import fitting_template, frames_of_names
from trinoc.recording.parts import cut_into_parts, share_parts

CAMERAS = ("upper", "left", "right", "left_far")
FRAMES = st.lists(st.text("ab01239.-", min_size=1, max_size=6), min_size=1, unique=True)
TEMPLATES = st.sampled_from(
    ["{frame}_{camera}.png", "{camera}/{frame}.tif", "{frame}/x_{camera}.png", "{camera}_{frame}"]
)


@given(names=FRAMES, template=TEMPLATES, more=st.lists(st.text("xyz/._")))
def test_names_written_by_a_template_are_read_by_it(names, template, more):
    files = [template.format(frame=f, camera=c) for f in names for c in CAMERAS]
    frames = frames_of_names([*more, *files], template, CAMERAS)
    assert sorted(frame.name for frame in frames) == sorted(names)
    for frame in frames:
        expected = {c: template.format(frame=frame.name, camera=c) for c in CAMERAS}
        assert dict(frame.files) == expected


@given(numbers=st.lists(st.integers(0, 10**6), min_size=1, unique=True))
def test_frames_come_in_the_order_of_their_numbers(numbers):
    names = [f"f{n}_upper.png" for n in numbers]
    frames = frames_of_names(names, "{frame}_{camera}.png", ("upper",))
    assert [frame.name for frame in frames] == [f"f{n}" for n in sorted(numbers)]


@pytest.mark.parametrize(
    "template", ["{camera}/{frame}.*", "{frame}_{camera}.*", "{camera}-{frame}.*"]
)
def test_the_usual_templates_are_found_by_themselves(template):
    files = [
        template.format(frame=f"{k:03d}", camera=c).replace("*", "png")
        for k in range(3)
        for c in CAMERAS
    ]
    template_found = fitting_template(["notes.txt", *files], CAMERAS)
    assert frames_of_names(files, template_found, CAMERAS) == frames_of_names(
        files, template, CAMERAS
    )


@pytest.mark.parametrize(
    ("template", "message"),
    [
        ("{frame}.png", r"lacks {camera}"),
        ("{camera}.png", r"lacks {frame}"),
        ("{frame}_{camera}_{time}.png", r"has {time}"),
        ("{frame}-{camera}.jpg", "No file matches"),
        ("{frame}_{camera}.*", "are both the picture of"),
    ],
)
def test_templates_that_do_not_fit_say_why(template, message):
    with pytest.raises(InputError, match=re.escape(message)):
        frames_of_names(["1_upper.png", "1_upper.tif"], template, CAMERAS)


def test_cameras_named_after_files_are_found_by_their_stems():
    cameras = ("robot/8461.png", "robot/9512.png", "hand/77.png")
    files = [f"{k}_{stem}.png" for k in range(2) for stem in ("8461", "9512", "77")]
    template = fitting_template(files, cameras)
    frames = frames_of_names(files, template, cameras)
    assert [dict(frame.files) for frame in frames] == [
        {"robot/8461.png": f"{k}_8461.png", "robot/9512.png": f"{k}_9512.png"}
        | {"hand/77.png": f"{k}_77.png"}
        for k in range(2)
    ]
    table = "frame,77,9512.png,robot/8461.png\n0,a,b,c\n"
    (frame,) = frames_of_table(table, cameras, "t.csv")
    assert frame.files == {"robot/8461.png": "c", "robot/9512.png": "b", "hand/77.png": "a"}


def test_three_cameras_of_many_are_a_recording():
    files = [f"{k}_{camera}.png" for k in range(2) for camera in ("upper", "left", "right")]
    many = (*CAMERAS, *map(str, range(30)))
    frames = frames_of_names(files, fitting_template(files, many), many)
    assert [sorted(frame.files) for frame in frames] == [["left", "right", "upper"]] * 2
    with pytest.raises(InputError, match="No frame has files named after all cameras"):
        fitting_template(files[:2], many)
    (frame,) = frames_of_table("frame,upper,left,right\n1,a,b,c\n", many, "t.csv")
    assert list(frame.files) == ["upper", "left", "right"]


def test_files_that_name_no_camera_are_refused_with_an_example():
    with pytest.raises(InputError, match="No frame has files named after all cameras"):
        fitting_template(["a.png", "b.png"], CAMERAS)


TABLE = "frame,upper,note,left\n"


def test_a_table_keeps_its_order_and_may_lack_pictures():
    text = TABLE + "b,b1.png,x,b2.png\n\na,sub/a1.png,,\n"
    assert frames_of_table(text, ("left", "upper"), "t.csv") == [
        Frame("b", {"left": "b2.png", "upper": "b1.png"}),
        Frame("a", {"upper": "sub/a1.png"}),
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", 'must have one column "frame"'),
        ("frame,upper\n1,a\n", 'must have one column "left"'),
        ("frame,upper,upper,left\n", 'one column "upper"'),
        (TABLE, "lists no frame"),
        (TABLE + "1,a,b\n", "row 2, has 3 cells for 4 columns"),
        (TABLE + ",a,b,c\n", "row 2, names no frame"),
        (TABLE + "1,a,b,c\n1,a,b,c\n", 'row 3, names the frame "1" again'),
        (TABLE + '1,"a,b,c\n', "is not a CSV table"),
    ],
)
def test_tables_that_list_no_frames_say_where(text, message):
    with pytest.raises(InputError, match=r"^t\.csv") as caught:
        frames_of_table(text, ("upper", "left"), "t.csv")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "file", ["/etc/passwd", "../a.png", "a/../../b.png", "a\\..\\b", "C:\\a.png", "~/a", "a\x00b"]
)
def test_files_outside_the_table_s_folder_are_refused(file):
    with pytest.raises(InputError, match="is not inside the table's folder"):
        frames_of_table(f"frame,upper\n1,{file}\n", ("upper",), "t.csv")


@given(text=st.text(st.sampled_from('frameupper,12"\n\r;\x00 '), max_size=60))
def test_any_text_is_frames_or_a_sentence(text):
    try:
        texts = [frame.name for frame in frames_of_table(text, ("upper",), "t.csv")]
    except InputError as error:
        texts = [str(error)]
        is_named = str(error).startswith("t.csv")
    else:
        is_named = True
    assert texts
    assert is_named


@given(count=st.integers(0, 60), size=st.integers(1, 20), jobs=st.integers(1, 7))
def test_jobs_share_all_frames_once_and_the_cut_does_not_depend_on_them(count, size, jobs):
    frames = [Frame(str(k), {}) for k in range(count)]
    parts = cut_into_parts(frames, size)
    assert [frame for part in parts for frame in part.frames] == frames
    assert [part.number for part in parts] == list(range(len(parts)))
    shares = [share_parts(parts, (job, jobs)) for job in range(1, jobs + 1)]
    assert sorted(part.number for share in shares for part in share) == list(range(len(parts)))
    assert max(map(len, shares)) - min(map(len, shares)) <= 1


@pytest.mark.parametrize("shard", [(0, 1), (3, 2), (1, 0), (-1, 4)])
def test_there_is_no_such_job(shard):
    with pytest.raises(InputError, match="There is no shard"):
        share_parts([], shard)

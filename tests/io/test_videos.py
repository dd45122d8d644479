"""Videos of cameras in step become folders of frames, which the other commands read."""

import json
import os
import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

import trinoc
from trinoc.batch.source import find_frames
from trinoc.cli.main import main
from trinoc.io import videos as reader
from trinoc.io.images import load_shots, read_image
from trinoc.io.videos import open_videos, read_moments
from trinoc.synth import table1_rig

SIZE_PX, RATE, BAR_PX = (96, 64), 10.0, 8
COUNT = 12


def frame_of(number: int) -> np.ndarray:
    """A frame that shows its number in binary, as bright columns that survive any codec."""
    bits = [number >> k & 1 for k in range(SIZE_PX[0] // BAR_PX)]
    row = np.repeat(np.array(bits, dtype=np.uint8) * 200 + 20, BAR_PX)
    return np.tile(row, (SIZE_PX[1], 1))


def number_of(picture: np.ndarray) -> int:
    grey = picture if picture.ndim == 2 else picture.mean(axis=2)
    bits = grey[:, BAR_PX // 2 :: BAR_PX].mean(axis=0) > 120
    return sum(int(bit) << k for k, bit in enumerate(bits))


def write_video(
    file: str, count: int = COUNT, rate: float = RATE, code: str = "MJPG", size: int = 1
) -> None:
    size_px = (size * SIZE_PX[0], size * SIZE_PX[1])
    writer = cv2.VideoWriter(file, cv2.VideoWriter.fourcc(*code), rate, size_px, False)
    for number in range(count):
        writer.write(cv2.resize(frame_of(number), size_px, interpolation=cv2.INTER_NEAREST))
    writer.release()


def rewrite(file: str, change: Callable[[bytes], bytes]) -> None:
    Path(file).write_bytes(change(Path(file).read_bytes()))


def turned(content: bytes) -> bytes:
    """An MP4 with a display matrix that rotates by 90 degrees, as by telephones (ISO 14496-12)."""
    offset = content.index(b"tkhd") + 44
    matrix = struct.pack(">9i", 0, 1 << 16, 0, -(1 << 16), 0, 0, 0, 0, 1 << 30)
    return content[:offset] + matrix + content[offset + 36 :]


def with_gap(content: bytes, before: int) -> bytes:
    """An MP4 with a gap of one frame in its time stamps, as after a dropped frame."""
    # The list of edits says how long the video was.
    content = content.replace(b"edts", b"free")
    offset = content.index(b"stts") + 4
    entries, count, step = struct.unpack_from(">3I", content, offset + 4)
    assert entries == 1
    runs = ((before - 1, step), (1, 2 * step), (count - before, step))
    table = struct.pack(">I", 3) + b"".join(struct.pack(">2I", *run) for run in runs)
    content = content[: offset + 4] + table + content[offset + 16 :]
    for box in (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stts"):
        begin = content.index(box) - 4
        grown = struct.unpack_from(">I", content, begin)[0] + 16
        content = content[:begin] + struct.pack(">I", grown) + content[begin + 4 :]
    return content


@pytest.fixture
def run(tmp_path, monkeypatch, capfd):
    """Run the export of video frames in an empty folder: (status, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)

    def run_one(*arguments):
        return main(["export", *arguments, "--from", "video", "-o", "frames"]), *capfd.readouterr()

    return run_one


def numbers_there(camera: str) -> dict[int, int]:
    """For each frame file: the number in its name and the number that its image shows."""
    files = sorted(Path("frames", camera).iterdir())
    return {int(file.stem): number_of(read_image(file)) for file in files}


def test_frames_of_three_videos_are_a_recording_and_shots(run):
    for name in ("upper", "left", "right"):
        write_video(f"{name}.avi")
    status, stdout, _ = run("upper.avi", "left.avi", "right.avi")
    assert status == 0
    assert stdout.startswith("12 frames of upper (96 x 64 px), left (96 x 64 px), right")
    for name in ("upper", "left", "right"):
        assert numbers_there(name) == {k: k for k in range(COUNT)}
    assert not list(Path("frames").rglob(".*"))
    source = find_frames("frames", ("upper", "left", "right"))
    assert [frame.name for frame in source.frames] == [f"{k:06d}" for k in range(COUNT)]
    assert all(len(frame.files) == 3 for frame in source.frames)
    tenth = find_frames("frames", ("left", "right"), "{camera}/{frame}0.png")
    assert [frame.files["left"] for frame in tenth.frames] == [f"left/{k:06d}.png" for k in (0, 10)]
    shots = load_shots({"left": "frames/left", "right": "frames/right"})
    assert list(shots["left"]) == list(shots["right"]) == [f"{k:06d}" for k in range(COUNT)]


def test_frames_are_as_the_video_has_them_and_grey_ones_stay_grey(run):
    write_video("left.avi")
    coloured = np.zeros((*SIZE_PX[::-1], 3), dtype=np.uint8)
    coloured[..., 2] = 180
    writer = cv2.VideoWriter("red.avi", cv2.VideoWriter.fourcc(*"MJPG"), RATE, SIZE_PX, True)
    writer.write(coloured)
    writer.release()
    assert run("left.avi", "red.avi")[0] == 0
    for name in ("left", "red"):
        frame = cv2.VideoCapture(f"{name}.avi").read()[1]
        picture = read_image(f"frames/{name}/000000.png")
        expected = frame[..., 0] if name == "left" else frame[..., ::-1]
        np.testing.assert_array_equal(picture, expected)


@pytest.mark.parametrize(("every_s", "step"), [("0.5", 5), ("0.01", 1), ("0.24", 2)])
def test_every_so_many_seconds(run, every_s, step):
    write_video("left.avi")
    status, stdout, _ = run("left=left.avi", "--every-s", every_s, "--json")
    assert status == 0
    numbers = range(0, COUNT, step)
    assert json.loads(stdout)["frames"] == len(numbers)
    assert numbers_there("left") == {k: k for k in numbers}


def test_a_dropped_frame_puts_no_later_one_out_of_step(run):
    """Frames are paired by their time stamps, not by their order in the files."""
    count, gap = 240, 17
    write_video("left.mp4", count, code="mp4v")
    write_video("right.mp4", count - 1, code="mp4v")
    rewrite("right.mp4", lambda content: with_gap(content, gap))
    status, _, stderr = run("left.mp4", "right.mp4")
    assert status == 0
    assert "right.mp4 has no frame at 1 of the moments of the other videos" in stderr
    assert numbers_there("left") == {k: k for k in range(count) if k != gap}
    # The picture that shows k - 1 was taken at k.
    sources = {k: k if k < gap else k - 1 for k in range(count) if k != gap}
    assert numbers_there("right") == sources


def test_a_clock_that_stands_still_counts_for_nothing(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    write_video("left.avi")

    class Standing:
        def __init__(self, file: str) -> None:
            self._own = cv2.VideoCapture(file)

        def __getattr__(self, name: str):
            return getattr(self._own, name)

        def get(self, name: int) -> float:
            return 0.0 if name == cv2.CAP_PROP_POS_MSEC else self._own.get(name)

    monkeypatch.setattr(reader, "_open", lambda file: Standing(str(file)))
    moments = read_moments(open_videos({"left": Path("left.avi")}), pytest.fail)
    assert [number for number, _ in moments] == list(range(COUNT))


def test_a_video_that_is_to_be_turned_gives_what_the_sensor_had(run):
    write_video("left.mp4", code="mp4v")
    write_video("right.mp4", code="mp4v")
    rewrite("right.mp4", turned)
    status, _, stderr = run("left.mp4", "right.mp4")
    assert status == 0
    assert "right.mp4 has a tag to rotate it by 90 degrees" in stderr
    for number in range(COUNT):
        left, right = (read_image(f"frames/{n}/{number:06d}.png") for n in ("left", "right"))
        np.testing.assert_array_equal(left, right)


def cut_in_frame(number: int, content: bytes) -> bytes:
    """An AVI that ends within a frame; each is a chunk "00dc", which its index names once."""
    return b"00dc".join(content.split(b"00dc")[: number + 3])[:-100]


@pytest.mark.parametrize("read", [1, 7, COUNT - 1])
def test_of_a_damaged_tail_what_was_read_is_kept_and_said(run, read):
    write_video("left.avi")
    write_video("right.avi")
    rewrite("right.avi", lambda content: cut_in_frame(read, content))
    status, stdout, stderr = run("left.avi", "right.avi", "--json")
    assert status == 0
    assert json.loads(stdout)["frames"] == read
    assert f"right.avi states 12 frames, but only {read} can be read" in stderr
    assert numbers_there("left") == numbers_there("right") == {k: k for k in range(read)}


def test_lengths_and_sizes_that_differ_are_named(run):
    write_video("left.avi")
    write_video("right.avi", COUNT - 4, size=2)
    status, stdout, stderr = run("left.avi", "right.avi")
    assert status == 0
    assert stdout.startswith("8 frames of left (96 x 64 px), right (192 x 128 px)")
    assert "left.avi has 12 frames and right.avi 8" in stderr
    assert "left.avi is 96 x 64 px and right.avi 192 x 128 px" in stderr
    assert "can be read" not in stderr


def refusals():
    yield "another rate", ("left.avi", "slow.avi"), "10 frames a second and slow.avi 5"
    yield "no video", ("left.avi", "text.avi"), "text.avi is no video that OpenCV reads"
    yield "cut MP4", ("left.avi", "cut.mp4"), "or cut off: copy it again"
    yield "no frames", ("left.avi", "none.avi"), "none.avi holds no frame"
    yield "not there", ("left.avi", "nowhere.avi"), "nowhere.avi does not exist"
    yield "a folder", ("a=left.avi", "b=."), ". is a folder: give the video file"
    yield "a picture", ("left.avi", "one.png"), "one.png is a picture"
    yield "no names", ("left=left.avi", "right.avi"), "write NAME=FILE"
    yield "twice", ("a=left.avi", "b=left.avi"), "Two cameras have the same video"
    yield "no folder", ("../a=left.avi",), '"../a" is not allowed as the name of a folder'
    yield "hidden", (".a=left.avi",), '".a" is not allowed as the name of a folder'
    yield "nothing", (), "No video is given"
    yield (
        "an option",
        ("left.avi", "--unit-mm", "3"),
        "--unit-mm, --names and --lens are not options",
    )


@pytest.mark.parametrize(("arguments", "why"), [each[1:] for each in refusals()])
def test_what_gives_no_frames_is_said_before_any_is_written(run, arguments, why):
    write_video("left.avi")
    write_video("slow.avi", rate=5.0)
    write_video("none.avi", 0)
    write_video("cut.mp4", code="mp4v")
    rewrite("cut.mp4", lambda content: content[: len(content) // 2])
    Path("text.avi").write_text("hello")
    cv2.imwrite("one.png", frame_of(1))
    status, stdout, stderr = run(*arguments)
    assert (status in (1, 2), stdout) == (True, "")
    assert why in stderr
    assert stderr.splitlines()[-1].startswith("trinoc: ")
    assert not Path("frames").exists()


def test_no_file_is_written_among_others_or_over_the_video(run):
    write_video("a b.avi")
    Path("frames").mkdir()
    Path("frames", "mine.txt").write_text("mine")
    status, stdout, stderr = run("a b.avi")
    assert (status, stdout) == (1, "")
    assert "contains files: give a new or an empty folder" in stderr
    assert os.listdir("frames") == ["mine.txt"]
    Path("frames", "mine.txt").unlink()
    # An empty folder is as good as a new one, and names may have spaces.
    assert run("a b.avi")[0] == 0
    assert numbers_there("a b") == {k: k for k in range(COUNT)}
    assert main(["export", "a b.avi", "--from", "video", "-o", "a b.avi", "--force"]) == 2


def test_a_video_where_pictures_are_asked_for_names_the_command(run, capfd, tmp_path):
    write_video("left.avi")
    Path("videos").mkdir()
    write_video("videos/left.avi")
    trinoc.save(trinoc.Pattern.cross_grid(rows=4, columns=5, pitch_mm=20, radius_mm=5), "b.json")
    trinoc.save(table1_rig(), "rig.json")
    for arguments in (
        ("segments", "left.avi", "-o", "s.npz"),
        ("batch", "left.avi", "--rig", "rig.json"),
        ("batch", "videos", "--rig", "rig.json"),
        ("calibrate-rig", "left=left.avi", "--board", "b.json"),
        ("calibrate-rig", "left=videos", "--board", "b.json"),
    ):
        assert main(arguments) == 1
        stderr = capfd.readouterr().err
        file = "videos/left.avi" if "videos" in " ".join(arguments) else "left.avi"
        assert f"{file} is a video: write its frames by `trinoc export" in stderr

"""Every writer keeps a name with any characters, or refuses it before it writes a file."""

import dataclasses
import importlib.util
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import pytest

import trinoc
from tests.io.formats.bench import bench_matches, bench_rig
from tests.io.formats.strategies import CORNERS, in_frame_of
from tests.io.formats.test_round_trips import ENDINGS
from tests.io.made_rims import made_rims
from tests.io.made_wireframe import made_wireframe
from trinoc.calib.folded_lens import assess_folds
from trinoc.calib.targets.board_set import BoardSet
from trinoc.errors import InputError
from trinoc.geometry.camera import Camera, project
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.io import FORMATS
from trinoc.io.formats.format import LENSES, NAMES, WORLD
from trinoc.io.frames_files import load_frames, save_frames
from trinoc.io.pattern_page import lay_out, pattern_svg
from trinoc.match.tracks.matches import Matches
from trinoc.recording.frame_table import FrameMatches

# Names of the three cameras of the bench.
CAMERA_NAMES = (
    ("realsense/846112073799.png", "a/b/c", "/"),
    ("..\\up", "../up", "C:\\x"),
    ("a=b", "a,b", "a;b"),
    ('"quoted"', "'single'", "`code`"),
    ("links", "größer", "左"),
    ("cam", "cam_segment", "cam.left"),
    (" before", "after ", "in the  middle"),
    ("<b>&amp;</b>", "{{ name }}", "%s"),
    ("format", "version", "views"),
    ("index", "reasons/index", "matches/"),
    ("board", "world", "frame"),
    ("-", "--out", "~"),
    ("1", "1.5", "nan"),
    ("x" * 300, "null", "true"),
    ("#", "*", "?"),
    # What differs by case, by composed characters, or not at all once it is made a file's name.
    ("left", "Left", "LEFT"),
    ("e\u0301", "\u00e9", "e"),
    ("a/b", "a%2Fb", "a_b"),
    ("CON", "nul", "a."),
    # What some format gives a meaning.
    ("tf_static", "cam0", "cam_0"),
    ("a_optical_frame", "a_optical", "a"),
    ("a_to_b", "b", "a"),
    ("none", "names", "metadata"),
    ("1_a", "a_1", "_1"),
    ("x.npy", "x.yaml", "x.png"),
)
# Boards, frames, notes and marks have any text for a name.
TEXTS = (
    *("a/b", "..", "", " a  b ", "'\"`", "größe 左", "a\nb", "\r", "a\tb", "-x", "a:b", "%s", "="),
    *("#", "x" * 300, "\ud800", "a\u2028b", "a\x00b", "\x1b", "{{ x }}", "<b>&", "\ufeff", "nan"),
)
PIXELS = jax.jit(jax.vmap(project, (None, 0)))
HAS_PYARROW = importlib.util.find_spec("pyarrow") is not None
PATTERN = trinoc.Pattern.cross_grid(rows=4, columns=6, pitch_mm=20.0, radius_mm=6.0)


# Its lenses, of four coefficients, fit all formats.
BENCH = bench_rig(4)


def rig_with(names: tuple[str, ...]) -> Rig:
    """The bench's rig under other names, with a covariance."""
    parameters = [f"{name}.{key}" for name in names for key in ("pan_deg", "tilt_deg")]
    cameras = dict(zip(names, BENCH.cameras, strict=True))
    variances = np.arange(1.0, len(parameters) + 1)
    return Rig(cameras, parameters=parameters, covariance=np.diag(variances))


def matches_with(names: tuple[str, ...]) -> Matches:
    """The bench's matches under other names."""
    matches = bench_matches()
    reasons = dict(zip(names, (matches.reasons[v] for v in matches.views), strict=True))
    return dataclasses.replace(matches, views=names, reasons=reasons)


class Writer(NamedTuple):
    """A writer and the reader of its files.

    make : the value, of some names. ending : of the file. save, load : write it and read it.
    is_same : whether what was read is the value.
    """

    make: Callable[[Any], Any]
    ending: str
    save: Callable[[Any, Path], None]
    load: Callable[[Path, Any], Any]
    is_same: Callable[[Any, Any], bool] = lambda read, value: read == value


def writer_of_format(name: str, ending: str) -> Writer:
    """The writer and the reader of another tool's cameras."""
    target = FORMATS[name]

    def load(path: Path, rig: Rig) -> Rig:
        lenses = {camera_name: camera.intrinsics for camera_name, camera in rig.items()}
        return target.load(
            path,
            lenses=lenses if LENSES in target.loses else None,
            names=rig.names if NAMES in target.loses else None,
        )

    def is_same(read: Rig, rig: Rig) -> bool:
        points = in_frame_of(rig.cameras[0]) if WORLD in target.loses else CORNERS
        return set(read.names) == set(rig.names) and all(
            np.allclose(
                PIXELS(read[camera_name], points), PIXELS(camera, CORNERS), rtol=0, atol=1e-9
            )
            for camera_name, camera in rig.items()
        )

    return Writer(rig_with, ending, lambda rig, path: target.save(rig, path), load, is_same)


def frames_with(names: tuple[str, ...]) -> list[FrameMatches]:
    """A frame that worked and one that failed."""
    return [FrameMatches("0", "ok", matches_with(names)), FrameMatches("1", "no picture", None)]


def save_frames_with(results: list[FrameMatches], path: Path) -> None:
    """Write the frames of `frames_with`."""
    assert results[0].matches is not None
    save_frames(results, results[0].matches.views, path)


def load_value(path: Path, value: object) -> Any:
    """Read a file of `trinoc.save`."""
    return trinoc.load(path)


def load_frames_of(path: Path, value: object) -> list[FrameMatches]:
    """Read a file of frames."""
    return load_frames(path)


WRITERS = {
    "rig.json": Writer(rig_with, ".json", trinoc.save, load_value),
    "matches.npz": Writer(matches_with, ".npz", trinoc.save, load_value),
    "rims.npz": Writer(
        lambda names: dataclasses.replace(made_rims(), views=names, matches=matches_with(names)),
        ".npz",
        trinoc.save,
        load_value,
    ),
    **{
        f"frames{ending}": Writer(frames_with, ending, save_frames_with, load_frames_of)
        for ending in ((".npz", ".parquet") if HAS_PYARROW else (".npz",))
    },
    **{f"{name}{ending}": writer_of_format(name, ending) for name, ending in ENDINGS},
}


def check_writer(writer: Writer, value: Any, folder: Path) -> str:
    """Write and read a value; return the refusal, which leaves no file, or an empty text."""
    path = folder / f"value{writer.ending}"
    try:
        writer.save(value, path)
    except InputError as error:
        refusal = str(error)
        assert not list(folder.iterdir())
        assert refusal.isprintable()
        return refusal
    assert [each.name for each in folder.iterdir()] == [path.name]
    assert writer.is_same(writer.load(path, value), value)
    return ""


OURS = ("rig.json", "matches.npz", "rims.npz", "frames.npz", "frames.parquet")


@pytest.mark.parametrize("name", WRITERS)
def test_names_of_cameras_come_back_or_are_refused(name: str, tmp_path: Path) -> None:
    """Files of trinoc refuse none of them."""
    # MATLAB's files are read in a child process each.
    for number, names in enumerate(CAMERA_NAMES[:: 4 if name == "matlab.mat" else 1]):
        folder = tmp_path / str(number) / "inner"
        folder.mkdir(parents=True)
        refusal = check_writer(WRITERS[name], WRITERS[name].make(names), folder)
        assert not refusal or any(f'"{camera}"' in refusal for camera in names), names
        assert not (refusal and name in OURS), names
        assert [each.name for each in folder.parent.iterdir()] == ["inner"], names


def made_wireframe_with(text: str) -> trinoc.match.Wireframe:
    """A wire frame that let go of something for a reason."""
    frame = made_wireframe()
    reasons = np.array([text] * len(frame.let_go.track))
    return dataclasses.replace(frame, let_go=dataclasses.replace(frame.let_go, reason=reasons))


def made_boards_with(text: str) -> BoardSet:
    """A set of two boards, one of them and the set of this name."""
    chessboard = trinoc.Chessboard(rows=5, columns=8, square_mm=10.5, name=text)
    return BoardSet({text: chessboard, f"{text}2": PATTERN}, name=text)


OF_TEXTS = {
    "board.json": Writer(
        lambda text: trinoc.Chessboard(rows=5, columns=8, square_mm=10.5, name=text),
        ".json",
        trinoc.save,
        load_value,
    ),
    "sheet.json": Writer(
        lambda text: dataclasses.replace(PATTERN, name=text), ".json", trinoc.save, load_value
    ),
    "boards.json": Writer(made_boards_with, ".json", trinoc.save, load_value),
    "provenance": Writer(
        lambda text: (bench_rig(), {text: [text]}),
        ".json",
        lambda value, path: trinoc.save(value[0], path, provenance=value[1]),
        load_value,
        lambda read, value: read == value[0],
    ),
    "wireframe.npz": Writer(made_wireframe_with, ".npz", trinoc.save, load_value),
    "notes": Writer(
        lambda text: dataclasses.replace(bench_matches(), notes=(text,)),
        ".npz",
        trinoc.save,
        load_value,
    ),
    "counts": Writer(
        lambda text: dataclasses.replace(bench_matches(), counts={text: 3}),
        ".npz",
        trinoc.save,
        load_value,
    ),
    "marks": Writer(
        lambda text: dataclasses.replace(bench_matches(), marks={text: np.zeros(12)}),
        ".npz",
        trinoc.save,
        load_value,
    ),
    "reasons": Writer(
        lambda text: dataclasses.replace(
            bench_matches(), reasons={v: np.array([text] * 90) for v in bench_matches().views}
        ),
        ".npz",
        trinoc.save,
        load_value,
    ),
    **{
        f"frames{ending}": Writer(
            lambda text: [
                FrameMatches(text, "ok", bench_matches()),
                FrameMatches("1", text or "no picture", None),
            ],
            ending,
            save_frames_with,
            load_frames_of,
        )
        for ending in ((".npz", ".parquet") if HAS_PYARROW else (".npz",))
    },
    "sheet.svg": Writer(
        lambda text: pattern_svg(lay_out(dataclasses.replace(PATTERN, name=text), "a3")),
        ".svg",
        lambda text, path: trinoc.io.atomic.write_text(path, text),
        lambda path, text: ElementTree.parse(path).getroot(),
        lambda read, text: len(list(read.iter())) == text.count("<") - text.count("</"),
    ),
}


@pytest.mark.parametrize("name", OF_TEXTS)
def test_other_texts_come_back_or_are_refused(name: str, tmp_path: Path) -> None:
    """No file holds half a character; a mark is the name of a column."""
    for number, text in enumerate(TEXTS):
        folder = tmp_path / str(number)
        folder.mkdir()
        refusal = check_writer(OF_TEXTS[name], OF_TEXTS[name].make(text), folder)
        is_refused = text == "\ud800" and name != "sheet.svg"
        if name == "marks":
            is_refused = not text.isprintable() or "/" in text
        assert bool(refusal) is is_refused, text
        assert not refusal or "was not written" in refusal


LENS = bench_rig().cameras[0].intrinsics
CAMERAS = dict(bench_rig().items())


def rig_at(distance_mm: float) -> Rig:
    """One camera so far from the sheet."""
    camera = Camera.from_degrees(
        LENS, pan_deg=0.0, tilt_deg=50.0, swing_deg=0.0, distance_mm=distance_mm
    )
    return Rig({"a": camera})


def rig_known_by(parameters: list[str], covariance: np.ndarray) -> Rig:
    """The bench's rig with another covariance."""
    return Rig(CAMERAS, parameters=parameters, covariance=covariance)


PANS = ["upper.pan_deg", "left.pan_deg"]
UNREADABLE = {
    "a negative variance": rig_known_by(PANS, np.diag([1.0, -1.0])),
    "a variance that is not finite": rig_known_by(PANS, np.diag([1.0, np.inf])),
    "a covariance that is not symmetric": rig_known_by(PANS, np.array([[1.0, 0.5], [0.0, 1.0]])),
    "a huge variance": rig_known_by(PANS, np.diag([1.0, 1e80])),
    "a parameter of no camera": rig_known_by(["nobody.pan_deg"], np.eye(1)),
    "a parameter given twice": rig_known_by([PANS[0]] * 2, np.eye(2)),
    "a camera beyond all bounds": rig_at(1e70),
    "a pose that is not finite": Rig({"a": Camera(LENS, Pose(np.full((3, 4), np.nan)))}),
    "a line that is not finite": dataclasses.replace(
        bench_matches(), lines_mm=np.full((12, 2, 3), np.nan)
    ),
    "no probability": dataclasses.replace(bench_matches(), posterior=np.full(12, 2.0)),
    "segments that are not there": dataclasses.replace(
        bench_matches(), index=bench_matches().index + 1000
    ),
    "no covariance of lines": dataclasses.replace(
        bench_matches(), covariance_mm2=-bench_matches().covariance_mm2
    ),
    "a segment beyond all pictures": trinoc.Segments.from_endpoints(np.array([[0, 0, 1e9, 1.0]])),
}


@pytest.mark.parametrize("value", UNREADABLE.values(), ids=UNREADABLE)
def test_a_value_that_no_reader_takes_is_not_written(value: object, tmp_path: Path) -> None:
    ending = ".json" if isinstance(value, Rig) else ".npz"
    with pytest.raises(InputError, match=r"value\.(json|npz) was not written: "):
        trinoc.save(value, tmp_path / f"value{ending}")
    if isinstance(value, Rig):
        for name, target in FORMATS.items():
            if "rig" in target.holds and "covariance" not in target.loses:
                path = tmp_path / f"{name}{target.endings[0]}"
                with pytest.raises(InputError):
                    target.save(value, path)
    assert not list(tmp_path.iterdir())


def test_numbers_that_json_lacks_are_not_written(tmp_path: Path) -> None:
    for provenance in ({"sigma": float("nan")}, {"files": {Path("a")}}):
        with pytest.raises(InputError, match="was not written"):
            trinoc.save(bench_rig(), tmp_path / "rig.json", provenance=provenance)
    with pytest.raises(InputError, match="covariance of the lens is not a covariance"):
        trinoc.io.intrinsics_json.save_intrinsics(
            LENS, tmp_path / "camera.json", covariance=-np.eye(9)
        )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ending", [".json", ".npz"])
def test_a_name_that_is_too_long_for_a_file_is_one_sentence(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"{'x' * 300}{ending}"
    value = bench_rig() if ending == ".json" else bench_matches()
    with pytest.raises(InputError, match="longer than 240 bytes"):
        trinoc.save(value, path)
    with pytest.raises(InputError):
        trinoc.load(path)
    longest = tmp_path / f"{'x' * (240 - len(ending))}{ending}"
    trinoc.save(value, longest)
    assert trinoc.load(longest) == value


def test_a_wire_frame_for_other_programs_says_what_to_give(tmp_path: Path) -> None:
    FORMATS["json"].save(made_wireframe(), tmp_path / "frame.json")
    with pytest.raises(InputError, match=r"give the wireframe\.npz"):
        trinoc.load(tmp_path / "frame.json")


@pytest.mark.parametrize("k1", np.linspace(-0.3, 0.1, 9))
def test_a_lens_that_a_calibration_accepts_is_written_and_read(k1: float, tmp_path: Path) -> None:
    """A fit refuses a distortion that folds the image, as the reader of its file does."""
    lens = Intrinsics(image_size_px=(640, 480), focal_length_px=350.0, distortion=(float(k1),))
    rig = Rig({"a": Camera.from_degrees(lens, pan_deg=0, tilt_deg=40, swing_deg=0, distance_mm=9)})
    failure, _ = assess_folds({"a": lens}, {"a": np.zeros((0, 2))})
    if failure is None:
        trinoc.save(rig, tmp_path / "rig.json")
        assert trinoc.load_rig(tmp_path / "rig.json") == rig
    else:
        assert re.search("folds the image", str(failure))
        with pytest.raises(InputError, match="folds the image"):
            trinoc.save(rig, tmp_path / "rig.json")

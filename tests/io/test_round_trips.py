"""Every field of a value survives writing and reading."""

import dataclasses
import re

import numpy as np
import pytest
from hypothesis import given, settings

import trinoc
from tests.io.made_rims import made_rims
from tests.io.made_wireframe import made_wireframe
from tests.io.strategies import lenses, match_sets, rigs, segment_sets
from tests.io.valid_files import RIG, made_detection, measured
from trinoc.calib.targets.board_set import BoardSet
from trinoc.errors import InputError
from trinoc.io import load_frames, load_intrinsics
from trinoc.io.demo import demo_folder
from trinoc.io.frames_files import save_frames
from trinoc.io.frames_table import Frames
from trinoc.io.saving import _DOCUMENTS, tables
from trinoc.recording.frame_table import OK, FrameMatches
from trinoc.synth.truth import SceneTruth


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("files")


def assert_same(one, other, rtol=0.0):
    """Assert that two values are equal in every field. `rtol` allows for a conversion of units."""
    assert type(one) is type(other)
    if dataclasses.is_dataclass(one):
        for field in dataclasses.fields(one):
            assert_same(getattr(one, field.name), getattr(other, field.name), rtol)
    elif isinstance(one, dict):
        assert list(one) == list(other)
        for key in one:
            assert_same(one[key], other[key], rtol)
    elif isinstance(one, np.ndarray) and one.dtype.kind == "f":
        np.testing.assert_allclose(one, other, rtol=rtol, atol=0)
        assert one.dtype == other.dtype
    elif isinstance(one, np.ndarray):
        np.testing.assert_array_equal(one, other)
    elif isinstance(one, tuple):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_same(a, b, rtol)
    else:
        assert one == other


@given(lens=lenses())
def test_lens(folder, lens):
    trinoc.save(lens, folder / "camera.json")
    assert_same(load_intrinsics(folder / "camera.json"), lens, rtol=1e-15)


@settings(max_examples=20)
@given(rig=rigs())
def test_rig(folder, rig):
    trinoc.save(rig, folder / "rig.json")
    assert_same(trinoc.load_rig(folder / "rig.json"), rig, rtol=1e-15)


@given(segments=segment_sets())
def test_segments(folder, segments):
    trinoc.save(segments, folder / "segments.npz")
    assert_same(trinoc.load_segments(folder / "segments.npz"), segments)


def test_detection(folder):
    detection = made_detection()
    trinoc.save(detection, folder / "detection.npz")
    assert_same(trinoc.load(folder / "detection.npz"), detection)
    assert list(detection.named_columns(brief=True))[:3] == ["circle_index", "u_px", "v_px"]


def test_every_column_of_a_table_is_said_in_its_docstring():
    for kind in (*tables(), Frames):
        listed = re.findall(r"(?m)(?:^|\. )\s*((?:\w+, )*\w+) : ", kind.__doc__ or "")
        names = {name for listing in listed for name in listing.split(", ")}
        assert {field.name for field in dataclasses.fields(kind)} <= names, kind


@given(matches=match_sets())
def test_matches(folder, matches):
    trinoc.save(matches, folder / "matches.npz")
    assert_same(trinoc.load_matches(folder / "matches.npz"), matches)


@settings(max_examples=5)
@given(matches=match_sets())
def test_matches_of_earlier_versions_are_of_noise_as_stated(folder, matches):
    trinoc.save(matches, folder / "matches.npz")
    with np.load(folder / "matches.npz") as file:
        later = "noise_scale", "noise_tail", "notes"
        earlier = {name: file[name] for name in file.files if name not in later}
    np.savez(folder / "earlier.npz", **earlier)
    loaded = trinoc.load_matches(folder / "earlier.npz")
    assert loaded.noise_scale == 1.0
    assert loaded.noise_tail == 0.0
    assert loaded.notes == ()


def test_pattern(folder):
    pattern = trinoc.Pattern.cross_grid(rows=4, columns=6, pitch_mm=20.0, radius_mm=6.0)
    trinoc.save(pattern, folder / "pattern.json")
    assert_same(trinoc.load_pattern(folder / "pattern.json"), pattern)


@given(segments=segment_sets())
def test_segment_tables_are_read_as_their_ends(folder, segments):
    ends = segments.endpoints_px.reshape(-1, 4)
    np.save(folder / "ends.npy", ends)
    np.savetxt(folder / "ends.csv", ends, delimiter=",", header="x1,y1,x2,y2", comments="")
    np.savetxt(folder / "ends.txt", ends, header="x1 y1 x2 y2")
    for name in ("ends.npy", "ends.csv", "ends.txt"):
        np.testing.assert_array_equal(
            trinoc.load_segments(folder / name).endpoints_px, segments.endpoints_px
        )


def test_each_value_has_its_kind_of_file(folder):
    segments = trinoc.Segments.from_endpoints(np.zeros((0, 4)))
    with pytest.raises(InputError, match=r"segments are written as \.npz"):
        trinoc.save(segments, folder / "segments.json")
    with pytest.raises(InputError, match="ndarray cannot be saved"):
        trinoc.save(np.zeros(3), folder / "array.npz")


@settings(max_examples=3)
@given(matches=match_sets())
def test_frames_of_earlier_versions_have_normal_errors(folder, matches):
    matches = dataclasses.replace(
        matches,
        fragments_covariance_px2=np.tile(np.eye(4), (*matches.index.shape, 1, 1)),
        misfit=np.zeros(len(matches)),
        viewpoint_dependent=np.zeros(len(matches), dtype=bool),
    )
    save_frames([FrameMatches("one", OK, matches)], matches.views, folder / "frames.npz")
    for now in load_frames(folder / "frames.npz"):
        assert now.matches is not None
        assert now.matches.noise_tail == matches.noise_tail
    with np.load(folder / "frames.npz") as file:
        earlier = {name: file[name] for name in file.files if name != "noise_tail"}
    np.savez(folder / "earlier.npz", **earlier)
    for then in load_frames(folder / "earlier.npz"):
        assert then.matches is not None
        assert then.matches.noise_tail == 0.0


def made_values(folder):
    """A small value of every kind that `save` takes, and those that it takes from results."""
    pattern = trinoc.Pattern.cross_grid(rows=4, columns=6, pitch_mm=20.0, radius_mm=6.0)
    chessboard = trinoc.Chessboard(rows=5, columns=8, square_mm=10.5)
    return [
        RIG,
        RIG["upper"].intrinsics,
        pattern,
        chessboard,
        BoardSet({"one": chessboard, "two": pattern}),
        trinoc.Segments.from_endpoints(np.arange(8.0).reshape(2, 4) ** 2),
        measured(),
        made_detection(),
        made_wireframe(),
        made_rims(),
    ]


def test_load_gives_back_what_save_wrote_of_every_kind(folder):
    values = made_values(folder)
    for kind in (*(kind for kind, _ in _DOCUMENTS), *tables()):
        assert any(isinstance(value, kind) for value in values), kind
    for number, value in enumerate(values):
        ending = ".npz" if isinstance(value, tuple(tables())) else ".json"
        trinoc.save(value, folder / f"value-{number}{ending}")
        assert_same(trinoc.load(folder / f"value-{number}{ending}"), value, rtol=1e-12)


def test_load_reads_truth_shapes_and_files_of_frames(folder):
    assert isinstance(trinoc.load(demo_folder() / "truth.json"), SceneTruth)
    (folder / "shape.obj").write_text("v 0 0 0\nv 1 0 0\nl 1 2\n")
    assert len(trinoc.load(folder / "shape.obj").edges_mm) == 1
    save_frames([FrameMatches("one", OK, measured())], measured().views, folder / "frames.npz")
    (frame,) = trinoc.load(folder / "frames.npz")
    assert (frame.name, len(frame.matches)) == ("one", len(measured()))


@pytest.mark.parametrize("name", ["notes.json", "notes.npz", "notes.toml", "notes"])
def test_load_names_what_it_reads(name, tmp_path):
    file = tmp_path / name
    file.write_text('{"format": "other"}')
    if name.endswith("npz"):
        np.savez(file, format="other")
    with pytest.raises(InputError, match=r"rig\.json.*board\.json.*matches\.npz.*batch") as caught:
        trinoc.load(file)
    assert "\n" not in str(caught.value)
    for none in (tmp_path / "none.json", tmp_path / "none.npz", tmp_path / "none.toml"):
        with pytest.raises(InputError, match="does not exist"):
            trinoc.load(none)

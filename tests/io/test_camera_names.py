"""Every printable name of a camera survives every file; others are refused where they come in."""

import csv
import importlib.util
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

import trinoc
from tests.io.formats.bench import bench_matches, bench_rig
from trinoc.errors import InputError
from trinoc.geometry.rig import Rig
from trinoc.io.atomic import as_file_name
from trinoc.io.formats.format import Format
from trinoc.io.formats.registry import FORMATS
from trinoc.io.frames_files import load_frames, save_frames
from trinoc.match.tracks.matches import Matches
from trinoc.recording.frame_table import FrameMatches
from trinoc.report.html import render_report

# Three of each, since the bench has three cameras.
HOSTILE = (
    ("realsense/846112073799.png", "a/b/c", "/"),
    ("..\\up", "../up", "C:\\x"),
    ("a=b", "a,b", "a;b"),
    ('"quoted"', "'single'", "`code`"),
    ("links", "größer", "左"),
    ("cam", "cam_segment", "cam.left"),
    (" before", "after ", "in the middle"),
    ("<b>&amp;</b>", "{{ name }}", "%s"),
    ("format", "version", "views"),
    ("index", "reasons/index", "matches/"),
    ("board", "world", "frame"),
    ("-", "--out", "~"),
    ("1", "1.5", "nan"),
    ("x" * 200, "null", "true"),
    ("#", "*", "?"),
)
REFUSED = ("", " ", "\t", "a\nb", ".", "..", "a\x00b", "\ud800", "a\u2028b")


ENDINGS = (".npz", ".parquet") if importlib.util.find_spec("pyarrow") else (".npz",)


def rig_with(names: tuple[str, ...]) -> Rig:
    """The bench's rig under other names, with a covariance."""
    rig = bench_rig()
    parameters = [f"{name}.{key}" for name in names for key in ("pan_deg", "tilt_deg")]
    cameras = dict(zip(names, rig.cameras, strict=True))
    variances = np.arange(1.0, len(parameters) + 1)
    return Rig(cameras, parameters=parameters, covariance=np.diag(variances))


def matches_with(names: tuple[str, ...]) -> Matches:
    """The bench's matches under other names."""
    matches = bench_matches()
    reasons = dict(zip(names, (matches.reasons[v] for v in matches.views), strict=True))
    return replace(matches, views=names, reasons=reasons)


def check_files(names: tuple[str, ...], folder: Path) -> None:
    """Every file of trinoc gives the names back."""
    rig, matches = rig_with(names), matches_with(names)
    trinoc.save(rig, folder / "rig.json", overwrite=True)
    assert trinoc.load_rig(folder / "rig.json") == rig
    trinoc.save(matches, folder / "matches.npz", overwrite=True)
    assert trinoc.load_matches(folder / "matches.npz") == matches
    results = [FrameMatches("0", "ok", matches), FrameMatches("1", "no picture", None)]
    for ending in ENDINGS:
        save_frames(results, names, folder / f"frames{ending}")
        again = load_frames(folder / f"frames{ending}")
        assert again[0].matches == matches
        assert [each.name for each in again] == ["0", "1"]


@pytest.mark.parametrize("names", HOSTILE, ids=lambda names: names[0][:12])
def test_a_hostile_name_survives_every_file(names: tuple[str, ...], tmp_path: Path) -> None:
    check_files(names, tmp_path)


PRINTABLE = st.text(st.characters(exclude_categories=["C", "Z"], include_characters=" "))
NAMES = st.lists(
    PRINTABLE.filter(lambda name: name.strip() and name not in (".", "..")),
    min_size=3,
    max_size=3,
    unique=True,
)


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(names=NAMES)
def test_any_printable_name_survives_every_file(names: list[str], tmp_path: Path) -> None:
    check_files(tuple(names), tmp_path)


def refusal_of(target: Format, rig: Rig, place: Path) -> str:
    """Why a format does not take a rig; empty where it was written."""
    try:
        target.save(rig, place)
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("names", HOSTILE, ids=lambda names: names[0][:12])
def test_another_tool_s_file_keeps_a_name_or_refuses_it(
    names: tuple[str, ...], tmp_path: Path
) -> None:
    """No format changes a name in silence, and none writes outside its place."""
    rig = rig_with(names)
    inner = tmp_path / "inner"
    inner.mkdir()
    lenses = {name: camera.intrinsics for name, camera in rig.items()}
    kept = []
    for name, target in FORMATS.items():
        if "rig" not in target.holds or "names of the cameras" in " ".join(target.lost(rig)):
            continue
        ending = target.endings[0] if target.place == "file" else ""
        refusal = refusal_of(target, rig, inner / f"{name}{ending}")
        if refusal:
            assert any(camera in refusal for camera in names)
            assert refusal.isprintable()
            continue
        again = target.load(inner / f"{name}{ending}", lenses=lenses if name == "tf" else None)
        assert set(again.names) == set(names), name
        kept.append(name)
    assert "matlab" in kept
    assert [place.name for place in tmp_path.iterdir()] == ["inner"]


@pytest.mark.parametrize("names", HOSTILE, ids=lambda names: names[0][:12])
def test_reports_and_exports_of_matches_take_any_name(
    names: tuple[str, ...], tmp_path: Path
) -> None:
    rig, matches = rig_with(names), matches_with(names)
    page = render_report(rig=rig, matches=matches)
    assert "<b>&amp;</b>" not in page
    for name, target in FORMATS.items():
        if "matches" in target.holds and (name != "parquet" or ".parquet" in ENDINGS):
            target.save(matches, tmp_path / f"{name}{target.endings[0] if target.endings else ''}")
    with open(tmp_path / "csv.csv", encoding="utf-8", newline="") as file:
        head = next(csv.reader(file))
    assert [f"{name}_segment" for name in names] == [c for c in head if c.endswith("_segment")]


@pytest.mark.parametrize("name", REFUSED, ids=ascii)
def test_a_name_that_cannot_be_shown_is_refused_where_it_comes_in(
    name: str, tmp_path: Path
) -> None:
    camera = bench_rig().cameras[0]
    with pytest.raises(InputError, match="A camera is named") as caught:
        Rig({name: camera})
    assert str(caught.value).isprintable()
    picture, sheet = np.zeros((480, 512), np.uint8), trinoc.Pattern.default()
    with pytest.raises(InputError, match="A camera is named"):
        trinoc.calibrate({name: picture}, sheet, camera.intrinsics)
    with pytest.raises(InputError, match="A camera is named"):
        trinoc.calibrate_rig({name: [picture]}, sheet)
    trinoc.save(bench_rig(), tmp_path / "rig.json")
    document = json.loads((tmp_path / "rig.json").read_text(encoding="utf-8"))
    document["cameras"] = {name: next(iter(document["cameras"].values()))}
    document.pop("covariance", None)
    (tmp_path / "rig.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"rig\.json") as caught:
        trinoc.load_rig(tmp_path / "rig.json")
    assert str(caught.value).isprintable()
    if name != "\ud800":
        views = (name, *bench_matches().views[1:])
        trinoc.save(matches_with(views), tmp_path / "matches.npz")
        with pytest.raises(InputError, match='"views" must be names of printable characters'):
            trinoc.load_matches(tmp_path / "matches.npz")


@given(names=NAMES)
def test_names_of_files_stay_in_their_folder_and_apart(names: list[str]) -> None:
    files = [as_file_name(name) for name in names]
    assert len(set(files)) == len(names)
    for file in files:
        assert Path(file).name == file
        assert not re.search(r'[/\\:*?"<>|]', file)
        assert file.strip(". ") == file

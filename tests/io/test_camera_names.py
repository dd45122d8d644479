"""Every printable name of a camera survives every file; others are refused where they come in."""

import csv
import importlib.util
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

import trinoc
from tests.io.formats.bench import bench_matches, bench_rig
from tests.io.test_hostile_names import CAMERA_NAMES, matches_with, rig_with
from trinoc.errors import InputError
from trinoc.geometry.rig import Rig
from trinoc.io.arrays_npz import write_arrays
from trinoc.io.atomic import as_file_name
from trinoc.io.formats.registry import FORMATS
from trinoc.io.frames_files import load_frames, save_frames
from trinoc.io.tables_npz import list_arrays
from trinoc.recording.frame_table import FrameMatches
from trinoc.report.html import render_report

REFUSED = ("", " ", "\t", "a\nb", ".", "..", "a\x00b", "\ud800", "a\u2028b")


ENDINGS = (".npz", ".parquet") if importlib.util.find_spec("pyarrow") else (".npz",)


def check_files(names: tuple[str, ...], folder: Path) -> None:
    """Assert that every file format of trinoc returns the camera names unchanged."""
    rig, matches = rig_with(names), matches_with(names)
    trinoc.save(rig, folder / "rig.json", overwrite=True)
    assert trinoc.load_rig(folder / "rig.json") == rig
    trinoc.save(matches, folder / "matches.npz", overwrite=True)
    assert trinoc.load_matches(folder / "matches.npz") == matches
    results = [FrameMatches("0", "ok", matches), FrameMatches("1", "no picture", None)]
    for ending in ENDINGS:
        save_frames(results, names, folder / f"frames{ending}")
        loaded = load_frames(folder / f"frames{ending}")
        assert loaded[0].matches == matches
        assert [frame.name for frame in loaded] == ["0", "1"]


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


@pytest.mark.parametrize("names", CAMERA_NAMES, ids=lambda names: names[0][:12])
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
    with pytest.raises(InputError, match="is not allowed") as caught:
        Rig({name: camera})
    assert str(caught.value).isprintable()
    picture, sheet = np.zeros((480, 512), np.uint8), trinoc.Pattern.default()
    with pytest.raises(InputError, match="is not allowed"):
        trinoc.calibrate({name: picture}, sheet, camera.intrinsics)
    with pytest.raises(InputError, match="is not allowed"):
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
        problem = '"views" must be names of printable characters'
        with pytest.raises(InputError, match=problem):
            trinoc.save(matches_with(views), tmp_path / "matches.npz")
        arrays = list_arrays(matches_with(views))
        write_arrays(
            tmp_path / "matches.npz",
            "trinoc-matches",
            1,
            {key: array for key, array in arrays.items() if key.isprintable()},
        )
        with pytest.raises(InputError, match=problem):
            trinoc.load_matches(tmp_path / "matches.npz")


@given(names=NAMES)
def test_names_of_files_stay_in_their_folder_and_apart(names: list[str]) -> None:
    files = [as_file_name(name) for name in names]
    assert len(set(files)) == len(names)
    for file in files:
        assert Path(file).name == file
        assert not re.search(r'[/\\:*?"<>|]', file)
        assert file.strip(". ") == file

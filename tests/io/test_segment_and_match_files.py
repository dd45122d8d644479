"""Readers of segment and match files refuse bad fields in a sentence that names the field."""

import dataclasses

import numpy as np
import pytest

import trinoc
from trinoc.errors import InputError
from trinoc.geometry import Junctions
from trinoc.geometry.segments import Segments
from trinoc.io.saving import load_matches
from trinoc.io.segment_table import load_segments

ENDS = np.array([[10.0, 20, 30, 40], [50, 60, 70, 90]])


def refused(load, path, sentence):
    with pytest.raises(InputError, match=sentence) as caught:
        load(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", ["npy", "csv", "npz"])
def test_nan_is_named_by_file_and_segment(tmp_path, suffix):
    path = tmp_path / f"ends.{suffix}"
    broken = ENDS.copy()
    broken[1, 2] = np.nan
    if suffix == "npy":
        np.save(path, broken)
    elif suffix == "csv":
        np.savetxt(path, broken, delimiter=",")
    else:
        trinoc.save(Segments.from_endpoints(ENDS), path)
        arrays = {**np.load(path), "endpoints_px": broken.reshape(-1, 2, 2)}
        np.savez(path, **arrays)
    row = "Segment 1 has a coordinate" if suffix != "npz" else '"endpoints_px" of row 1'
    refused(load_segments, path, f"{row}( that)? is not finite")


def test_tables_of_another_kind_are_refused(tmp_path):
    text = tmp_path / "ends.txt"
    for content, sentence in [
        ("1 2 3\n4 5 6\n", r"shape \(2, 3\), but must be \(n, 4\)"),
        ("1 2 3 4\n5 6\n", "not a table of numbers"),
        ("1 2 3 4\n1 2 x 4\n", "not a table of numbers"),
        ("1 2 1 2\n", "two equal ends"),
    ]:
        text.write_text(content)
        refused(load_segments, text, sentence)
    np.save(tmp_path / "ends.npy", np.array(["a"]))
    refused(load_segments, tmp_path / "ends.npy", "not a table of numbers")
    refused(load_segments, tmp_path / "none.csv", "does not exist")


def test_archives_of_another_kind_are_refused(tmp_path):
    path = tmp_path / "file.npz"
    for load in (load_segments, load_matches):
        refused(load, tmp_path / "none.npz", "does not exist")
        path.write_bytes(b"PK no archive")
        refused(load, path, "not a readable npz")
        path.write_bytes(b"")
        refused(load, path, "not a readable npz")
        np.savez(path, pickled=np.array([{"a": 1}], dtype=object))
        refused(load, path, "not a readable npz")
        np.savez(path, endpoints=ENDS)
        refused(load, path, 'has the format ""')
    trinoc.save(Segments.from_endpoints(ENDS), path, overwrite=True)
    refused(load_matches, path, '"trinoc-segments", but "trinoc-matches" is needed')
    arrays = dict(np.load(path))
    np.savez(path, **{**arrays, "version": np.array(2)})
    refused(load_segments, path, "version 2")
    np.savez(path, **{**arrays, "polarity": np.zeros(3)})
    refused(load_segments, path, '"polarity" has shape')
    del arrays["support"]
    np.savez(path, **arrays)
    refused(load_segments, path, 'lacks the array "support"')


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("chain", np.zeros(3, int), '"chain" has shape'),
        ("reasons", np.array(["bent"]), '"reasons" has shape'),
        ("junctions/segment", np.array([0, 2]), "name a segment that is not there"),
        ("junctions/junction", np.array([0, 1]), "is no junction"),
        ("junctions/end", np.array([0, 2]), "is neither end nor body"),
        ("junctions/kind", np.array(["Z"]), "is no L, T, X or Y"),
        ("junctions/uv_px", np.array([[1.0, np.nan]]), "is not finite or beyond all pictures"),
        ("junctions/covariance_px2", np.eye(2), "1 junctions need"),
        ("junctions/end", None, 'lacks the array "junctions/end"'),
    ],
)
def test_what_does_not_fit_the_segments_is_refused(tmp_path, name, value, sentence):
    path = tmp_path / "segments.npz"
    plain = Segments.from_endpoints(ENDS)
    rows = np.array([0, 1])
    junctions = Junctions(np.ones((1, 2)), np.eye(2)[None], np.array(["L"]), 0 * rows, rows, rows)
    segments = Segments(
        plain.endpoints_px,
        plain.covariance_px2,
        plain.polarity,
        plain.contrast,
        plain.support,
        None,
        np.array(["", "bent"]),
        rows,
        junctions,
    )
    trinoc.save(segments, path)
    arrays = dict(np.load(path))
    if value is None:
        del arrays[name]
    else:
        arrays[name] = value
    np.savez(path, **arrays)
    refused(load_segments, path, sentence)


def test_files_without_the_optional_fields_are_read(tmp_path):
    path = tmp_path / "segments.npz"
    trinoc.save(Segments.from_endpoints(ENDS), path)
    assert not any(name.startswith(("junctions", "chain", "reasons")) for name in np.load(path))
    segments = load_segments(path)
    assert segments.reasons is None
    assert segments.chain is None
    assert segments.junctions is None
    assert segments.side_levels is None


def test_levels_beside_segments_are_kept_and_must_fit(tmp_path):
    path = tmp_path / "segments.npz"
    plain = Segments.from_endpoints(ENDS)
    levels = np.array([[10.0, 200.0], [np.nan, np.nan]])
    trinoc.save(dataclasses.replace(plain, side_levels=levels), path)
    np.testing.assert_array_equal(load_segments(path).side_levels, levels)
    arrays = dict(np.load(path))
    arrays["side_levels"] = levels[:, 0]
    np.savez(path, allow_pickle=False, **arrays)
    refused(load_segments, path, '"side_levels" has shape')

"""Variables of .mat files, and damaged files that crash the library that reads them."""

import numpy as np
import pytest
import scipy.io
from hypothesis import example, given, settings, strategies as st

from trinoc.errors import InputError
from trinoc.io.formats.mat_file import mat_variables

KINDS = ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "?")


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_numbers_of_every_type_are_read(kind, compressed, tmp_path):
    matrix = np.arange(6).reshape(2, 3).astype(kind)
    variables = {"a": matrix, "a_longer_name": matrix[:1, :1], "nothing": np.zeros((0, 2))}
    scipy.io.savemat(tmp_path / "v.mat", variables, do_compression=compressed)
    read = mat_variables(tmp_path / "v.mat")
    assert list(read) == list(variables)
    assert read["a"] == matrix.astype(float).tolist()
    assert read["a_longer_name"] == [[0.0]]
    assert read["nothing"] == []


@pytest.mark.parametrize("compressed", [False, True])
def test_structs_cells_and_texts_are_read(compressed, tmp_path):
    inner = {"name": "é, in mm", "K": np.eye(3)}
    cell = np.array(["one", "été", "a longer text"], dtype=object)
    variables = {"s": {"inner": inner, "ok": True}, "c": cell, "empty": ""}
    scipy.io.savemat(tmp_path / "v.mat", variables, do_compression=compressed)
    read = mat_variables(tmp_path / "v.mat")
    assert read["s"] == {"inner": {"name": "é, in mm", "K": np.eye(3).tolist()}, "ok": [[1.0]]}
    assert read["c"] == list(cell)
    assert read["empty"] == ""


def test_what_no_calibration_holds_is_none(tmp_path):
    structs = np.zeros((1, 2), dtype=[("a", "O")])
    structs["a"] = 1.0
    variables = {"z": np.array([[1j]]), "many": structs, "cube": np.zeros((2, 2, 2)), "k": 5.0}
    scipy.io.savemat(tmp_path / "v.mat", variables)
    read = mat_variables(tmp_path / "v.mat")
    assert read["k"] == [[5.0]]
    assert [read.get(name) for name in ("z", "many", "cube")] == [None] * 3


@pytest.mark.parametrize("start", [b"MATLAB 7.3 MAT-file", b"\x89HDF\r\n", b"text", b""])
def test_other_files_are_refused(start, tmp_path):
    (tmp_path / "v.mat").write_bytes(start.ljust(200 if start else 0))
    with pytest.raises(InputError, match="-v7"):
        mat_variables(tmp_path / "v.mat")


def test_a_file_that_unpacks_to_too_much_is_refused(tmp_path):
    zeros = np.zeros((9_000_000, 1))
    scipy.io.savemat(tmp_path / "v.mat", {"a": zeros}, do_compression=True)
    with pytest.raises(InputError, match="unpacks to more"):
        mat_variables(tmp_path / "v.mat")


@settings(max_examples=12)
@given(offset=st.integers(0, 10**6), byte=st.integers(0, 255), cut=st.integers(0, 10**6))
@example(offset=0, byte=0, cut=0)
def test_a_damaged_file_is_read_or_refused(offset, byte, cut, tmp_path_factory):
    folder = tmp_path_factory.mktemp("mat")
    variables = {"s": {"K": np.eye(3), "names": np.array(["a", "b"], dtype=object)}, "t": "text"}
    scipy.io.savemat(folder / "v.mat", variables)
    content = bytearray((folder / "v.mat").read_bytes())
    content[offset % len(content)] = byte
    (folder / "v.mat").write_bytes(content[: len(content) - cut % len(content) * (cut % 2)])
    try:
        read = mat_variables(folder / "v.mat")
    except InputError as error:
        problem = str(error)
    else:
        assert isinstance(read, dict)
        return
    assert "\n" not in problem

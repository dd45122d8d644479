"""Any damage to any kind of file ends in one sentence, or loads: never in another exception."""

import dataclasses
import io
import json
import resource
import struct
import zipfile
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

import trinoc
from trinoc.errors import InputError
from trinoc.io import load_intrinsics, load_shape, read_image
from trinoc.io.rig_json import load_rig_status
from trinoc.synth import table1_rig

FEW = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
# What a hand, a program or a bit of bad luck puts where something else should stand.
ODD = st.sampled_from(
    [
        *(
            None,
            True,
            "",
            "x",
            "\n",
            [],
            {},
            [[]],
            [1, [2]],
            0,
            -1,
            2.5,
            1e300,
            -1e300,
            1e-300,
            9e59,
        ),
        *(10**400, "</script>", [1e300] * 3, {"a": {}}, [None], ["a", 1], "\ud800", "__class__"),
    ]
)
NOT_JSON = ["NaN", "Infinity", "1" * 5000, "[" * 70 + "]" * 70, "[" * 100_000, '{"a":1,"a":2}']


def sentence_or_value(load, path):
    """Load a file. An error must be one line that names the file."""
    try:
        return load(path)
    except InputError as error:
        refusal = str(error)
    assert "\n" not in refusal
    assert path.name in refusal
    return None


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("damaged")


def key_paths(value, path=()):
    """Yield the key path of every node in a JSON value, from the outside in."""
    yield path
    if isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from key_paths(item, (*path, key))


def put(value, path, new):
    """A copy of the JSON value with the node at a key path replaced."""
    if not path:
        return new
    copy = dict(value) if isinstance(value, dict) else list(value)
    copy[path[0]] = put(value[path[0]], path[1:], new)
    return copy


@pytest.fixture(scope="module")
def documents(folder):
    """The text of a file of each kind of JSON, with its reader."""
    rig = table1_rig()
    rig = trinoc.Rig(
        dict(rig.items()), parameters=("upper.pan_deg", "left.pan_deg"), covariance=np.eye(2)
    )
    pattern = trinoc.Pattern.cross_grid(rows=2, columns=2, pitch_mm=20.0, radius_mm=6.0)
    readers = {"rig": trinoc.load_rig, "camera": load_intrinsics}
    readers |= {"pattern": trinoc.load_pattern}
    for kind, value in (("rig", rig), ("camera", rig["upper"].intrinsics), ("pattern", pattern)):
        trinoc.save(value, folder / f"{kind}.json", provenance={"command": "c"})
    return {
        kind: (json.loads((folder / f"{kind}.json").read_text()), reader)
        for kind, reader in readers.items()
    }


@FEW
@given(data=st.data(), kind=st.sampled_from(["rig", "camera", "pattern"]))
def test_json_with_another_value_somewhere(folder, documents, data, kind):
    document, load = documents[kind]
    keys = data.draw(st.sampled_from(list(key_paths(document))))
    path = folder / "damaged.json"
    path.write_text(json.dumps(put(document, keys, data.draw(ODD))))
    for reader in (load, trinoc.load, load_shape, load_rig_status):
        sentence_or_value(reader, path)


@FEW
@given(data=st.data(), kind=st.sampled_from(["rig", "camera", "pattern"]))
def test_json_with_other_bytes(folder, documents, data, kind):
    document, load = documents[kind]
    content = json.dumps(document).encode()
    start = data.draw(st.integers(0, len(content)))
    stop = data.draw(st.integers(start, min(start + 30, len(content))))
    path = folder / "damaged.json"
    path.write_bytes(content[:start] + data.draw(st.binary(max_size=20)) + content[stop:])
    sentence_or_value(load, path)
    path.write_bytes(content[:start])
    sentence_or_value(load, path)


@pytest.mark.parametrize("text", NOT_JSON)
@pytest.mark.parametrize("load", [trinoc.load_rig, trinoc.load_pattern, trinoc.load, load_shape])
def test_json_that_python_would_read_or_fall_over(folder, load, text):
    path = folder / "extreme.json"
    for content in (text, f'{{"format": {text}, "version": 1}}'):
        path.write_text(content)
        assert sentence_or_value(load, path) is None


def test_a_byte_order_mark_is_read_over(folder, documents):
    path = folder / "bom.json"
    path.write_text(json.dumps(documents["rig"][0]), encoding="utf-8-sig")
    assert trinoc.load_rig(path).names == table1_rig().names


@pytest.fixture(scope="module")
def archives(folder):
    """The arrays of a file of segments and of one of matches, with their readers."""
    random = np.random.default_rng(5)
    segments = trinoc.Segments.from_endpoints(random.uniform(0, 400, (3, 4)))
    trinoc.save(segments, folder / "segments.npz")
    views, tracks = ("upper", "left", "right"), 2
    root = random.normal(size=(tracks, 6, 6))
    matches = trinoc.Matches(
        views=views,
        index=np.array([[0, 1, 2], [1, -1, 0]]),
        fragments_px=np.where(
            np.array([[1, 1, 1], [1, np.nan, 1]])[..., None, None],
            random.uniform(0, 400, (tracks, 3, 2, 2)),
            0,
        ),
        lines_mm=random.normal(size=(tracks, 2, 3)),
        covariance_mm2=root @ root.transpose(0, 2, 1),
        stage=np.array(["trinocular", "binocular"]),
        posterior=np.array([0.9, 0.8]),
        rival_posterior=np.array([0.1, 0.0]),
        reasons={view: np.array(["matched"] * 3) for view in views},
        counts={"candidates": 4},
        misfit=np.array([1.0, 0.0]),
    )
    hidden = np.array([[False] * 3, [False, True, False]])[..., None, None]
    shown = np.where(hidden, np.nan, matches.fragments_px)
    matches = dataclasses.replace(matches, fragments_px=shown)
    trinoc.save(matches, folder / "matches.npz")
    archives_by_kind = {}
    for kind, load in (("segments", trinoc.load_segments), ("matches", trinoc.load_matches)):
        assert len(load(folder / f"{kind}.npz")) > 0
        with np.load(folder / f"{kind}.npz") as file:
            archives_by_kind[kind] = dict(file), load
    return archives_by_kind


DAMAGE = [
    lambda a: a.astype(str),
    lambda a: a.astype(complex) if a.dtype.kind in "iuf" else a[None],
    lambda a: np.full(a.shape, np.nan),
    lambda a: np.full(a.shape, np.inf),
    lambda a: -a if a.dtype.kind in "if" else a[..., None],
    lambda a: a + 1000 if a.dtype.kind in "iuf" else a,
    lambda a: a.ravel(),
    lambda a: a[:0] if a.ndim else a[None],
    lambda a: np.stack([a, a]),
    lambda a: a.astype(">f8") if a.dtype.kind in "if" else a,
    lambda a: np.asfortranarray(a),
    lambda a: np.zeros(a.shape, np.uint64) + np.uint64(2**63),
    lambda a: np.zeros(a.shape, np.bool_),
    lambda a: np.zeros(a.shape, "S3"),
    lambda a: np.zeros(a.shape, "M8[s]"),
    lambda a: np.zeros(a.shape, [("x", "f8")]),
    lambda a: np.full(a.shape, None, dtype=object),
    lambda a: np.zeros(a.shape, "f4") * 1e-30,
    lambda a: np.array("x"),
    lambda a: np.array(1e308),
]


@pytest.mark.parametrize("kind", ["segments", "matches"])
@pytest.mark.parametrize("damage", DAMAGE)
def test_npz_with_another_array(folder, archives, kind, damage):
    arrays, load = archives[kind]
    path = folder / "damaged.npz"
    for name in arrays:
        with np.errstate(all="ignore"):
            np.savez(path, **{**arrays, name: damage(arrays[name])})
        sentence_or_value(load, path)
        np.savez(path, **{other: array for other, array in arrays.items() if other != name})
        sentence_or_value(load, path)


@FEW
@given(data=st.data(), kind=st.sampled_from(["segments", "matches"]))
def test_npz_with_other_bytes(folder, archives, data, kind):
    content = (folder / f"{kind}.npz").read_bytes()
    offset = data.draw(st.integers(0, len(content) - 1))
    path = folder / "damaged.npz"
    new = data.draw(st.binary(min_size=1, max_size=4))
    for damaged in (content[:offset], content[:offset] + new + content[offset + len(new) :]):
        path.write_bytes(damaged)
        sentence_or_value(archives[kind][1], path)
        sentence_or_value(trinoc.load, path)


@FEW
@given(header=st.binary(max_size=80), rest=st.binary(max_size=80), version=st.integers(0, 3))
def test_npy_with_any_header(folder, header, rest, version):
    path = folder / "damaged.npy"
    size = struct.pack("<H" if version < 2 else "<I", len(header))
    path.write_bytes(b"\x93NUMPY" + bytes([version, 0]) + size + header + rest)
    sentence_or_value(trinoc.load_segments, path)


@pytest.mark.parametrize(
    ("field", "damage", "message"),
    [
        ("index", lambda a: a + 1000, '"index" of row 0 names a segment that is not there'),
        ("covariance_mm2", lambda a: -a, '"covariance_mm2" of row 0 is no covariance'),
        ("posterior", lambda a: a - 1, '"posterior" of row 0 is no probability'),
        ("lines_mm", lambda a: a.astype(complex), "must be real numbers, but is complex128"),
        ("lines_mm", lambda a: a.astype(str), "must be real numbers"),
        ("fragments_px", lambda a: np.nan_to_num(a), "one where none is"),
        ("views", lambda a: a[[0, 0, 2]], "two or more different"),
    ],
)
def test_what_no_matching_gives_is_named_by_field_and_row(folder, archives, field, damage, message):
    arrays, load = archives["matches"]
    path = folder / "wrong.npz"
    np.savez(path, **{**arrays, field: damage(arrays[field])})
    with pytest.raises(InputError, match=r"wrong\.npz") as caught:
        load(path)
    assert message in str(caught.value)


def test_an_archive_that_announces_or_unpacks_to_gigabytes_takes_no_memory(folder):
    head = io.BytesIO()
    shape = (50_000, 50_000)
    np.lib.format.write_array_header_1_0(
        head, {"descr": "<f8", "fortran_order": False, "shape": shape}
    )
    path = folder / "bomb.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("format.npy", head.getvalue())
    for load in (trinoc.load_matches, trinoc.load_segments, trinoc.load):
        assert sentence_or_value(load, path) is None
    (folder / "bomb.npy").write_bytes(head.getvalue())
    assert sentence_or_value(trinoc.load_segments, folder / "bomb.npy") is None


@FEW
@given(text=st.text(st.sampled_from("0123456789.,;- \n\te#xnaif"), max_size=60))
def test_tables_of_any_text(folder, text):
    path = folder / "damaged.csv"
    path.write_text(text)
    segments = sentence_or_value(trinoc.load_segments, path)
    if segments is not None and any(line.partition("#")[0].strip() for line in text.splitlines()):
        assert len(segments) > 0
    sentence_or_value(load_shape, path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b,c,d\n", "line 1, names the columns a, b, c, d, which do not give the ends"),
        ("1,5;2,5;3,5;4,5\n", "line 1, has numbers with a decimal comma"),
        ("1,5 2,5 3 4,5\n", "line 1, has numbers with a decimal comma"),
        ("x1,y1,x2,y2\n1,2,3,4\n5,6,seven,8\n", "line 3, is not a table of numbers"),
        ("-1e9,5,1e9,5\n", "outside any picture"),
    ],
)
def test_words_and_decimal_commas_are_named(folder, text, message):
    path = folder / "words.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        trinoc.load_segments(path)


@pytest.fixture(scope="module")
def pictures():
    """A small picture in each kind of file."""
    image = np.random.default_rng(3).integers(0, 256, (20, 30), np.uint8)
    kinds = ("png", "tif", "jpg", "bmp", "pgm", "webp")
    return {kind: cv2.imencode(f".{kind}", image)[1].tobytes() for kind in kinds}


@FEW
@given(data=st.data(), kind=st.sampled_from(["png", "tif", "jpg", "bmp", "pgm", "webp"]))
def test_pictures_with_other_bytes(folder, pictures, data, kind):
    content = pictures[kind]
    path = folder / f"damaged.{kind}"
    path.write_bytes(content)
    assert read_image(path).shape[:2] == (20, 30)
    offset = data.draw(st.integers(0, min(len(content), 200) - 1))
    new = data.draw(st.binary(min_size=1, max_size=4))
    for damaged in (content[:offset], content[:offset] + new + content[offset + len(new) :]):
        path.write_bytes(damaged)
        sentence_or_value(read_image, path)


@pytest.mark.parametrize(
    ("offset", "announced"), [(16, 14_000), (33, 0xFFFFFFF0)], ids=["size", "chunk"]
)
def test_a_picture_that_announces_more_than_it_holds_takes_no_memory(folder, offset, announced):
    content = cv2.imencode(".png", np.zeros((14_000, 64), np.uint8))[1].tobytes()
    file = folder / "short.png"
    file.write_bytes(content[:offset] + struct.pack(">I", announced) + content[offset + 4 :])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match="is incomplete or states a wrong size"):
        read_image(file)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000


def test_what_deflates_best_is_no_picture_too_short(folder):
    flat = np.zeros((3000, 4000, 3), np.uint16)
    file = folder / "flat.png"
    cv2.imwrite(str(file), flat, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    assert read_image(file).shape == flat.shape


def test_a_picture_that_announces_gigabytes_is_refused_by_its_header(folder):
    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = struct.pack(">IIBBBBB", 30_000, 30_000, 8, 0, 0, 0, 0)
    path = folder / "bomb.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", b""))
    with pytest.raises(InputError, match="announces more pixels than any camera has"):
        read_image(path)


@pytest.mark.parametrize("damage", ["fold", "far focus", "near focus", "micrometres", "one place"])
def test_cameras_that_cannot_be_are_refused(folder, documents, damage):
    document = json.loads(json.dumps(documents["rig"][0]))
    upper = document["cameras"]["upper"]
    lens = upper["intrinsics"]
    messages = {"micrometres": "micrometres: write 0.01", "fold": "folds the image"}
    match damage:
        case "fold":
            distortion = {"model": "brown_conrady", "coefficients": [-50, 0, 0, 0, 0]}
            lens["distortion"] = distortion
        case "far focus":
            lens["focal_length_mm"] = 1e300
        case "near focus":
            lens["focal_length_mm"] = 1e-300
        case "micrometres":
            lens["pixel_pitch_mm"] = [16.2, 13.4]
        case _:
            document["cameras"]["left"] = {k: v for k, v in upper.items() if k != "sigma"}
            messages = {damage: "have the same position"}
    path = folder / "impossible.json"
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=messages.get(damage, "focal.length")):
        trinoc.load_rig(path)

"""A rig that is written and read projects the same points to the same pixels."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tests.geometry.strategies import real
from tests.io.formats.bench import bench_rig
from tests.io.formats.strategies import CORNERS, in_frame_of, lenses, pixels, rigs
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.io import FORMATS
from trinoc.io.formats.format import LENSES, NAMES, WORLD

SAME = {"rtol": 0, "atol": 1e-9}
# What differs from a rig of one to four cameras with five coefficients and no skew.
RIGS = {"kalibr": rigs(coefficients=4), "matlab": rigs(skew=True, min_cameras=2)}
OF_CAMERAS = [n for n, each in FORMATS.items() if "rig" in each.reads and "rig" in each.holds]
# The same file by another ending, .yaml for .yml, is not another test.
ENDINGS = [
    (name, ending)
    for name in OF_CAMERAS
    for ending in (FORMATS[name].endings if FORMATS[name].place == "file" else ("",))
    if ending != ".yaml" or ".yml" not in FORMATS[name].endings
]


@pytest.mark.parametrize(("name", "ending"), ENDINGS)
@settings(max_examples=6)
@given(data=st.data())
def test_a_rig_comes_back(name, ending, data):
    form = FORMATS[name]
    rig = data.draw(RIGS.get(name, rigs()))
    unit_mm = None if form.unit_is_fixed else data.draw(real(0.1, 1000))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"rig{ending}"
        form.save(rig, path, unit_mm=unit_mm)
        lens_by_name = {camera_name: camera.intrinsics for camera_name, camera in rig.items()}
        lens_of = lens_by_name if LENSES in form.loses else None
        names = rig.names if NAMES in form.loses else None
        loaded = form.load(path, unit_mm=unit_mm, lenses=lens_of, names=names)
    assert isinstance(loaded, Rig)
    assert set(loaded.names) == set(rig.names)
    if name != "mrcal":  # whose folder has no order
        assert loaded.names == rig.names
    world = in_frame_of(rig.cameras[0]) if WORLD in form.loses else CORNERS
    for camera_name, camera in rig.items():
        assert loaded[camera_name].image_size_px == camera.image_size_px
        np.testing.assert_allclose(pixels(loaded[camera_name], world), pixels(camera), **SAME)


@pytest.mark.parametrize("name", ["opencv", "matlab"])
@pytest.mark.parametrize("cameras", [2, 3])
def test_a_covariance_comes_back_where_there_is_room_for_it(name, cameras, tmp_path):
    form, rig = FORMATS[name], bench_rig(cameras=cameras)
    root = np.random.default_rng(3).normal(size=(cameras, cameras))
    rig = Rig(dict(rig.items()), parameters=rig.parameters, covariance=root @ root.T)
    for ending in form.endings:
        form.save(rig, tmp_path / f"rig{ending}")
        loaded = form.load(tmp_path / f"rig{ending}")
        assert loaded.parameters == rig.parameters
        np.testing.assert_array_equal(loaded.covariance, rig.covariance)
        renamed = form.load(tmp_path / f"rig{ending}", names=("a", "b", "c")[:cameras])
        assert renamed.parameters == tuple(
            f"{camera_name}.pan_deg" for camera_name in renamed.names
        )


ANY_NAME = st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1, max_size=9).filter(
    lambda name: name.isprintable() and name.strip()
)


@pytest.mark.parametrize("ending", [".yml", ".json"])
@settings(max_examples=12)
@given(names=st.lists(ANY_NAME, min_size=3, max_size=3, unique=True))
def test_any_printable_name_comes_back_from_opencv(ending, names):
    rig = Rig(dict(zip(names, bench_rig(cameras=3).cameras, strict=True)))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"rig{ending}"
        FORMATS["opencv"].save(rig, path)
        assert FORMATS["opencv"].load(path).names == tuple(names)


@settings(max_examples=10)
@given(rig=rigs(coefficients=0))
def test_cameras_that_were_matrices_have_no_skew_to_refuse(rig):
    """Taking a matrix apart leaves a skew of rounding errors."""
    refactored = Rig.from_matrices(
        {name: 3.7 * camera.matrix_px for name, camera in rig.items()},
        {name: camera.image_size_px for name, camera in rig.items()},
    )
    with tempfile.TemporaryDirectory() as folder:
        FORMATS["colmap"].save(refactored, Path(folder) / "rig")
        loaded = FORMATS["colmap"].load(Path(folder) / "rig")
    for name, camera in rig.items():
        np.testing.assert_allclose(pixels(loaded[name]), pixels(camera), rtol=0, atol=1e-8)


@pytest.mark.parametrize("name", [n for n, each in FORMATS.items() if "lens" in each.reads])
@settings(max_examples=6)
@given(lens=lenses())
def test_a_lens_comes_back(name, lens):
    form = FORMATS[name]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"camera{form.endings[0]}"
        form.save(lens, path)
        loaded = form.load(path)
    assert loaded.image_size_px == lens.image_size_px
    ray = np.array([0.21, -0.17])
    expected = lens.pixel_from_normalised(ray)
    np.testing.assert_allclose(loaded.pixel_from_normalised(ray), expected, **SAME)


@pytest.mark.parametrize("name", [n for n, each in FORMATS.items() if "segments" in each.reads])
@pytest.mark.parametrize("count", [0, 1, 7])
def test_segments_come_back_to_the_last_digit(name, count, tmp_path):
    ends = np.random.default_rng(count).uniform(-1, 700, (count, 4))
    form = FORMATS[name]
    form.save(Segments.from_endpoints(ends), tmp_path / "segments.txt")
    loaded = form.load(tmp_path / "segments.txt")
    np.testing.assert_array_equal(loaded.endpoints_px.reshape(-1, 4), ends)


@settings(max_examples=3)
@given(rig=rigs(coefficients=4, min_cameras=3, max_cameras=3))
def test_names_are_given_to_cameras_in_their_order(rig):
    form = FORMATS["kalibr"]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "chain.yaml"
        form.save(rig, path)
        loaded = form.load(path)
        named = form.load(path, names=("a", "b", "c"))
    assert loaded.names == ("cam0", "cam1", "cam2")
    assert named.names == ("a", "b", "c")
    np.testing.assert_array_equal(named.matrices_px, loaded.matrices_px)


@pytest.mark.parametrize("name", list(FORMATS))
def test_the_registry_says_what_a_format_is(name):
    form = FORMATS[name]
    assert form.name == name
    assert form.holds or form.reads
    assert set(form.reads) <= set(form.holds) or form.write is None
    assert (form.write is None) == (not form.holds)
    assert (form.read is None) == (not form.reads)
    assert "pixel" in form.frames or "world" in form.frames or "up" in form.frames

"""NAME=FILE arguments and the options that say what a lens is."""

from pathlib import Path

import numpy as np
import pytest
import tyro
from hypothesis import given, strategies as st

import trinoc
from trinoc.cli.calibrate import Calibrate
from trinoc.cli.command import UsageError
from trinoc.cli.lens_options import LensOptions
from trinoc.cli.main import main
from trinoc.cli.views import files_of_views
from trinoc.errors import InputError
from trinoc.io.intrinsics_json import save_intrinsics

SIZES = {"upper": (512, 480), "left": (640, 400)}
NAMES = st.text(st.characters(exclude_characters="=", exclude_categories=["Cs"]), min_size=1)


@given(names=st.lists(NAMES, unique=True), file=st.text(min_size=1).filter(lambda t: t != "."))
def test_views_keep_names_order_and_any_file_name(names, file):
    assert files_of_views([f"{name}={file}" for name in names]) == dict.fromkeys(names, Path(file))


@pytest.mark.parametrize("argument", ["upper.png", "=upper.png", "upper="])
def test_argument_without_a_name_or_file_is_refused(argument):
    with pytest.raises(UsageError, match="write NAME=FILE"):
        files_of_views([argument])


def test_lens_from_the_data_sheet_has_each_picture_s_size():
    lenses = LensOptions(focal_length_mm=16.0, pixel_pitch_mm=(0.01, 0.02)).lenses(SIZES)
    assert {name: lens.image_size_px for name, lens in lenses.items()} == SIZES
    np.testing.assert_allclose(lenses["left"].focal_length_px, [1600, 800])


def test_lens_from_one_file_or_from_one_for_each(tmp_path):
    files = {name: tmp_path / f"{name}.json" for name in SIZES}
    for focal_px, name in enumerate(SIZES, 1000):
        lens = trinoc.Intrinsics(focal_length_px=float(focal_px), image_size_px=SIZES[name])
        trinoc.save(lens, files[name])
    one = LensOptions(intrinsics=(str(files["left"]),))
    assert [lens.focal_length_px[0] for lens in one.lenses(SIZES).values()] == [1001.0] * 2
    assert one.files() == {"intrinsics": files["left"]}
    each = LensOptions(intrinsics=tuple(f"{name}={file}" for name, file in files.items()))
    assert [lens.focal_length_px[0] for lens in each.lenses(SIZES).values()] == [1000.0, 1001.0]
    with pytest.raises(UsageError, match='no file for the camera "left"'):
        LensOptions(intrinsics=(f"upper={files['upper']}",)).lenses(SIZES)


def test_covariance_of_the_lens_is_that_of_its_file_unless_refused(tmp_path):
    files, covariance = {name: tmp_path / f"{name}.json" for name in SIZES}, np.diag(np.arange(9.0))
    lens = trinoc.Intrinsics(focal_length_px=1000.0, image_size_px=SIZES["left"])
    save_intrinsics(lens, files["left"], covariance=covariance)
    save_intrinsics(lens, files["upper"])
    one = LensOptions(intrinsics=(str(files["left"]),))
    lenses = dict.fromkeys(SIZES, lens)
    np.testing.assert_array_equal(one.covariance(lenses), covariance)
    each = LensOptions(intrinsics=tuple(f"{name}={file}" for name, file in files.items()))
    found = each.covariance(lenses)
    assert isinstance(found, dict)
    assert list(found) == ["left"]
    refused = LensOptions(intrinsics=(str(files["left"]),), lens_covariance=False)
    assert refused.covariance(lenses) is None


def test_a_data_sheet_is_not_exact_unless_it_is_said_to_be(tmp_path):
    options = {"focal_length_mm": 16.0, "pixel_pitch_mm": (0.01, 0.02)}
    lenses = LensOptions(**options).lenses(SIZES)
    found = LensOptions(**options).covariance(lenses)
    assert isinstance(found, dict)
    for name, (width, _) in SIZES.items():
        sigma = np.sqrt(np.diag(found[name]))
        assert sigma[:2] / lenses[name].focal_length_px == pytest.approx([0.01, 0.01], rel=0.01)
        assert sigma[2:4] == pytest.approx(0.02 * width)
    assert LensOptions(**options, lens_exact=True).covariance(lenses) is None
    # The same lens from a file that states no covariance.
    save_intrinsics(lenses["left"], tmp_path / "left.json")
    file = LensOptions(intrinsics=(str(tmp_path / "left.json"),))
    again = file.covariance(dict.fromkeys(SIZES, lenses["left"]))
    assert isinstance(again, dict)
    np.testing.assert_allclose(again["upper"], found["left"])


@pytest.mark.parametrize(
    "options",
    [
        LensOptions(),
        LensOptions(focal_length_mm=16.0),
        LensOptions(pixel_pitch_mm=(0.01, 0.01)),
        LensOptions(intrinsics=("a.json",), focal_length_mm=16.0),
    ],
)
def test_lens_that_is_not_determined_is_wrong_usage(options):
    with pytest.raises(UsageError, match="lens is not determined"):
        options.lenses(SIZES)


def test_lens_that_cannot_be_is_refused():
    with pytest.raises(InputError, match="must be positive"):
        LensOptions(focal_length_mm=-16.0, pixel_pitch_mm=(0.01, 0.01)).lenses(SIZES)


@pytest.mark.parametrize(
    "lens",
    [
        ("--pixel-pitch-mm", "0.01", "0.02", "--focal-length-mm", "16"),
        ("--focal-length-mm", "16", "--pixel-pitch-mm", "0.01", "0.02"),
        ("--intrinsics", "upper=a.json", "--intrinsics", "left=b.json"),
        ("--intrinsics", "a.json"),
    ],
)
def test_pictures_may_follow_the_options(lens):
    """An option that takes any number of values would swallow them."""
    options, pictures = ("--pattern", "p.json", *lens), ("upper=u.png", "left=l.png")
    config = (tyro.conf.OmitArgPrefixes,)
    before = tyro.cli(Calibrate, args=[*pictures, *options], config=config)
    after = tyro.cli(Calibrate, args=[*options, *pictures], config=config)
    assert before == after
    assert after.pictures == pictures


def test_a_sheet_is_proposed_for_a_camera_and_a_distance(tmp_path, capsys):
    place = str(tmp_path / "sheet.json")
    camera = ("--field-deg", "30", "--image-size-px", "1280", "960")
    assert main(["pattern", "--for-distance-mm", "500", *camera, "-o", place]) == 0
    assert "px wide" in capsys.readouterr().out
    assert main(["pattern", "--for-distance-mm", "500", "-o", place]) == 2
    assert "--field-deg" in capsys.readouterr().err
    for wrong in ("--for-distance-mm", "-5"), ("--field-deg", "200"):
        options = ["--for-distance-mm", "500", *camera, *wrong]
        assert main(["pattern", *options, "-o", place]) == 2
        assert f"{wrong[0]} is {wrong[1]}" in capsys.readouterr().err
    assert main(["pattern", "--board", "charuco", "--for-distance-mm", "500", "-o", place]) == 2


SCREEN = ("--screen-px", "1920", "1080", "--screen-inch", "24")


def test_a_screen_as_target_gets_a_picture_and_a_layout(tmp_path, capsys):
    place = tmp_path / "sheet.png"
    assert main(["pattern", "-o", str(place), *SCREEN]) == 0
    out = capsys.readouterr().out
    assert "Pixels of 0.2767 mm" in out
    assert "--print-scale" in out
    assert {each.name for each in tmp_path.iterdir()} == {"sheet.png", "sheet.json"}
    camera = ("--for-distance-mm", "900", "--field-deg", "30", "--image-size-px", "1280", "960")
    assert main(["pattern", "-o", str(place), *SCREEN, *camera]) == 0
    assert "px wide" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "status", "says"),
    [
        (("-o", "sheet.png"), 2, "--screen-px 1920 1080"),
        (("-o", "sheet.png", "--screen-px", "1920", "-1080", "--screen-inch", "24"), 2, "width"),
        (("-o", "sheet.png", "--screen-px", "1920", "1080"), 2, "--screen-inch"),
        (("-o", "sheet.png", *SCREEN, "--screen-pitch-mm", "0.27"), 2, "one of two"),
        (("-o", "sheet.png", "--screen-px", "1920", "1080", "--screen-inch", "610"), 2, "inches"),
        (("-o", "sheet.png", "--screen-px", "4", "3", "--screen-inch", "24"), 2, "millimetres"),
        (("-o", "sheet.png", *SCREEN[:-1], "9"), 1, "the screen is 199 x 112 mm"),
        (("-o", "sheet.json", *SCREEN), 2, "FILE.png"),
        (("-o", "sheet.tiff", *SCREEN), 2, ".png"),
    ],
)
def test_a_screen_that_is_not_said_or_too_small(
    options, status, says, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert main(["pattern", *options]) == status
    assert says in capsys.readouterr().err
    assert not any(tmp_path.iterdir())

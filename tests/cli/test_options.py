"""NAME=FILE arguments, NAME=VALUE settings, and the options that say what a lens is."""

import contextlib
import io
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

import trinoc
from trinoc.cli.calibrate import calibrate
from trinoc.cli.command import UsageError
from trinoc.cli.lens_options import BOARD_SIGMA, SIGMA, LensOptions
from trinoc.cli.main import main, parse_arguments
from trinoc.cli.segments import FIND
from trinoc.cli.settings import (
    parse_integer,
    parse_number,
    parse_pair,
    parse_truth,
    put_files_first,
    read_settings,
)
from trinoc.cli.views import files_of_views
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
    lenses = LensOptions(lens_mm=(16.0, 0.01, 0.02)).lenses(SIZES)
    assert {name: lens.image_size_px for name, lens in lenses.items()} == SIZES
    np.testing.assert_allclose(lenses["left"].focal_length_px, [1600, 800])


def test_lens_from_one_file_or_from_one_for_each(tmp_path):
    files = {name: tmp_path / f"{name}.json" for name in SIZES}
    for focal_px, name in enumerate(SIZES, 1000):
        lens = trinoc.Intrinsics(focal_length_px=float(focal_px), image_size_px=SIZES[name])
        trinoc.save(lens, files[name])
    shared = LensOptions(lens=(str(files["left"]),))
    assert [lens.focal_length_px[0] for lens in shared.lenses(SIZES).values()] == [1001.0] * 2
    assert shared.files() == {"lens": files["left"]}
    each = LensOptions(lens=tuple(f"{name}={file}" for name, file in files.items()))
    assert [lens.focal_length_px[0] for lens in each.lenses(SIZES).values()] == [1000.0, 1001.0]
    with pytest.raises(UsageError, match='no file for the camera "left"'):
        LensOptions(lens=(f"upper={files['upper']}",)).lenses(SIZES)


def test_covariance_of_the_lens_is_that_of_its_file(tmp_path):
    files, covariance = {name: tmp_path / f"{name}.json" for name in SIZES}, np.diag(np.arange(9.0))
    lens = trinoc.Intrinsics(focal_length_px=1000.0, image_size_px=SIZES["left"])
    save_intrinsics(lens, files["left"], covariance=covariance)
    save_intrinsics(lens, files["upper"])
    shared = LensOptions(lens=(str(files["left"]),))
    lenses = dict.fromkeys(SIZES, lens)
    np.testing.assert_array_equal(shared.covariance(lenses), covariance)
    per_camera = LensOptions(lens=tuple(f"{name}={file}" for name, file in files.items()))
    covariances = per_camera.covariance(lenses)
    assert isinstance(covariances, dict)
    assert list(covariances) == ["left"]


def test_a_data_sheet_is_not_exact(tmp_path):
    numbers = LensOptions(lens_mm=(16.0, 0.01, 0.02))
    lenses = numbers.lenses(SIZES)
    covariances = numbers.covariance(lenses)
    assert isinstance(covariances, dict)
    for name, (width, _) in SIZES.items():
        sigma = np.sqrt(np.diag(covariances[name]))
        assert sigma[:2] / lenses[name].focal_length_px == pytest.approx([0.01, 0.01], rel=0.01)
        assert sigma[2:4] == pytest.approx(0.02 * width)
    # The same lens from a file that states no covariance.
    save_intrinsics(lenses["left"], tmp_path / "left.json")
    file = LensOptions(lens=(str(tmp_path / "left.json"),))
    from_file = file.covariance(dict.fromkeys(SIZES, lenses["left"]))
    assert isinstance(from_file, dict)
    np.testing.assert_allclose(from_file["upper"], covariances["left"])


def test_lens_that_is_not_determined_is_wrong_usage():
    with pytest.raises(UsageError, match="The lens is missing"):
        LensOptions().lenses(SIZES)
    with pytest.raises(UsageError, match="Both --lens and --lens-mm are given: give one"):
        LensOptions(lens=("a.json",), lens_mm=(16.0, 0.01, 0.01)).lenses(SIZES)


def test_lens_that_cannot_be_is_refused():
    with pytest.raises(UsageError, match="must have a positive one"):
        LensOptions(lens_mm=(-16.0, 0.01, 0.01)).check()


@pytest.mark.parametrize(
    "lens",
    [
        ("--lens-mm", "16", "0.01", "0.02"),
        ("--lens", "upper=a.json", "--intrinsics", "left=b.json"),
        ("--lens", "a.json"),
    ],
)
def test_pictures_may_follow_the_options(lens):
    """An option that takes any number of values would swallow them."""
    options, pictures = ("--pattern", "p.json", *lens), ("upper=u.png", "left=l.png")
    before = parse_arguments(["calibrate", *pictures, *options])
    after = parse_arguments(["calibrate", *options, *pictures])
    assert before == after
    assert after.arguments["images"] == pictures


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("u=u.png --board b.json l=l.png", "u=u.png l=l.png --board b.json"),
        ("--json u=u.png", "u=u.png --json"),
        (
            "--lens u=c.json u=u.png --lens-mm 1 2 3 l=l.png",
            "u=u.png l=l.png --lens u=c.json --lens-mm 1 2 3",
        ),
        ("--sigma lens=0 aim_mm=0 -o a=b.json", "--sigma lens=0 aim_mm=0 -o a=b.json"),
        ("--out=a.json u=u.png u.png", "u=u.png --out=a.json u.png"),
        ("--lens-mm 16,0.01,0.02 u=u.png", "u=u.png --lens-mm 16 0.01 0.02"),
        ("--lens-mm 16,0.01 u=u.png", "u=u.png --lens-mm 16,0.01"),
    ],
)
def test_files_between_options_are_taken(typed, meant):
    assert put_files_first(calibrate, typed.split()) == meant.split()


def test_what_a_board_has_may_stand_behind_its_options(tmp_path):
    layout = tmp_path / "board.json"
    size = ("--rows", "4", "--columns", "5", "square_mm=11")
    assert main(["pattern", "charuco", *size, "-o", str(layout), "--quiet"]) == 0
    assert '"square_mm": 11' in layout.read_text()


CAMERA = ("field_deg=30", "size_px=1280,960")


def test_a_sheet_is_proposed_for_a_camera_and_a_distance(tmp_path, capsys):
    layout = str(tmp_path / "sheet.json")
    assert main(["pattern", "--camera", "distance_mm=500", *CAMERA, "-o", layout]) == 0
    assert "px wide" in capsys.readouterr().out
    assert main(["pattern", "--camera", "distance_mm=500", "-o", layout]) == 2
    assert "--camera lacks field_deg and size_px" in capsys.readouterr().err
    for settings, message in (
        (("distance_mm=-5", *CAMERA), "distance_mm is -5"),
        (("distance_mm=500", "field_deg=200", CAMERA[1]), "field_deg is 200"),
    ):
        assert main(["pattern", "-o", layout, "--camera", *settings]) == 2
        assert message in capsys.readouterr().err
    for other in ("charuco",), ("--rows", "8"), ("sheet", "radius_mm=5"):
        assert main(["pattern", *other, "--camera", "distance_mm=500", "-o", layout]) == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("chess",), "no kind of board: give sheet"),
        (("charuco", "marker=3"), "write marker_mm=VALUE"),
        (("charuco", "square_mm"), "as NAME=VALUE"),
        (("chessboard", "pitch_mm=3"), 'no setting "pitch_mm": the settings are square_mm'),
        (("chessboard", "rows=6"), "write --rows=6"),
        (("sheet", "pitch_mm=wide"), "is no number"),
        (("sheet", "line_style=red"), "give stop, through or white"),
        (("aprilgrid", "first=1.5"), "no whole number"),
        (("layout.json", "--rows", "3"), "leave out --rows"),
        (("layout.json", "tag_mm=3"), "omit tag_mm=3"),
    ],
)
def test_a_kind_says_what_it_has(arguments, message, tmp_path, capsys):
    assert main(["pattern", *arguments, "-o", str(tmp_path / "board.json")]) == 2
    assert message in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


SCREEN = ("--screen", "size_px=1920,1080", "diagonal_inch=24")


def test_a_screen_as_target_gets_a_picture_and_a_layout(tmp_path, capsys):
    image = tmp_path / "sheet.png"
    assert main(["pattern", "-o", str(image), *SCREEN]) == 0
    out = capsys.readouterr().out
    assert "Pixels of 0.2767 mm" in out
    assert "--print-scale" in out
    assert {path.name for path in tmp_path.iterdir()} == {"sheet.png", "sheet.json"}
    camera = ("--camera", "distance_mm=900", "field_deg=30", "size_px=1280x960")
    assert main(["pattern", "-o", str(image), *SCREEN, *camera]) == 0
    assert "px wide" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "status", "message"),
    [
        (("-o", "sheet.png"), 2, "--screen size_px=1920,1080"),
        (("-o", "sheet.png", "--screen", "size_px=1920,-1080", "diagonal_inch=24"), 2, "width"),
        (("-o", "sheet.png", *SCREEN[:-1]), 2, "diagonal_inch=INCH"),
        (("-o", "sheet.png", *SCREEN, "pitch_mm=0.27"), 2, "exactly one setting"),
        (("-o", "sheet.png", *SCREEN[:-1], "diagonal_inch=610"), 2, "inches"),
        (("-o", "sheet.png", "--screen", "size_px=4,3", "diagonal_inch=24"), 2, "millimetres"),
        (("-o", "sheet.png", *SCREEN[:-1], "diagonal_inch=9"), 1, "the screen is 199 x 112 mm"),
        (("-o", "sheet.json", *SCREEN), 2, "FILE.png"),
        (("-o", "sheet.tiff", *SCREEN), 2, ".png"),
    ],
)
def test_a_screen_that_is_not_said_or_too_small(
    options, status, message, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert main(["pattern", *options]) == status
    assert message in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


def help_text(command: str) -> str:
    stdout = io.StringIO()
    with contextlib.redirect_stdout(stdout):
        assert main([command, "--help"]) == 0
    return stdout.getvalue()


@pytest.mark.parametrize(
    ("command", "names"),
    [
        ("calibrate", SIGMA),
        ("calibrate-rig", BOARD_SIGMA),
        ("match", FIND),
        ("batch", FIND),
    ],
)
def test_the_help_names_every_setting(command, names):
    text = help_text(command)
    for name in names:
        assert f"{name}=" in text


def test_settings_are_read_by_their_parsers():
    parsers = {"a_mm": parse_number, "b": parse_truth, "c": parse_pair(parse_integer)}
    values = read_settings("--x", [["a-mm=1.5", "b=no"], ["c=3"]], parsers)
    assert values == {"a_mm": 1.5, "b": False, "c": (3, 3)}
    assert parse_pair(parse_integer)("1280x960") == (1280, 960)
    for settings, message in (
        (["a_mm=1", "a_mm=2"], "twice"),
        (["a_mm"], "has no value: write a_mm=VALUE"),
        (["a_mm="], "has no value"),
        (["b=maybe"], "neither yes nor no"),
        (["c=1,2,3"], "more than two"),
        (["c=1.5"], "no whole number"),
        (["a_m=1"], "write a_mm=VALUE"),
        (["upper=u.png"], "the settings are a_mm, b, c; write files before the options"),
    ):
        with pytest.raises(UsageError, match=message):
            read_settings("--x", [settings], parsers)

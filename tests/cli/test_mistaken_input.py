"""Mistakes on the command line and around it: said before the work, in one line."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import trinoc
from trinoc.cli import program
from trinoc.cli.lens_options import LensOptions
from trinoc.cli.main import main
from trinoc.cli.views import doubts_table, read_rig
from trinoc.io.images import write_picture
from trinoc.io.rig_json import load_rig_status, save_rig
from trinoc.synth import table1_rig

LENS = ["--lens-mm", "16"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([*LENS, "16.2", "13.4"], "looks like micrometres: write 0.0162 0.0134 millimetres"),
        ([*LENS, "1.62e-5", "1.34e-5"], "looks like metres: write 0.0162 0.0134 millimetres"),
        ([*LENS, ".01", ".01", "--sigma", "print_scale=nan"], "give a finite number"),
        ([*LENS, ".01", ".01", "--sigma", "print_scale=-1,0"], "no standard deviation"),
        ([*LENS, ".01", "inf"], "--lens-mm is inf"),
        ([*LENS, ".01", ".01", "--sigma", "flatness=1"], "write flatness_mm=VALUE"),
        ([*LENS, ".01", ".01", "--sigma", "b=none.png"], "write files before the options"),
        (["--lens-mm", "0.016", ".01", ".01"], "looks like metres: write 16 millimetres"),
    ],
)
def test_options_are_checked_before_any_file_is_read(arguments, message, capsys):
    assert main(["calibrate", "a=none.png", "--board", "none.json", *arguments]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert message in err


@pytest.mark.parametrize(
    "option", ["--tolerance-px", "--false-alarms", "--least-contrast", "--response"]
)
@pytest.mark.parametrize("value", ["nan", "-1.5"])
def test_options_of_segments_are_checked_first(option, value, capsys):
    assert main(["segments", "none.png", option, value]) == 2
    assert option in capsys.readouterr().err


def test_what_a_calibration_doubted_is_repeated_by_readers(tmp_path, caplog):
    file = tmp_path / "rig.json"
    save_rig(table1_rig(), file)
    assert load_rig_status(file).cameras == {}
    assert doubts_table(file) == []
    status = {
        "cameras": {
            "upper": {"status": "suspect", "notes": ["the lens is another."]},
            "left": {"status": "converged", "notes": []},
        },
        "sigmas_include": ["noise"],
    }
    save_rig(table1_rig(), file, status=status)
    assert trinoc.load_rig(file).names == table1_rig().names
    with caplog.at_level("WARNING", logger="trinoc"):
        read_rig(file)
    assert [record.message for record in caplog.records] == [
        f"the calibration in {file} is SUSPECT: upper (the lens is another)"
    ]
    assert [table.rows for table in doubts_table(file)] == [[("upper", "the lens is another.")]]
    assert load_rig_status(file).sigmas_include == ("noise",)


def test_nothing_found_is_said_with_its_reason(tmp_path, capsys):
    cv2 = pytest.importorskip("cv2")
    picture, out = tmp_path / "dark.png", tmp_path / "segments.npz"
    cv2.imwrite(str(picture), np.zeros((40, 50), np.uint8))
    assert main(["segments", str(picture), "-o", str(out)]) == 0
    assert "All pixels have the same grey level" in capsys.readouterr().out


def trinoc_process(*arguments, **options):
    return subprocess.Popen(
        [sys.executable, "-m", "trinoc", *arguments],
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


@pytest.mark.skipif(os.name != "posix", reason="pipes and signals of POSIX")
def test_output_that_nobody_reads_is_no_error():
    read, write = os.pipe()
    os.close(read)
    with trinoc_process("--version", stdout=write) as gone:
        os.close(write)
        assert gone.stderr is not None
        assert (gone.stderr.read(), gone.wait()) == ("", program.READER_GONE)


@pytest.mark.skipif(os.name != "posix", reason="closing a stream by the shell")
def test_output_that_is_closed_is_no_error():
    closed = subprocess.run(
        ["/bin/sh", "-c", f'"{sys.executable}" -m trinoc --version >&-'],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (closed.stderr, closed.returncode) == ("", 0)


def test_interruption_during_imports_is_one_line(monkeypatch, capsys):
    class Interrupted:
        def find_spec(self, name, path=None, target=None):
            if name == "trinoc.cli.main":
                raise KeyboardInterrupt

    monkeypatch.delitem(sys.modules, "trinoc.cli.main")
    monkeypatch.setattr(sys, "meta_path", [Interrupted(), *sys.meta_path])
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    assert program.run() == program.INTERRUPTED == 130
    err = capsys.readouterr().err
    assert err.startswith("trinoc: Interrupted")
    assert err.count("\n") == 1


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_program_told_to_end_takes_its_scratch_file_with_it(tmp_path):
    script = (
        "import sys, time\nfrom trinoc.cli import program\nimport trinoc.cli.main as m\n"
        "from trinoc.io.atomic import atomic_write\n"
        "def job():\n"
        f"    with atomic_write({str(tmp_path / 'a.txt')!r}) as file:\n"
        "        file.write(b'half'); print('ready', flush=True); time.sleep(60)\n"
        "m.main = job\nsys.exit(program.run())\n"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        time.sleep(0.05)
        process.terminate()
        assert process.wait() == 128 + signal.SIGTERM
    assert list(tmp_path.iterdir()) == []


def test_an_orientation_that_is_neither_word_nor_file_is_named(capsys):
    options = ("--board", "none.json", *LENS, ".0162", ".0134", "--orientation", "sideways")
    assert main(["calibrate", "a=none.png", *options]) == 2
    assert "give upright, or the file" in capsys.readouterr().err


def test_pictures_of_other_sizes_than_the_one_lens_has_are_named(caplog):
    lens = LensOptions(lens_mm=(16.0, 0.0162, 0.0134))
    lens.lenses({"upper": (512, 480), "left": (512, 480)})
    assert not caplog.messages
    lens.lenses({"upper": (256, 240), "left": (512, 480)})
    assert "upper 256 x 240, left 512 x 480 px" in caplog.text


@pytest.mark.parametrize(
    "arguments",
    [
        ["segments", f"{'a' * 300}.png"],
        ["match", *(f"{name}={'a' * 300}_{name}.csv" for name in ("upper", "left", "right"))],
        ["calibrate", "a=a.png", "--board", f"{'a' * 300}.json", *LENS, ".01", ".01"],
    ],
)
def test_a_name_that_is_too_long_is_called_so(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    save_rig(table1_rig(), "rig.json")
    more = ["--rig", "rig.json"] if arguments[0] == "match" else []
    assert main([*arguments, *more]) == 1
    err = capsys.readouterr().err
    assert "File name too long): give a file of a shorter name" in err
    assert "disk" not in err


@pytest.mark.parametrize(
    ("text", "command"),
    [
        (
            "image_width: 640\ndistortion_model: plumb_bob\ndistortion_coefficients:\n  data: [0]",
            "`trinoc export 'up per.yaml' --from ros -o camera.json`",
        ),
        (
            "%YAML:1.0\ndistortion_coefficients: !!opencv-matrix\n  rows: 1",
            "`trinoc export 'up per.yaml' --from opencv -o rig.json`",
        ),
        (
            "cam0:\n  camera_model: pinhole",
            "`trinoc export 'up per.yaml' --from kalibr -o rig.json`",
        ),
        ("some: yaml", "is not JSON: give the .json file"),
    ],
)
def test_a_lens_of_another_tool_is_answered_by_the_command_that_reads_it(
    text, command, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "up per.yaml").write_text(text)
    board = trinoc.Pattern.cross_grid(rows=4, columns=6, pitch_mm=20.0, radius_mm=6.0)
    trinoc.save(board, "board.json")
    image = np.random.default_rng(0).integers(0, 256, (48, 64), dtype=np.uint8)
    write_picture("a.png", image)
    arguments = ["a=a.png", "--board", "board.json", "--lens", "up per.yaml"]
    assert main(["calibrate", *arguments]) == 1
    assert command in capsys.readouterr().err


def test_a_recording_without_files_is_called_so(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    save_rig(table1_rig(), "rig.json")
    (tmp_path / "empty").mkdir()
    assert main(["batch", "empty", "--rig", "rig.json", "-o", "results"]) == 1
    assert "empty has no pictures and no segments. Give the folder" in capsys.readouterr().err

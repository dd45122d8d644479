"""An unexpected exception is one sentence and a file; warnings of Python are not shown."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import trinoc

# A command that raises, warns, or both, as the program of a process of its own.
_PROGRAM = """
import functools, sys, warnings
import numpy as np
from trinoc.cli import program
from trinoc.cli.command import Outcome
from trinoc.cli import segments

@functools.wraps(segments.segments)
def job(*_, **__):
    {body}

segments.segments = job
sys.exit(program.run())
"""
_SINGULAR = "np.linalg.inv(np.zeros((2, 2)))"


def run(
    body: str, folder: Path, *flags: str, python: tuple[str, ...] = (), **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run `trinoc segments a.png -o s.npz` with `body` as the code of the job."""
    script = ["-c", _PROGRAM.format(body=body), "segments", "a.png", "-o", "s.npz"]
    inherited = {key: value for key, value in os.environ.items() if key != "PYTHONWARNINGS"}
    return subprocess.run(
        [sys.executable, *python, *script, *flags],
        capture_output=True,
        text=True,
        cwd=folder,
        env=inherited | {"PYTHONPATH": str(Path(trinoc.__file__).parents[1])} | environment,
        check=False,
    )


@pytest.mark.parametrize("flags", [(), ("--json",)])
def test_an_unexpected_exception_is_one_sentence_and_a_file(flags, tmp_path) -> None:
    process = run(_SINGULAR, tmp_path, *flags)
    (written,) = tmp_path.glob("trinoc-error-*.txt")
    sentence = (
        "trinoc stopped at an internal error: LinAlgError: Singular matrix. The details are in "
        f"{written.name}. Attach it to a report of this error."
    )
    assert process.returncode == 1
    assert process.stderr == f"trinoc: {sentence}\n"
    assert process.stdout == (json.dumps({"error": sentence}) + "\n" if flags else "")
    text = written.read_text(encoding="utf-8")
    for line in (
        "command: trinoc segments a.png -o s.npz",
        "Traceback (most recent call last):",
        "numpy.linalg.LinAlgError: Singular matrix",
        f"trinoc {trinoc.__version__}",
        "opencv-python-headless",
    ):
        assert line in text


def test_a_long_message_stays_one_short_line(tmp_path) -> None:
    process = run('raise ValueError("shapes\\\\n" * 1000)', tmp_path)
    assert len(process.stderr.splitlines()) == 1
    assert len(process.stderr) < 500


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written_sends_the_file_elsewhere(tmp_path) -> None:
    closed, other = tmp_path / "closed", tmp_path / "other"
    closed.mkdir(mode=0o500)
    other.mkdir()
    assert str(other / "trinoc-error-") in run(_SINGULAR, closed, TMPDIR=str(other)).stderr


def test_without_any_folder_the_sentence_says_so(tmp_path, monkeypatch, capsys) -> None:
    from trinoc.cli.error_report import report_error

    monkeypatch.chdir(tmp_path)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(elsewhere))
    real = Path.open

    def refuse(path: Path, *arguments, **options):
        if path.name.startswith("trinoc-error-") and path.parent in refused:
            raise PermissionError(13, "Permission denied")
        return real(path, *arguments, **options)

    monkeypatch.setattr(Path, "open", refuse)
    refused = {Path()}
    assert report_error(ValueError("a"), []) == 1
    (written,) = elsewhere.glob("trinoc-error-*.txt")
    assert f"The details are in {written}." in capsys.readouterr().err
    written.unlink()
    refused.add(elsewhere)
    assert report_error(ValueError("a"), []) == 1
    assert "No folder could be written to: run the command again" in capsys.readouterr().err
    assert not list(tmp_path.rglob("trinoc-error-*.txt"))


_WARNS = (
    "np.float32(1e30) * np.float32(1e30); np.sqrt(np.array(-1.0)); warnings.warn('raw');"
    ' return Outcome("well", {})'
)


def test_warnings_of_python_and_numpy_are_not_shown(tmp_path) -> None:
    process = run(_WARNS, tmp_path, "--quiet")
    assert (process.returncode, process.stdout, process.stderr) == (0, "well\n", "")


def test_warnings_are_shown_where_they_are_asked_for(tmp_path) -> None:
    process = run(_WARNS, tmp_path, "--quiet", python=("-W", "default"))
    assert "RuntimeWarning: overflow" in process.stderr

"""`trinoc match` and `batch`: text, record, report, file and exit code have one verdict."""

import html
import json
from dataclasses import replace

import numpy as np
import pytest

import trinoc
from tests.match.made import sure_matches
from trinoc.cli.main import main
from trinoc.io.frames_files import manifest_lines
from trinoc.match.tracks.matches import SUSPECT_SETS, MatchStatus
from trinoc.match.tracks.reliability import assess_matches
from trinoc.recording.frame_table import FrameMatches
from trinoc.report.frames_part import frames_part
from trinoc.synth import table1_rig

GOOD = sure_matches()
MATCHES = {
    "good": GOOD,
    "inexact": sure_matches(0.12),
    "two views": sure_matches(views=("upper", "left")),
    "few": sure_matches(count=3),
    "refused": replace(GOOD, counts={SUSPECT_SETS: 1}, notes=("They are exchanged.",)),
}
DOUBTS = {"upper": "its residuals are a swirl."}


@pytest.mark.parametrize("doubts", [{}, DOUBTS], ids=["a good rig", "a suspect rig"])
@pytest.mark.parametrize("kind", MATCHES)
def test_match_has_one_verdict_everywhere(kind, doubts, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    matches = MATCHES[kind]
    assessment = assess_matches(matches, doubts)
    monkeypatch.setattr("trinoc.match_segments", lambda *_, **__: matches)
    monkeypatch.setattr("trinoc.cli.match.find_doubts", lambda _: doubts)
    trinoc.save(table1_rig().take(matches.views), "rig.json")
    ends = np.random.default_rng(1).uniform(0, 470, (len(matches), 4))
    for view in matches.views:
        np.savetxt(f"{view}.csv", ends, delimiter=",")
    files = [f"{view}={view}.csv" for view in matches.views]
    command = ["match", *files, "--rig", "rig.json", "--report", "r.html", "--quiet"]

    is_refused = assessment.status is MatchStatus.SUSPECT
    assert main(command) == (1 if is_refused else 0)
    text, error = capsys.readouterr()
    assert assessment.sentence in text
    assert error == (f"trinoc: {assessment.deciding.explanation}\n" if is_refused else "")
    assert main([*command, "--json"]) == (1 if is_refused else 0)
    record = json.loads(capsys.readouterr().out)
    assert record["status"] == assessment.status.name.lower()
    assert record["verdict"] == assessment.sentence
    assert ("error" in record) is is_refused
    page = html.unescape((tmp_path / "r.html").read_text(encoding="utf-8"))
    shown = [status for status in MatchStatus if f"</span> {status.value}</p>" in page]
    assert shown == [assessment.status]
    assert assessment.deciding.figure in page
    # A file of matches knows nothing of the rig's calibration.
    assert trinoc.load("matches.npz").status is assess_matches(matches).status


def test_each_frame_of_a_recording_has_the_verdict_of_its_matches():
    kinds = ["good"] * 5 + ["inexact", "few", "refused"]
    frames = {f"{number} {kind}": MATCHES[kind] for number, kind in enumerate(kinds)}
    part = frames_part({**frames, "none": None}, {"none": "no picture"})
    lines = manifest_lines([FrameMatches(name, "ok", m) for name, m in frames.items()], "m.npz")
    listed = {fate.name: fate for fate in part.to_look_at}
    for fate, line in zip(part.frames, lines, strict=False):
        assessment = assess_matches(frames[fate.name])
        assert fate.status == assessment.status.name.lower()
        assert (fate.name in listed) is (assessment.status is not MatchStatus.MATCHED)
        reasons = {name: line[name] for name in ("suspect", "uncertain") if name in line}
        assert set(reasons) == {fate.status} - {"matched"}
        assert all(reason == listed[fate.name].problem for reason in reasons.values())
    assert listed["none"].status == "failed"

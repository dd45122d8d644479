"""Batches that are stopped anywhere, cut into jobs or run on a cluster give the same files."""

import contextlib
import json
import multiprocessing
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

import trinoc
from trinoc.batch import folder as folder_file, run, workers
from trinoc.batch.work import MatchingJob
from trinoc.cli.batch import _outcome
from trinoc.cli.main import main
from trinoc.errors import InputError, MatchError
from trinoc.match.batch import MatchBatch
from trinoc.match.tracks.matches import SUSPECT_SETS
from trinoc.recording import parts
from trinoc.synth import table1_rig

RIG = table1_rig()
BOX_MM = np.array([[x, y, z] for x in (-30, 35) for y in (-25, 20) for z in (0, 30)], dtype=float)
EDGES = np.array(
    [(a, b) for a in range(8) for b in range(a) if (BOX_MM[a] != BOX_MM[b]).sum() == 1]
)
FRAMES, PER_FILE = 10, 3


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Segments of a box that moves; two of the frames are broken."""
    folder = tmp_path_factory.mktemp("recording")
    (folder / "frames").mkdir()
    trinoc.save(RIG, folder / "rig.json")
    for k in range(FRAMES):
        for name, camera in RIG.items():
            ends = np.c_[BOX_MM + 0.5 * k, np.ones(8)] @ camera.matrix_px.T
            ends = (ends[:, :2] / ends[:, 2:])[EDGES].reshape(-1, 4)
            np.savetxt(folder / "frames" / f"{k}_{name}.csv", ends, delimiter=",")
    (folder / "frames" / "4_left.csv").unlink()
    (folder / "frames" / "6_upper.csv").write_text("a,b,c,d\n")
    return folder


def made_matches(item):
    """Matches without compiled code: one track for each segment of the first view."""
    count = len(next(iter(item.values())))
    lines = np.repeat(np.asarray(next(iter(item.values())).endpoints_px)[:, :, :1], 3, axis=2)
    return trinoc.Matches(
        views=tuple(item),
        index=np.repeat(np.arange(count)[:, None], len(item), axis=1),
        fragments_px=np.stack([np.asarray(s.endpoints_px) for s in item.values()], axis=1),
        lines_mm=lines,
        covariance_mm2=np.tile(np.eye(6), (count, 1, 1)),
        stage=np.full(count, "trinocular"),
        posterior=np.full(count, 0.9),
        rival_posterior=np.zeros(count),
        reasons={view: np.full(len(s), "matched") for view, s in item.items()},
        counts={"candidates": count},
        fragments_covariance_px2=np.tile(np.eye(4), (count, len(item), 1, 1)),
        misfit=np.zeros(count),
        viewpoint_dependent=np.zeros(count, dtype=bool),
        notes=("a note",),
    )


def quick_matching(segments, rig, **_):
    return MatchBatch(tuple(made_matches(item) for item in segments), np.full(len(segments), "ok"))


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(parts, "match_many", quick_matching)


def contents(out):
    return {path.name: path.read_bytes() for path in out.iterdir()}


def match(folder, out, **options):
    options = {"frames_per_file": PER_FILE, "threads_at_most": 2, "ending": ".npz", **options}
    return trinoc.match_recording(folder / "frames", RIG, out, **options)


@pytest.fixture
def expected(recording, tmp_path, quick):
    match(recording, tmp_path / "expected")
    return contents(tmp_path / "expected")


def test_every_frame_has_its_matches_or_its_reason(recording, tmp_path, quick):
    reports = []
    outcome = match(recording, tmp_path / "out", on_progress=reports.append)
    assert (outcome.frames, outcome.failed, outcome.earlier) == (FRAMES, 2, 0)
    assert [progress.done for progress in reports] == sorted(progress.done for progress in reports)
    assert (reports[0].done, reports[-1]) == (0, (FRAMES, 2, FRAMES))
    loaded = trinoc.load(tmp_path / "out")
    assert list(loaded) == [str(k) for k in range(FRAMES)]
    for name, matches in loaded.items():
        assert (matches is None) == (name in loaded.failures)
        if matches is not None:
            item = {
                view: trinoc.load_segments(recording / "frames" / f"{name}_{view}.csv")
                for view in RIG
            }
            expected_matches = made_matches(item)
            for field in ("index", "fragments_px", "lines_mm", "covariance_mm2", "stage"):
                np.testing.assert_array_equal(
                    getattr(matches, field), getattr(expected_matches, field)
                )
            assert matches.notes == expected_matches.notes
            assert matches.counts == expected_matches.counts
    assert 'has no picture of "left"' in loaded.failures["4"]
    assert loaded.failures["6"].startswith("6_upper.csv, line 1, names the columns a, b, c, d")


def test_cameras_without_a_picture_are_left_out(recording, tmp_path, expected):
    larger = trinoc.Rig({**{f"camera {k}": RIG["left"] for k in range(9)}, **dict(RIG.items())})
    options = {"frames_per_file": PER_FILE, "threads_at_most": 2, "ending": ".npz"}
    outcome = trinoc.match_recording(recording / "frames", larger, tmp_path / "out", **options)
    assert outcome.without == larger.names[:9]
    assert contents(tmp_path / "out") == expected
    views = ("upper", "left", "right")
    rows = [",".join([k, *(f"frames/{k}_{view}.csv" for view in views)]) for k in ("0", "1")]
    (tmp_path / "table.csv").write_text("\n".join(["frame,upper,left,right", *rows, ""]))
    (tmp_path / "frames").symlink_to(recording / "frames")
    listed = trinoc.match_recording(tmp_path / "table.csv", larger, tmp_path / "listed", **options)
    assert (listed.without, listed.frames, listed.failed) == (larger.names[:9], 2, 0)


def test_a_report_shows_all_frames_and_the_middle_one(recording, tmp_path, quick, monkeypatch):
    monkeypatch.chdir(recording)
    arguments = ["batch", "frames", "--rig", "rig.json", "-o", str(tmp_path / "out"), "--quiet"]
    page = tmp_path / "r.html"
    assert main([*arguments, "--workers", "2", "--report", str(page)]) == 0
    text = page.read_text(encoding="utf-8")
    assert f"{FRAMES - 2} of {FRAMES} frames" in text
    assert "has no picture of &#34;left&#34;" in text
    assert 'id="segments"' in text


def test_frames_that_do_not_belong_to_the_rig_are_counted_and_fail_the_command(
    recording, tmp_path, monkeypatch
):
    def suspects(segments, rig, **_):
        result = quick_matching(segments, rig)
        first, *remaining = result.matches
        assert first is not None
        doubted = replace(first, counts=first.counts | {SUSPECT_SETS: 1})
        return replace(result, matches=(doubted, *remaining))

    monkeypatch.setattr(parts, "match_many", suspects)
    outcome = match(recording, tmp_path / "out")
    lines = [json.loads(line) for line in outcome.manifest.read_text().splitlines()]
    notes = [line["suspect"] for line in lines if "suspect" in line]
    assert notes == ["a note"] * outcome.suspect
    assert 0 < outcome.suspect < FRAMES
    # And again by the files alone, where the manifest is lost.
    outcome.manifest.write_text("")
    assert match(recording, tmp_path / "out").suspect == outcome.suspect
    message = _outcome(outcome, None)
    assert f"{outcome.suspect} do not seem to belong to the rig" in message.text
    assert message.record["suspect"] == outcome.suspect
    assert message.refusal is not None
    assert str(outcome.manifest) in message.refusal
    assert _outcome(replace(outcome, suspect=0), None).refusal is None


class Killed(BaseException):
    """Exception that simulates a kill: no later code runs."""


@settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(kills=st.lists(st.integers(0, 9), min_size=1, max_size=2), torn=st.integers(0, 40))
def test_killed_anywhere_and_begun_again_the_bytes_are_the_same(
    recording, tmp_path_factory, expected, kills, torn
):
    out, begun = tmp_path_factory.mktemp("killed"), []

    def counted(work, part, stopped=lambda: False):
        begun.append(part.number)
        return run_part(work, part, stopped)

    run_part, plain_save, plain_append = (
        workers.part_results,
        folder_file.save_frames,
        folder_file.Folder._append,
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(workers, "part_results", counted)
        for kill in kills:
            steps = iter(range(100))

            def save(*arguments, kill=kill, steps=steps):
                if next(steps) == kill:
                    raise Killed
                plain_save(*arguments)

            def append(self, *arguments, kill=kill, steps=steps):
                if next(steps) == kill:
                    raise Killed
                plain_append(self, *arguments)

            patch.setattr(folder_file, "save_frames", save)
            patch.setattr(folder_file.Folder, "_append", append)
            with contextlib.suppress(Killed):
                match(recording, out, threads_at_most=1)
            manifest = out / "manifest.jsonl"
            manifest.write_bytes(manifest.read_bytes()[: -torn or None])
            (out / ".matches-000001.npz.0123abcd.tmp").write_bytes(b"half")
        patch.setattr(folder_file, "save_frames", plain_save)
        patch.setattr(folder_file.Folder, "_append", plain_append)
        written = {path.name for path in out.glob("matches-*.npz")}
        begun.clear()
        match(recording, out, threads_at_most=1)
    assert contents(out) == expected
    # What had its file is not done twice.
    assert not {f"matches-{k:06d}.npz" for k in begun} & written
    assert len(begun) == len(set(begun))


@pytest.mark.parametrize("jobs", [2, 5])
@pytest.mark.parametrize("threads", [1, 3])
def test_jobs_and_threads_change_no_file(recording, tmp_path, expected, jobs, threads):
    for job in range(1, jobs + 1):
        match(recording, tmp_path / "out", shard=(job, jobs), threads_at_most=threads)
    files = contents(tmp_path / "out")
    lines = [files.pop(name) for name in sorted(files) if name.startswith("manifest-")]
    assert sorted(b"".join(lines).splitlines()) == sorted(expected["manifest.jsonl"].splitlines())
    assert files == {name: b for name, b in expected.items() if name != "manifest.jsonl"}
    assert len(trinoc.load_recording(tmp_path / "out")) == FRAMES


def test_a_defect_in_one_frame_is_that_frame_s_alone(recording, tmp_path, monkeypatch):
    def defective(segments, rig, **_):
        if any(np.asarray(s["upper"].endpoints_px)[0, 0, 0] > marked for s in segments):
            raise ZeroDivisionError("a defect")
        if len(segments) == 1:
            raise MatchError("refused.")
        return quick_matching(segments, rig)

    ends = trinoc.load_segments(recording / "frames" / "8_upper.csv").endpoints_px
    marked = float(np.asarray(ends)[0, 0, 0])
    monkeypatch.setattr(parts, "match_many", defective)
    match(recording, tmp_path / "out")
    failures = trinoc.load_recording(tmp_path / "out").failures
    assert "ZeroDivisionError: a defect" in failures["9"]
    assert set(failures) == {"4", "6", "9"}


@pytest.mark.parametrize(
    ("changed", "setting"),
    [
        ({"frames_per_file": 4}, "frames_per_file"),
        ({"find": {"arcs": True}}, "find"),
        ({"depth_range_mm": (1.0, 2.0)}, "depth_range_mm"),
        ({"sigma_px": 2.0}, "sigma_px"),
        ({"ending": ".parquet"}, "ending"),
    ],
)
def test_results_of_something_else_are_not_mixed(recording, tmp_path, quick, changed, setting):
    match(recording, tmp_path / "out")
    before = contents(tmp_path / "out")
    with pytest.raises(InputError, match=f'a run with another "{setting}"'):
        match(recording, tmp_path / "out", **changed)
    assert contents(tmp_path / "out") == before


def test_sigma_px_applies_to_every_frame(recording):
    segments = {v: trinoc.load_segments(recording / "frames" / f"0_{v}.csv") for v in RIG.names}
    (result,) = parts.match_part_frames({"0": segments}, RIG, sigma_px=0.25)
    expected = trinoc.match_segments(segments, RIG, sigma_px=0.25)
    assert result.matches is not None
    np.testing.assert_allclose(result.matches.covariance_mm2, expected.covariance_mm2, rtol=1e-9)
    with_own_sigmas = trinoc.match_segments(segments, RIG)
    assert not np.allclose(result.matches.covariance_mm2, with_own_sigmas.covariance_mm2, rtol=0.1)


def test_a_second_program_on_the_same_job_is_refused(recording, tmp_path, quick, monkeypatch):
    pytest.importorskip("fcntl")

    def second(*_):
        with pytest.raises(InputError, match="Another `trinoc batch` is writing"):
            match(recording, tmp_path / "out")

    match(recording, tmp_path / "out", on_progress=second)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"frames_per_file": 0}, "frames_per_file is 0"),
        ({"threads_at_most": 0}, "threads_at_most is 0"),
        ({"memory_gb": 0.0}, "memory_gb is 0"),
        ({"ending": ".txt"}, 'ending is ".txt"'),
        ({"shard": (2, 1)}, "There is no shard 2 of 1"),
        ({"template": "{frame}"}, "lacks {camera}"),
    ],
)
def test_what_cannot_be_leaves_no_folder(recording, tmp_path, options, message):
    with pytest.raises(InputError, match=message):
        match(recording, tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


def test_a_file_of_results_that_is_damaged_is_done_again(recording, tmp_path, expected):
    out = tmp_path / "out"
    match(recording, out)
    (out / "matches-000002.npz").write_bytes(b"damaged")
    (out / "manifest.jsonl").write_bytes(b"{not json\n")
    match(recording, out)
    assert contents(out) == expected


def test_parquet_holds_what_npz_holds(recording, tmp_path, quick):
    pytest.importorskip("pyarrow")
    match(recording, tmp_path / "npz")
    match(recording, tmp_path / "parquet", ending=".parquet")
    recordings = [trinoc.load_recording(tmp_path / kind) for kind in ("npz", "parquet")]
    assert recordings[0].failures == recordings[1].failures
    for name in recordings[0]:
        a, b = recordings[0][name], recordings[1][name]
        if a is None or b is None:
            assert a is b
            continue
        for field in ("index", "fragments_px", "lines_mm", "covariance_mm2", "stage", "misfit"):
            np.testing.assert_array_equal(getattr(a, field), getattr(b, field))
        assert (a.counts, a.notes, a.noise_scale) == (b.counts, b.notes, b.noise_scale)
        assert {v: list(w) for v, w in a.reasons.items()} == {
            v: list(w) for v, w in b.reasons.items()
        }


def test_a_cluster_writes_the_same_files(recording, tmp_path, expected):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None
    ) as cluster:
        outcome = match(recording, tmp_path / "out", scheduler=cluster.scheduler_address)
    assert outcome.workers == 2
    assert contents(tmp_path / "out") == expected


def broken_frames(folder, count):
    """Frames whose segments cannot be read: nothing is compiled for them."""
    (folder / "frames").mkdir()
    for frame in range(count):
        for name in RIG:
            (folder / "frames" / f"{frame:03}_{name}.csv").write_text(f"{frame} is no segment\n")
    return folder


def test_processes_write_what_threads_write(tmp_path, monkeypatch):
    folder = broken_frames(tmp_path, 14)
    begun = []

    @contextlib.contextmanager
    def counted(work, count):
        begun.append(count)
        with workers.processes(work, count) as crew:
            yield crew

    monkeypatch.setattr(run, "processes", counted)
    options = {"frames_per_file": 2, "threads_at_most": 2}
    threaded = match(folder, tmp_path / "threads", **options)
    separate = match(folder, tmp_path / "processes", in_processes=True, **options)
    assert begun == [2]
    assert (separate.workers, separate.failed, threaded.failed) == (2, 14, 14)
    assert contents(tmp_path / "processes") == contents(tmp_path / "threads")
    # So few that a process would not pay.
    match(folder, tmp_path / "few", in_processes=True, frames_per_file=7, threads_at_most=2)
    assert begun == [2]


def test_processes_give_up_between_two_frames(tmp_path):
    """The processes end with the block, also after an exception."""
    work = MatchingJob(broken_frames(tmp_path, 2) / "frames", RIG, {}, None)
    children = []

    def end_early():
        with workers.processes(work, 2):
            children.extend(multiprocessing.active_children())
            raise Killed

    with pytest.raises(Killed):
        end_early()
    assert len(children) == 2
    assert multiprocessing.active_children() == []


@pytest.mark.slow
def test_matches_of_processes_are_those_of_threads(recording, tmp_path):
    options = {"frames_per_file": 1, "threads_at_most": 2}
    match(recording, tmp_path / "threads", **options)
    match(recording, tmp_path / "processes", in_processes=True, **options)
    assert contents(tmp_path / "processes") == contents(tmp_path / "threads")


def test_a_scheduler_that_is_not_there_is_a_sentence(recording, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'trinoc\[batch\]'"):
        match(recording, tmp_path / "out", scheduler="tcp://127.0.0.1:1")


def batch(folder, *options):
    return main(
        [
            "batch",
            str(folder / "frames"),
            "--rig",
            str(folder / "rig.json"),
            "--json",
            "--quiet",
            *options,
        ]
    )


@pytest.mark.slow
def test_the_command_matches_as_the_library_does(recording, tmp_path, capsys):
    out = tmp_path / "out"
    assert batch(recording, "-o", str(out), "--frames-per-file", "8") == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["frames"], record["failed"], record["earlier"]) == (FRAMES, 2, 0)
    item = {v: trinoc.load_segments(recording / "frames" / f"3_{v}.csv") for v in RIG}
    direct, recorded = trinoc.match_segments(item, RIG), trinoc.load_recording(out)["3"]
    assert recorded is not None
    np.testing.assert_array_equal(recorded.index, direct.index)
    np.testing.assert_allclose(recorded.lines_mm, direct.lines_mm, rtol=1e-9)
    assert batch(recording, "-o", str(out), "--frames-per-file", "8") == 0
    assert json.loads(capsys.readouterr().out)["earlier"] == FRAMES


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--shard", "3/2"], "--shard is 3/2"),
        (["--shard", "x"], "--shard is x"),
        (["--workers", "0"], "--workers is 0"),
        (["--workers", "four"], "give a number of processes"),
        (["--find", "arcs=perhaps"], "neither yes nor no"),
        (["--memory-gb", "-1"], "--memory-gb is -1"),
        (["--depth-range-mm", "5", "1"], "contains no depth"),
    ],
)
def test_mistaken_options_are_usage_errors(recording, tmp_path, capsys, options, message):
    assert batch(recording, "-o", str(tmp_path / "out"), *options) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_interrupted_keeps_what_is_done_and_says_so(
    recording, tmp_path, capsys, quick, monkeypatch
):
    plain, calls = folder_file.Folder.commit, iter(range(100))

    def commit(self, *arguments):
        if next(calls) == 2:
            raise KeyboardInterrupt
        plain(self, *arguments)

    monkeypatch.setattr(folder_file.Folder, "commit", commit)
    out = tmp_path / "out"
    assert batch(recording, "-o", str(out), "--frames-per-file", "2") == 130
    err = capsys.readouterr().err
    assert err.startswith("trinoc: Interrupted: 4 of 10 frames are done and kept")
    assert err.count("\n") == 1
    assert len(list(out.glob("matches-*"))) == 2


def test_all_frames_failing_is_a_failure(recording, tmp_path, capsys):
    table = recording / "all.csv"
    table.write_text("frame,upper,left,right\n1,no.csv,no.csv,no.csv\n")
    options = ["--rig", str(recording / "rig.json"), "-o", str(tmp_path / "out"), "--quiet"]
    assert main(["batch", str(table), *options]) == 1
    assert "All 1 frames failed" in capsys.readouterr().err


@pytest.mark.usefixtures("quick")
def test_a_full_disk_keeps_what_is_done_and_the_same_call_goes_on(
    recording, tmp_path, expected, monkeypatch
):
    plain, calls = folder_file.save_frames, iter(range(100))

    def full(*arguments):
        if next(calls) == 2:
            raise InputError("the disk is full.")
        plain(*arguments)

    monkeypatch.setattr(folder_file, "save_frames", full)
    with pytest.raises(InputError, match="the disk is full"):
        match(recording, tmp_path / "out")
    assert len(list((tmp_path / "out").glob("matches-*"))) == 2
    match(recording, tmp_path / "out")
    assert contents(tmp_path / "out") == expected


def test_a_folder_that_cannot_be_made_is_a_sentence(recording, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"out cannot be written to \(Not a directory\)"):
        match(recording, tmp_path / "file" / "out")


def test_two_jobs_at_once_share_a_folder(recording, tmp_path, expected):
    jobs = [
        threading.Thread(target=match, args=(recording, tmp_path / "out"), kwargs={"shard": (k, 2)})
        for k in (1, 2)
    ]
    for job in jobs:
        job.start()
    for job in jobs:
        job.join()
    files = contents(tmp_path / "out")
    for name, content in expected.items():
        assert name == "manifest.jsonl" or files[name] == content

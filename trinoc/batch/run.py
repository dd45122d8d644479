"""A recording matched into a folder, from wherever an earlier run of it stopped."""

import dataclasses
import hashlib
import os
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any, NamedTuple

import trinoc
from trinoc.batch.folder import open_results
from trinoc.batch.source import Source, find_frames
from trinoc.batch.work import MatchingJob
from trinoc.batch.workers import cluster, in_window, processes, threads
from trinoc.errors import InputError, TrinocError, check_kind, real_number
from trinoc.geometry.rig import A_RIG, Rig
from trinoc.io.frames_files import frames_ending
from trinoc.io.rig_json import rig_text
from trinoc.recording.frame_table import FrameMatches
from trinoc.recording.parts import RecordingPart, cut_into_parts, share_parts


class BatchProgress(NamedTuple):
    """How many frames of the job are done, of these failed, and there in all."""

    done: int
    failed: int
    total: int


@dataclasses.dataclass(frozen=True)
class BatchOutcome:
    """What became of the frames of a job.

    frames, failed, tracks : numbers of frames, of those that failed, and of tracks in all.
    suspect : how many frames are SUSPECT, as they do not seem to belong to the rig.
    uncertain : how many frames are UNCERTAIN, to be used with care.
    earlier : how many of the frames an earlier run had done.
    without : cameras of the rig of which the recording has no picture.
    workers : how many worked at once.
    """

    folder: Path
    manifest: Path
    frames: int
    failed: int
    suspect: int
    tracks: int
    earlier: int
    workers: int
    without: tuple[str, ...] = ()
    uncertain: int = 0


def match_recording(
    frames: str | os.PathLike[str],
    rig: Rig,
    out: str | os.PathLike[str],
    *,
    template: str | None = None,
    find: Mapping[str, Any] | None = None,
    depth_range_mm: tuple[float, float] | None = None,
    shard: tuple[int, int] = (1, 1),
    frames_per_file: int = 16,
    ending: str | None = None,
    threads_at_most: int | None = None,
    in_processes: bool = False,
    scheduler: str | None = None,
    memory_gb: float | None = None,
    on_progress: Callable[[BatchProgress], None] | None = None,
) -> BatchOutcome:
    """Find and match the segments of every frame of a recording, and write them to a folder.

    Parameters
    ----------
    frames : a folder, or a CSV table with the columns frame and one for each camera of the rig.
        Files are pictures, or segments as `load_segments` reads them.
    rig : the cameras; a frame needs a file of each. Cameras of which no frame has a file are left
        out where three or more have some.
    out : the folder of results. Where it holds some of the same recording, the rest is done.
    template : how the files are named, such as "{frame}_{camera}.png" or
        "{camera}/{frame}.tif"; the usual ways are tried where it is None.
    find : options of `find_segments`.
    depth_range_mm : as of `match_segments`.
    shard : (i, n), job i of n, from 1 on, which does each n-th file of results. Jobs may run at
        once and share the folder.
    frames_per_file : frames that are matched together and stand in one file of results.
    ending : ".npz" or ".parquet"; Parquet where pyarrow is installed.
    threads_at_most : threads of this process; as many as the machine has cores. Fewer are taken
        where the pictures are so large that memory would not suffice.
    in_processes : whether long recordings are given to processes of their own in place of threads:
        on two cores 1.6 times as quick. A script then needs `if __name__ == "__main__":`.
    scheduler : address of a Dask scheduler, whose workers are used in place of threads.
    memory_gb : how much memory this process may take; half of the machine's. Where it takes more,
        no part is begun before others are written.
    on_progress : called after each file of results.

    A frame that fails has a line in the manifest that says why, and does not stop the others.
    The files do not depend on threads, processes, cluster, jobs or interruptions. Whatever ends
    the program, what is written stays, and the same call goes on from there.

    Raises InputError: no frames, results of something else in `out`, another program at work there.
    """
    check_kind(rig, Rig, "rig", A_RIG)
    given = {
        "frames_per_file": frames_per_file,
        "threads_at_most": threads_at_most,
        "memory_gb": memory_gb,
    }
    for name, value in given.items():
        if value is not None and not real_number(value, name) > 0:
            raise InputError(f"{name} is {value}, but must be more than 0.")
    if ending not in (None, ".npz", ".parquet"):
        raise InputError(f'ending is "{ending}": choose ".npz" or ".parquet".')
    source = find_frames(frames, rig.names, template)
    without = tuple(name for name in rig if name not in source.views)
    rig = rig.take(source.views)
    own = share_parts(cut_into_parts(source.frames, frames_per_file), shard)
    ending = ending or _ending_there(Path(out)) or frames_ending()
    work = MatchingJob(source.folder.resolve(), rig, dict(find or {}), depth_range_mm)
    description = _description(source, work, frames_per_file, ending)
    memory = half_of_the_machine() if memory_gb is None else memory_gb * 1e9
    with open_results(Path(out), shard, description, ending) as folder:
        folder.look(own)
        earlier = folder.tally["frames"]
        left = [part for part in own if part.number not in folder.done]
        total = sum(len(part.frames) for part in own)

        def tell() -> None:
            if on_progress is not None:
                tally = folder.tally
                on_progress(BatchProgress(tally["frames"], tally["failed"], total))

        tell()
        wanted = threads_at_most or os.cpu_count() or 1
        apart = in_processes and 1 < wanted <= len(left) // FEWEST_PARTS
        affordable = affordable_processes if apart else affordable_threads
        count = min(affordable(memory, rig, wanted), max(len(left), 1))
        if scheduler is not None:
            crew = cluster(work, scheduler)
        else:
            crew = processes(work, count) if apart and count > 1 else threads(work, count)
        with crew as workers:
            most = PARTS_PER_WORKER * workers.count
            for part, future in in_window(
                workers.executor, workers.do, left, most, lambda: resident_bytes() < memory
            ):
                folder.commit(part.number, _result(part, future, workers.where), rig.names)
                tell()
        folder.order()
        tally = folder.tally
        return BatchOutcome(
            folder=folder.path,
            manifest=folder.manifest,
            frames=tally["frames"],
            failed=tally["failed"],
            suspect=tally["suspect"],
            tracks=tally["tracks"],
            earlier=earlier,
            workers=workers.count,
            without=without,
            uncertain=tally["uncertain"],
        )


def _result(part: RecordingPart, future: Future[Any], where: str) -> list[FrameMatches]:
    try:
        return future.result()
    except TrinocError:
        raise
    except Exception as error:
        if type(error).__name__ == "KilledWorker":
            said = "The workers that took this frame's part died: look at their logs for memory."
            return [FrameMatches(frame.name, said, None) for frame in part.frames]
        raise InputError(
            f"The work at {where} ended early ({type(error).__name__}: {error}): what is done is "
            "kept, and the same command goes on from there."
        ) from error


def _description(
    source: Source, work: MatchingJob, frames_per_file: int, ending: str
) -> dict[str, Any]:
    """What the results depend on, by content, so that equal ones can be told from others."""
    listed = "\n".join(f"{f.name}\t{c}\t{f.files[c]}" for f in source.frames for c in f.files)
    return {
        "format": "trinoc-recording",
        "version": 1,
        "trinoc": trinoc.__version__,
        "views": list(work.rig.names),
        "frames": len(source.frames),
        "files_sha256": hashlib.sha256(listed.encode("utf-8", "surrogateescape")).hexdigest(),
        "rig_sha256": hashlib.sha256(rig_text(work.rig).encode()).hexdigest(),
        "find": dict(sorted(work.find.items())),
        "depth_range_mm": None if work.depth_range_mm is None else list(work.depth_range_mm),
        "frames_per_file": frames_per_file,
        "ending": ending,
    }


def _ending_there(out: Path) -> str | None:
    """The ending of the results that are there: they go on as they began."""
    found = {path.suffix for path in out.glob("matches-*")} & {".npz", ".parquet"}
    return min(found, default=None)


BASE_BYTES = 700_000_000
BYTES_PER_PIXEL = 60
# Parts for each process, from which on it gains more than its start costs.
FEWEST_PARTS = 3
# Parts begun or finished and not yet written, for each worker: one to go on with.
PARTS_PER_WORKER = 2


def affordable_threads(memory_bytes: float, rig: Rig, wanted: int) -> int:
    """How many threads may look for segments at once; at least one."""
    room = (memory_bytes - BASE_BYTES) / _bytes_of_picture(rig)
    return max(1, min(wanted, int(room)))


def affordable_processes(memory_bytes: float, rig: Rig, wanted: int) -> int:
    """The same of processes, beside this one."""
    room = (memory_bytes - BASE_BYTES) / (BASE_BYTES + _bytes_of_picture(rig))
    return max(1, min(wanted, int(room)))


def _bytes_of_picture(rig: Rig) -> int:
    sizes = (rig[name].image_size_px for name in rig.names)
    return BYTES_PER_PIXEL * max(width * height for width, height in sizes)


def half_of_the_machine() -> float:
    """Half of the machine's memory in bytes; infinite where it does not say."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2
    except (AttributeError, OSError, ValueError):
        return float("inf")


def resident_bytes() -> int:
    """Memory of this process; 0 where the system does not say."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return 0

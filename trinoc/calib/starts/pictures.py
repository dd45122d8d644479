"""The board found in all pictures of all cameras, shot by shot."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from trinoc.calib.detection.detection import Detection
from trinoc.calib.detection.registry import detect_target
from trinoc.calib.starts.board_readings import find_reading
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.errors import InputError, TrinocError, check_kind

# numerical: detectors of OpenCV and NumPy leave the interpreter free while they work.
_THREADS = 4
# numerical: where a larger share of the images shows no board, its layout may mean another one.
_FEW_FOUND = 0.8

# A picture, what was found in one, something that delivers one, or nothing.
Picture = Any
Pictures = Sequence[Picture] | Mapping[str, Picture]


class FoundBoards(NamedTuple):
    """What was found, by camera and by the name of the shot.

    Fields
    ------
    shots : names of all shots, in order.
    detections : for each camera, by shot.
    failures : for (camera, shot) of every other picture, why nothing was found.
    target : the board as the images show it, which may be another reading of its layout.
    remarks : sentences on how the layout was read.
    """

    shots: tuple[str, ...]
    detections: dict[str, dict[str, Detection]]
    failures: dict[tuple[str, str], str]
    target: AbstractTarget
    remarks: tuple[str, ...] = ()


def find_boards(
    pictures: Mapping[str, Pictures],
    target: AbstractTarget,
    progress: Callable[[int, int], None] | None = None,
) -> FoundBoards:
    """Detect the board in every picture, several at a time.

    Pictures of equal names, or of equal places in lists, are of one shot; None leaves one out.
    An image that cannot be read, has another size than most of its camera, or shows no board is
    named in `failures`. Raises InputError where there is no image at all.
    """
    named = name_pictures(pictures)
    if not named or not any(named.values()):
        raise InputError("No picture was given: give each camera's pictures of the board.")
    shots = _order_names([list(own) for own in named.values()])
    jobs = [(camera, shot) for camera, own in named.items() for shot in shots if shot in own]
    detections: dict[str, dict[str, Detection]] = {camera: {} for camera in named}
    failures: dict[tuple[str, str], str] = {}

    def look(job: tuple[str, str], board: AbstractTarget) -> Detection | str:
        try:
            given = deliver(named[job[0]][job[1]])
            return given if isinstance(given, Detection) else detect_target(given, board)
        except TrinocError as error:
            return str(error)
        except Exception as error:  # one image must not end a calibration
            return (
                f"The detection stopped at {type(error).__name__} ({error}); please report it with "
                "this image."
            )

    def look_at_all(board: AbstractTarget) -> None:
        with ThreadPoolExecutor(_THREADS) as pool:
            answers = pool.map(lambda job: look(job, board), jobs)
            for done, (job, answer) in enumerate(zip(jobs, answers, strict=True), 1):
                if isinstance(answer, str):
                    failures[job] = answer
                else:
                    detections[job[0]][job[1]] = answer
                if progress is not None:
                    progress(done, len(jobs))

    look_at_all(target)
    remarks: tuple[str, ...] = ()
    if len(failures) > _FEW_FOUND * len(jobs):
        reading = find_reading(
            target, jobs, lambda job, board: isinstance(look(job, board), Detection)
        )
        if reading is not None:
            target, remarks = reading.target, (reading.sentence,)
            failures.clear()
            detections.update({camera: {} for camera in named})
            look_at_all(target)
    for camera, own in detections.items():
        for shot, why in _list_other_sizes(own).items():
            failures[camera, shot] = why
            del own[shot]
    return FoundBoards(tuple(shots), detections, failures, target, remarks)


def name_pictures(pictures: Mapping[str, Pictures]) -> dict[str, dict[str, Picture]]:
    """For each camera its pictures by the name of the shot, as they were given."""
    return {camera: _name_pictures(camera, given) for camera, given in pictures.items()}


def deliver(given: Picture) -> Any:
    """An array or a detection, from what may be a function that delivers it."""
    return given() if callable(given) else given


def _name_pictures(camera: str, given: Pictures) -> dict[str, Picture]:
    if isinstance(given, Mapping):
        pairs = list(given.items())
    elif isinstance(given, np.ndarray) and given.ndim < 3:
        raise InputError(
            f'Camera "{camera}" has one picture, not a list: put the pictures of its shots in one.'
        )
    else:
        what = f'set of pictures of "{camera}"'
        check_kind(given, (Sequence, np.ndarray), what, "a list of pictures, or one by shot")
        width = len(str(len(given)))
        pairs = [(f"shot {k + 1:0{width}d}", item) for k, item in enumerate(given)]
    return {str(name): item for name, item in pairs if item is not None}


def _order_names(lists: list[list[str]]) -> list[str]:
    """All names: in the order of the lists where that is one order, else sorted."""
    longest = max(lists, key=len)
    rest = sorted({name for own in lists for name in own} - set(longest))
    return longest if not rest else sorted([*longest, *rest])


def _list_other_sizes(detections: Mapping[str, Detection]) -> dict[str, str]:
    """The reason to refuse each shot whose image has another size than most of its camera."""
    sizes = {shot: tuple(each.image_size_px) for shot, each in detections.items()}
    if not sizes:
        return {}
    usual, count = Counter(sizes.values()).most_common(1)[0]
    return {
        shot: f"The image has {_size(size)} pixels, but {count} of the camera's {len(sizes)} "
        f"images have {_size(usual)}: use images of one resolution."
        for shot, size in sizes.items()
        if size != usual
    }


def _size(size: tuple[int, ...]) -> str:
    return f"{size[0]} x {size[1]}"

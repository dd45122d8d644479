"""The board found in all pictures of all cameras, shot by shot."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from trinoc.calib.detection.detection import Detection
from trinoc.calib.detection.marker_readings import MOST_IMAGES, ReadingSearch
from trinoc.calib.detection.registry import detect_or_explain
from trinoc.calib.starts.board_readings import find_charuco_reading, find_reading
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.board_set import BoardSet
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.errors import InputError, TrinocError, check_kind
from trinoc.image.grey import grey_image

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
    causes : for a camera, the picture that shows a board which is almost the stated one, and the
        sentence on it.
    """

    shots: tuple[str, ...]
    detections: dict[str, dict[str, Detection]]
    failures: dict[tuple[str, str], str]
    target: AbstractTarget
    remarks: tuple[str, ...] = ()
    causes: Mapping[str, str] = MappingProxyType({})


def find_boards(
    pictures: Mapping[str, Pictures],
    target: AbstractTarget,
    progress: Callable[[int, int], None] | None = None,
    *,
    tuning: CalibTuning = TUNING,
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
            if isinstance(given, Detection):
                return given
            return detect_or_explain(given, board, None, tuning=tuning)
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

    def load(job: tuple[str, str]) -> Any:
        try:
            given = deliver(named[job[0]][job[1]])
            return None if isinstance(given, Detection) else grey_image(np.asarray(given)).grey
        except Exception:  # `failures` names what cannot be read
            return None

    for which in _unseen_boards(target, detections, len(failures) > _FEW_FOUND * len(jobs)):
        reading = find_charuco_reading(target, which, list(failures), load, tuning)
        if reading is not None:
            target, remarks = reading.target, (*remarks, reading.sentence)
            failures.clear()
            detections.update({camera: {} for camera in named})
            look_at_all(target)
    causes = _explain_failures(target, failures, load, tuning)
    for camera, own in detections.items():
        for shot, why in _list_other_sizes(own).items():
            failures[camera, shot] = why
            del own[shot]
    return FoundBoards(tuple(shots), detections, failures, target, remarks, causes)


def _unseen_boards(
    target: AbstractTarget, detections: Mapping[str, Mapping[str, Detection]], few_found: bool
) -> list[int]:
    """The boards of a set that no image shows; a board alone where few images show it."""
    if not isinstance(target, BoardSet):
        return [0] if few_found else []
    every = [each.circle_index for own in detections.values() for each in own.values()]
    seen = set(target.board_of_point[np.concatenate(every)].tolist()) if every else set()
    return [which for which in range(len(target.boards)) if which not in seen]


def _explain_failures(
    target: AbstractTarget,
    failures: dict[tuple[str, str], str],
    load: Callable[[tuple[str, str]], Any],
    tuning: CalibTuning,
) -> dict[str, str]:
    """Name the board that failed images show in place of a stated one, and the first by camera."""
    search, causes = ReadingSearch(target, tuning=tuning), {}
    for camera in {camera: None for camera, _ in failures}:
        shots = [shot for name, shot in failures if name == camera]
        # All readings are tried in the first images: they are taken from the whole recording.
        spread = np.unique(np.linspace(0, len(shots) - 1, MOST_IMAGES).astype(int)).tolist()
        for k in [*spread, *sorted(set(range(len(shots))) - set(spread))]:
            if search.is_over(camera):
                break
            image = load((camera, shots[k]))
            reading = None if image is None else search.find(image, camera)
            if reading is not None:
                failures[camera, shots[k]] = reading.sentence
                causes.setdefault(camera, f"In {shots[k]}: {reading.sentence}")
    return causes


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

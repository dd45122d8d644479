"""Detection of the board in all images of all cameras, shot by shot."""

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

# numerical: detectors in OpenCV and NumPy release the interpreter lock.
_THREADS = 4
# numerical: if a larger share of the images shows no board, its layout may be wrong.
_FEW_FOUND = 0.8

# An image, its detection, a function that returns one of these, or None.
Picture = Any
Pictures = Sequence[Picture] | Mapping[str, Picture]


class BoardDetections(NamedTuple):
    """Detections of the board in all images of all cameras.

    Attributes
    ----------
    shots : names of all shots, in order.
    detections : detection of each camera (outer key) in each shot (inner key).
    failures : reason for each image (camera, shot) without a detection.
    target : the board as the images show it. Its layout may differ from the given one.
    remarks : sentences on the difference between both layouts; empty if there is none.
    causes : possible cause of the failures of a camera (key): a sentence that an image shows a
        board similar to the given one.
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
) -> BoardDetections:
    """Detect the board in every image, on several threads.

    Parameters
    ----------
    pictures : images of each camera. Images with the same name, or at the same position in lists,
        belong to one shot. None marks a missing image.
    target : the board.
    progress : called after each image with the number of processed images and the number of all
        images.
    tuning : constants of the detection.

    Returns
    -------
    The detections. Its `failures` contain each image that cannot be read, shows no board, or has
    another size than most images of its camera.

    Raises
    ------
    InputError : there is no image.
    """
    images_by_camera = name_pictures(pictures)
    if not images_by_camera or not any(images_by_camera.values()):
        raise InputError("No image was given: give each camera's images of the board.")
    shots = _order_names([list(images_by_shot) for images_by_shot in images_by_camera.values()])
    jobs = [
        (camera, shot)
        for camera, images_by_shot in images_by_camera.items()
        for shot in shots
        if shot in images_by_shot
    ]
    detections: dict[str, dict[str, Detection]] = {camera: {} for camera in images_by_camera}
    failures: dict[tuple[str, str], str] = {}

    def look(job: tuple[str, str], board: AbstractTarget) -> Detection | str:
        try:
            image = deliver(images_by_camera[job[0]][job[1]])
            if isinstance(image, Detection):
                return image
            return detect_or_explain(image, board, None, tuning=tuning)
        except TrinocError as error:
            return str(error)
        except Exception as error:  # one image must not end a calibration
            return (
                f"The detection failed with {type(error).__name__} ({error}). Please report this "
                "error with this image."
            )

    def look_at_all(board: AbstractTarget) -> None:
        with ThreadPoolExecutor(_THREADS) as pool:
            results = pool.map(lambda job: look(job, board), jobs)
            for count, (job, result) in enumerate(zip(jobs, results, strict=True), 1):
                if isinstance(result, str):
                    failures[job] = result
                else:
                    detections[job[0]][job[1]] = result
                if progress is not None:
                    progress(count, len(jobs))

    look_at_all(target)
    remarks: tuple[str, ...] = ()
    if len(failures) > _FEW_FOUND * len(jobs):
        reading = find_reading(
            target, jobs, lambda job, board: isinstance(look(job, board), Detection)
        )
        if reading is not None:
            target, remarks = reading.target, (reading.sentence,)
            failures.clear()
            detections.update({camera: {} for camera in images_by_camera})
            look_at_all(target)

    def load(job: tuple[str, str]) -> Any:
        try:
            image = deliver(images_by_camera[job[0]][job[1]])
            return None if isinstance(image, Detection) else grey_image(np.asarray(image)).grey
        except Exception:  # `failures` names what cannot be read
            return None

    for board in _unseen_boards(target, detections, len(failures) > _FEW_FOUND * len(jobs)):
        reading = find_charuco_reading(target, board, list(failures), load, tuning)
        if reading is not None:
            target, remarks = reading.target, (*remarks, reading.sentence)
            failures.clear()
            detections.update({camera: {} for camera in images_by_camera})
            look_at_all(target)
    causes = _explain_failures(target, failures, load, tuning)
    for camera, images_by_shot in detections.items():
        for shot, reason in _list_other_sizes(images_by_shot).items():
            failures[camera, shot] = reason
            del images_by_shot[shot]
    return BoardDetections(tuple(shots), detections, failures, target, remarks, causes)


def _unseen_boards(
    target: AbstractTarget, detections: Mapping[str, Mapping[str, Detection]], few_found: bool
) -> list[int]:
    """Indices of the boards that no image shows, if the target consists of several boards.

    For a single board: [0] if few images show it, else empty.
    """
    if not isinstance(target, BoardSet):
        return [0] if few_found else []
    indices = [
        detection.circle_index for shots in detections.values() for detection in shots.values()
    ]
    detected = set(target.board_of_point[np.concatenate(indices)].tolist()) if indices else set()
    return [board_index for board_index in range(len(target.boards)) if board_index not in detected]


def _explain_failures(
    target: AbstractTarget,
    failures: dict[tuple[str, str], str],
    load: Callable[[tuple[str, str]], Any],
    tuning: CalibTuning,
) -> dict[str, str]:
    """Find out whether images without a detection show a similar board instead of the given one.

    Returns one sentence for each camera with such an image. The reasons of these images in
    `failures` are replaced by such a sentence.
    """
    search, causes = ReadingSearch(target, tuning=tuning), {}
    for camera in {camera: None for camera, _ in failures}:
        shots = [shot for name, shot in failures if name == camera]
        # All readings are tried in the first images, which are spread over the whole recording.
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
    """Images of each camera (outer key) by the name of the shot (inner key)."""
    return {
        camera: _name_pictures(camera, camera_pictures)
        for camera, camera_pictures in pictures.items()
    }


def deliver(picture: Picture) -> Any:
    """Return an image or detection; a function without arguments is called first."""
    return picture() if callable(picture) else picture


def _name_pictures(camera: str, pictures: Pictures) -> dict[str, Picture]:
    if isinstance(pictures, Mapping):
        pairs = list(pictures.items())
    elif isinstance(pictures, np.ndarray) and pictures.ndim < 3:
        raise InputError(
            f'Camera "{camera}" has one image, but must have a list of images: give a list of the '
            "images of its shots."
        )
    else:
        kind = f'set of images of "{camera}"'
        check_kind(
            pictures,
            (Sequence, np.ndarray),
            kind,
            "a list of images, or a dictionary of shot names and images",
        )
        width = len(str(len(pictures)))
        pairs = [(f"shot {k + 1:0{width}d}", item) for k, item in enumerate(pictures)]
    return {str(name): item for name, item in pairs if item is not None}


def _order_names(lists: list[list[str]]) -> list[str]:
    """All names of several lists, in the order of the longest list if it contains all of them.

    Otherwise they are sorted.
    """
    longest = max(lists, key=len)
    rest = sorted({name for names in lists for name in names} - set(longest))
    return longest if not rest else sorted([*longest, *rest])


def _list_other_sizes(detections: Mapping[str, Detection]) -> dict[str, str]:
    """Reason to reject each image whose size differs from that of most images of its camera, by
    shot.
    """
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

"""The pictures of many shots: a folder or a pattern of file names for each camera."""

import glob
import itertools
import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from trinoc.errors import InputError
from trinoc.io.images import IMAGE_SUFFIXES, read_image

Shots = dict[str, dict[str, Callable[[], np.ndarray]]]


def load_shots(places: Mapping[str, str | os.PathLike[str]]) -> Shots:
    """For each camera by name, functions that read its pictures, by the name of the shot.

    A place is a folder of pictures or a pattern such as "shots/left*.png". Pictures are of one shot
    where their names agree, apart from what all names of a camera begin and end with: left_07.png
    and right_07.png are of the shot "07". Nothing is read yet. Raises InputError for a place
    without pictures, and for two cameras that were given one place.
    """
    files = {camera: _files(camera, os.fspath(place)) for camera, place in places.items()}
    owner: dict[Path, str] = {}
    for camera, own in files.items():
        for file in own:
            other = owner.setdefault(file.resolve(), camera)
            if other != camera:
                raise InputError(
                    f'{file} is a picture of "{other}" and of "{camera}": give each camera its own.'
                )
    names = _names({camera: [file.stem for file in own] for camera, own in files.items()})
    return {
        camera: {
            name: partial(read_image, file) for name, file in zip(names[camera], own, strict=True)
        }
        for camera, own in files.items()
    }


def _files(camera: str, place: str) -> list[Path]:
    if os.path.isdir(place):
        found = [file for file in Path(place).iterdir() if file.suffix.lower() in IMAGE_SUFFIXES]
    else:
        found = [Path(file) for file in glob.glob(place) if os.path.isfile(file)]
    if not found:
        raise InputError(
            f'{place} holds no picture of "{camera}": give a folder of pictures, or a pattern such '
            "as 'shots/left*.png' in quotes."
        )
    return sorted(found)


def _names(stems: dict[str, list[str]]) -> dict[str, list[str]]:
    """Names of the shots: the stems where cameras share some, else what differs in them."""
    whole = [set(own) for own in stems.values()]
    if len(stems) == 1 or set.intersection(*whole):
        return stems
    return {camera: _without_common(own) for camera, own in stems.items()}


def _without_common(stems: list[str]) -> list[str]:
    """What is left of texts without what all of them begin and end with.

    Digits are kept whole: of 09 and 10, as of 10 and 11, both digits are left.
    """
    if len(stems) == 1:
        return ["".join(letter for letter in stems[0] if letter.isdigit()) or stems[0]]
    start = _common_length(stems)
    while start and stems[0][start - 1].isdigit():
        start -= 1
    left = [stem[start:] for stem in stems]
    end = _common_length([stem[::-1] for stem in left])
    while end and left[0][-end].isdigit():
        end -= 1
    cut = [stem[: len(stem) - end] for stem in left]
    return cut if all(cut) else left


def _common_length(texts: list[str]) -> int:
    """How many letters all texts begin with."""
    columns = zip(*texts, strict=False)
    return sum(1 for _ in itertools.takewhile(lambda column: len(set(column)) == 1, columns))

"""Shots that are kept as they come, in folders that `trinoc calibrate-rig` takes as they are."""

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

import numpy as np

from trinoc.errors import InputError
from trinoc.io.images import read_image, write_picture
from trinoc.io.videos import expect_folder_name
from trinoc.serving.sources import Moment


class KeptShots:
    """A folder with a folder for each camera, or of one camera that has no name (""), itself."""

    def __init__(self, folder: Path, cameras: Sequence[str]) -> None:
        self.folder = folder
        self.places = {name: folder / name if name else folder for name in cameras}
        self._written: list[Path] = []
        self._names: dict[str, str] = {}
        for name in filter(None, cameras):
            expect_folder_name(name)

    @property
    def written(self) -> list[Path]:
        """What to say of the files that were written: of several cameras their folder."""
        return [self.folder] if self._written and "" not in self.places else self._written

    def names(self) -> list[str]:
        """The names of the shots that are there, in their order."""
        return sorted(
            {path.stem for own in self.places.values() for path in own.glob("shot_*.png")}
        )

    def read(self) -> Iterator[Moment]:
        """The shots that are there. Raises InputError for a picture that is none."""
        for name in self.names():
            files = {camera: own / f"{name}.png" for camera, own in self.places.items()}
            there = {camera: file for camera, file in files.items() if file.exists()}
            yield Moment(name, {camera: read_image(file) for camera, file in there.items()})

    def keep(self, moment: Moment, cameras: Collection[str]) -> str:
        """Write the pictures of these cameras; the name of the shot, the same for a moment that is
        kept again. Raises InputError."""
        pictures = {camera: _expect_whole_numbers(moment, camera) for camera in cameras}
        if moment.name not in self._names:
            numbers = (name.removeprefix("shot_") for name in self.names())
            last = max((int(number) for number in numbers if number.isdecimal()), default=0)
            self._names[moment.name] = f"shot_{last + 1:04d}"
        name = self._names[moment.name]
        for camera, picture in pictures.items():
            place = self.places[camera] / f"{name}.png"
            place.parent.mkdir(parents=True, exist_ok=True)
            write_picture(place, picture)
            if place not in self._written:
                self._written.append(place)
        return name


def _expect_whole_numbers(moment: Moment, camera: str) -> np.ndarray:
    picture = moment.pictures[camera]
    if isinstance(picture, InputError) or picture.dtype not in (np.uint8, np.uint16):
        raise InputError(
            f"{moment.name} holds real numbers, which a PNG cannot: give pictures of 8 or 16 bit, "
            "or calibrate from the folders themselves by trinoc calibrate-rig."
        )
    return picture

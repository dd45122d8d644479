"""Saved shots, in folders that `trinoc calibrate-rig` reads directly."""

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

import numpy as np

from trinoc.errors import InputError
from trinoc.io.images import read_image, write_picture
from trinoc.io.videos import expect_folder_name
from trinoc.serving.sources import Moment


class KeptShots:
    """Folder of saved shots, with one folder per camera.

    A single unnamed camera ("") has no folder of its own.
    """

    def __init__(self, folder: Path, cameras: Sequence[str]) -> None:
        self.folder = folder
        self.folders = {name: folder / name if name else folder for name in cameras}
        self._written: list[Path] = []
        self._names: dict[str, str] = {}
        for name in filter(None, cameras):
            expect_folder_name(name)

    @property
    def written(self) -> list[Path]:
        """Paths that a command reports as written; empty if nothing was saved.

        For a single unnamed camera these are the image files, otherwise the folder of all cameras.
        """
        return [self.folder] if self._written and "" not in self.folders else self._written

    def names(self) -> list[str]:
        """Names of the saved shots, such as "shot_0001", in order."""
        return sorted(
            {path.stem for folder in self.folders.values() for path in folder.glob("shot_*.png")}
        )

    def read(self) -> Iterator[Moment]:
        """Yield the saved shots in order. Raises InputError if an image is not readable."""
        for name in self.names():
            files = {camera: folder / f"{name}.png" for camera, folder in self.folders.items()}
            existing = {camera: file for camera, file in files.items() if file.exists()}
            yield Moment(name, {camera: read_image(file) for camera, file in existing.items()})

    def keep(self, moment: Moment, cameras: Collection[str]) -> str:
        """Save the images of some cameras at one moment, and return the name of the shot.

        The same moment saved again keeps its name. Raises InputError if the images are not 8 or 16
        bit.

        cameras : names of the cameras whose images are saved.
        """
        pictures = {camera: _expect_whole_numbers(moment, camera) for camera in cameras}
        if moment.name not in self._names:
            numbers = (name.removeprefix("shot_") for name in self.names())
            last_number = max((int(number) for number in numbers if number.isdecimal()), default=0)
            self._names[moment.name] = f"shot_{last_number + 1:04d}"
        name = self._names[moment.name]
        for camera, picture in pictures.items():
            path = self.folders[camera] / f"{name}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_picture(path, picture)
            if path not in self._written:
                self._written.append(path)
        return name


def _expect_whole_numbers(moment: Moment, camera: str) -> np.ndarray:
    picture = moment.pictures[camera]
    if isinstance(picture, InputError) or picture.dtype not in (np.uint8, np.uint16):
        raise InputError(
            f"{moment.name} has real numbers, which a PNG file cannot store. Give pictures of 8 or "
            "16 bit, or run trinoc calibrate-rig on the folders."
        )
    return picture

"""Words by which files, folders and columns name the cameras of a rig."""

from collections import Counter
from collections.abc import Sequence


def camera_words(cameras: Sequence[str]) -> dict[str, str]:
    """The camera that each word names.

    A camera has its own name. Models of COLMAP name cameras after files, "robot/8461.png": where no
    other camera has the same, the last part "8461.png" and its stem "8461" name it, too.
    """
    words: dict[str, str] = {}
    last = {camera: camera.rpartition("/")[2] for camera in cameras}
    stem = {camera: part.rpartition(".")[0] or part for camera, part in last.items()}
    for short in (stem, last, {camera: camera for camera in cameras}):
        count = Counter(short.values())
        words |= {word: camera for camera, word in short.items() if word and count[word] == 1}
    return words

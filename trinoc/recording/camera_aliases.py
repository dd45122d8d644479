"""Names and short names of cameras in files, folders and columns."""

from collections import Counter
from collections.abc import Sequence


def camera_aliases(cameras: Sequence[str]) -> dict[str, str]:
    """Map each name and each short name to its camera.

    A camera always has its full name. COLMAP names cameras after files, such as "robot/8461.png";
    the short names "8461.png" and "8461" are included if no other camera has the same.
    """
    aliases: dict[str, str] = {}
    last_part = {camera: camera.rpartition("/")[2] for camera in cameras}
    stem = {camera: part.rpartition(".")[0] or part for camera, part in last_part.items()}
    for names in (stem, last_part, {camera: camera for camera in cameras}):
        count = Counter(names.values())
        aliases |= {alias: camera for camera, alias in names.items() if alias and count[alias] == 1}
    return aliases

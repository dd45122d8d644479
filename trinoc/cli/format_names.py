"""The formats that `trinoc export` offers, known before anything is imported."""

from typing import Annotated, Literal

import tyro

ReadFormat = Literal[
    "opencv",
    "ros",
    "kalibr",
    "colmap",
    "colmap-text",
    "mrcal",
    "matlab",
    "nerfstudio",
    "tf",
    "lsd",
    "elsed",
    "limap-segments",
]
WrittenFormat = Literal[
    "opencv",
    "ros",
    "kalibr",
    "colmap",
    "colmap-text",
    "mrcal",
    "matlab",
    "nerfstudio",
    "tf",
    "ply",
    "obj",
    "gltf",
    "dxf",
    "csv",
    "parquet",
    "limap",
    "json",
    "lsd",
    "elsed",
    "limap-segments",
]
UnitMm = Annotated[
    float | None, tyro.conf.arg(metavar="MM", help_behavior_hint="(default: of the format)")
]

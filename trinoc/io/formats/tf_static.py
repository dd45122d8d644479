"""Poses as static transforms of ROS: a `tf2_msgs/TFMessage` as YAML or JSON.

`ros2 topic pub -1 /tf_static tf2_msgs/msg/TFMessage "$(cat FILE)"` accepts both. The JSON also has
the arguments of `static_transform_publisher` for each camera, as in a launch file. Each transform
is the pose world_from_cam of the frame NAME_optical_frame (x right, y down, z forward) in the frame
`world`. Lenses are not included.

By REP 103 a frame without this ending looks along x, with z up. It is the body of the camera, and
no camera is read from it.
"""

import json
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from trinoc.errors import InputError, list_names
from trinoc.geometry.camera import Camera
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.io.atomic import write_text
from trinoc.io.formats.format import COVARIANCE, LENSES, METRE_MM, Format, Lenses
from trinoc.io.formats.keys import Keys
from trinoc.io.formats.motions import (
    chain_motions,
    inverse,
    motion,
    quaternion_wxyz,
    rotation_of_quaternion,
)
from trinoc.io.formats.notations import read_json, read_yaml_stream
from trinoc.io.formats.text_files import yaml_text
from trinoc.io.json_document import Block

WORLD = "world"
SUFFIXES = ("_optical_frame", "_optical")
KEYS = Keys(read=("header", "child_frame_id", "transform"))


def write_tf(rig: Rig, path: Path, unit_mm: float) -> None:
    """Write the poses world_from_cam as static transforms; translations in units of `unit_mm`.

    Raise `InputError` for a camera name that cannot be the name of a TF frame.
    """
    transforms = []
    for name, camera in rig.items():
        if name == WORLD or any(letter.isspace() or letter == "/" for letter in name):
            raise InputError(
                f'The name of the camera "{name}" is not allowed for a frame of TF: rename the '
                "camera."
            )
        transforms.append(_transform(name, inverse(np.asarray(camera.cam_from_world)), unit_mm))
    if path.suffix.lower() != ".json":
        write_text(path, yaml_text({"transforms": transforms}))
        return
    arguments = {name: _arguments(entry) for name, entry in zip(rig, transforms, strict=True)}
    document = {"transforms": transforms, "static_transform_publisher": arguments}
    write_text(path, json.dumps(document, indent=2, ensure_ascii=False) + "\n")


def read_tf(path: Path, unit_mm: float, lenses: Lenses | None) -> Rig:
    """Read the poses of the cameras in `lenses`, and return a rig with these lenses.

    The world is the frame at the root of the tree of transforms, which must be the same for all
    cameras.
    """
    if not lenses:
        raise InputError(f"{path} contains only poses: give the lenses, too (--lens rig.json).")
    is_json = path.suffix.lower() == ".json"
    documents = [read_json(path)] if is_json else read_yaml_stream(path)
    parents = _parents(documents, unit_mm)
    cameras, roots = {}, set()
    for name, frame in _find_frames(lenses, parents, path).items():
        world_from_cam = np.eye(3, 4)
        for _ in parents:
            frame, parent_from_frame = parents[frame]
            world_from_cam = chain_motions(parent_from_frame, world_from_cam)
            if frame not in parents:
                break
        else:
            raise InputError(f"{path}: the parent frames of {frame} form a cycle: correct this.")
        roots.add(frame)
        cameras[name] = Camera(lenses[name], Pose(inverse(world_from_cam)))
    if len(roots) > 1:
        raise InputError(
            f"{path}: the frames of the cameras have different roots "
            f"({list_names(sorted(roots))}): add the transform between these frames."
        )
    return Rig(cameras)


def _find_frames(lenses: Lenses, parents: Collection[str], path: Path) -> dict[str, str]:
    """Name of the optical frame of each camera of `lenses`, keyed by camera, in the file's order.

    `parents` contains the names of all frames of the file. Raise `InputError` if the optical frame
    of a camera is missing, or if only the frame of its body exists.
    """
    frames = {}
    for name in lenses:
        # A lens may be named by its frame.
        endings = (*SUFFIXES, "") if name.endswith(SUFFIXES) else SUFFIXES
        frame = next((name + ending for ending in endings if name + ending in parents), None)
        if frame is None and name in parents:
            raise InputError(
                f'{path} has the frame "{name}", but no {name}{SUFFIXES[0]}: by REP 103 a frame '
                "without this ending looks along x. Add the optical frame, or rename this one if "
                "it looks along z."
            )
        if frame is None:
            raise InputError(
                f'{path} has no frame of the camera "{name}" ({name}{SUFFIXES[0]}), but '
                f"{list_names(parents)}: give the lenses under these names."
            )
        frames[name] = frame
    order = list(parents)
    return dict(sorted(frames.items(), key=lambda item: order.index(item[1])))


def _transform(name: str, world_from_cam: np.ndarray, unit_mm: float) -> dict[str, Any]:
    w, x, y, z = quaternion_wxyz(world_from_cam[:, :3]).tolist()
    position = (world_from_cam[:, 3] / unit_mm).tolist()
    return {
        "header": {"frame_id": WORLD},
        "child_frame_id": name + SUFFIXES[0],
        "transform": {
            "translation": dict(zip("xyz", position, strict=True)),
            "rotation": {"x": x, "y": y, "z": z, "w": w},
        },
    }


def _arguments(entry: dict[str, Any]) -> list[str]:
    position, turn = entry["transform"]["translation"], entry["transform"]["rotation"]
    options = {f"--{key}": value for key, value in position.items()}
    options |= {f"--q{key}": value for key, value in turn.items()}
    options |= {"--frame-id": WORLD, "--child-frame-id": entry["child_frame_id"]}
    return [str(word) for pair in options.items() for word in pair]


def _parents(documents: list[Block], unit_mm: float) -> dict[str, tuple[str, np.ndarray]]:
    """Collect (parent frame, parent_from_frame (3, 4) in mm) of each frame, from all messages.

    A file has several messages, because each publisher sends its own. Some messages are repeated.
    """
    parents: dict[str, tuple[str, np.ndarray]] = {}
    for document in documents:
        entries = document.values.get("transforms")
        if not isinstance(entries, list) or not entries:
            raise document.error(
                "transforms", "must be a list of transforms: add one for each camera."
            )
        in_message: set[str] = set()
        for number, entry in enumerate(entries):
            place = f"transforms[{number}]"
            block = KEYS.take(Block(entry if isinstance(entry, dict) else {}, document.file, place))
            child, parent = block.text("child_frame_id"), block.block("header").text("frame_id")
            pose = _pose(block, unit_mm)
            is_repeated = child in parents and not (
                parents[child][0] == parent and np.array_equal(parents[child][1], pose)
            )
            if child in in_message or is_repeated:
                raise block.error(
                    "child_frame_id",
                    f'is "{child}", the child frame of an earlier transform: remove one of the '
                    "two.",
                )
            in_message.add(child)
            parents[child] = parent, pose
    return parents


def _pose(block: Block, unit_mm: float) -> np.ndarray:
    turn, shift = (block.block("transform").block(key) for key in ("rotation", "translation"))
    quaternion = np.array([turn.number(key) for key in "wxyz"])
    translation = np.array([shift.number(key) for key in "xyz"]) * unit_mm
    where = f'{block.file}: "{block.place}"'
    return motion(rotation_of_quaternion(quaternion, where), translation, where)


tf = Format(
    name="tf",
    title="TF static transforms",
    holds=("rig",),
    reads=("rig",),
    endings=(".yaml", ".yml", ".json"),
    unit_mm=METRE_MM,
    unit_is_fixed=True,
    frames="optical frames (x right, y down, z forward) in the frame world, as world_from_cam",
    loses=(LENSES, COVARIANCE),
    write=write_tf,
    read=read_tf,
    keys={"transforms[]": KEYS},
)

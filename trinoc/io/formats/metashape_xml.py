"""Agisoft Metashape's cameras.xml (Export Cameras, Agisoft XML), read only.

A sensor has the focal length `f`, the offsets `cx`, `cy` of the principal point from the image
centre, and `b1`, `b2` (affinity and skew). Its Brown coefficients p1 and p2 are OpenCV's p2 and p1.
Fisheye lenses are of Kannala and Brandt's model. A camera has the transform into its chunk. The
chunk, or the component in it, has the transform into the world, in metres. Cameras without a
transform are not aligned and are ignored.

Source: Metashape Professional Edition User Manual, appendix on camera models.
"""

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.io.formats.format import COVARIANCE, METRE_MM, PIXEL_PITCH, Format, Lenses
from trinoc.io.formats.keys import Keys, Refused
from trinoc.io.formats.lens_rows import LensNumbers, LensRow, make_lens
from trinoc.io.formats.motions import chain_motions, checked_rotation, from_homogeneous, inverse
from trinoc.io.formats.notations import Notation, RefusedError, parse_file
from trinoc.io.json_document import Block

TITLE = "Metashape's cameras.xml"
HALF_PX = 0.5
COEFFICIENTS = ("k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
ROWS = (
    LensRow("frame", "brown_conrady", ("k1", "k2", "k3", "k4", "p2", "p1", "p3", "p4")),
    LensRow("fisheye", "kannala_brandt", COEFFICIENTS),
)
_OLD = Refused("the file is of PhotoScan's first versions: export the cameras again with Metashape")
_SHUTTER = Refused(
    "the rows are exposed one after the other (rolling shutter), which trinoc does not model: take "
    "pictures with a global shutter, or align without this correction",
    ("0", "false", "none", "disabled", ""),
)
_HANGS = Refused(
    "the pose of the camera is relative to another camera in a rig of sensors, which trinoc does "
    "not read: export the cameras without such a rig"
)
LENS_KEYS = Keys(
    read=("type", "width", "height", "f", "cx", "cy", "b1", "b2", *COEFFICIENTS),
    refused={"fx": _OLD, "fy": _OLD, "skew": _OLD._replace(harmless=("0", "0.0"))},
)
SENSOR_KEYS = Keys(
    read=(),
    left_out=("focal_length",),
    refused={
        "rolling_shutter": _SHUTTER,
        "master_id": _HANGS,
        "film_camera": Refused("trinoc does not read fiducial marks of a film", ("0", "false")),
    },
)
CAMERA_KEYS = Keys(
    read=("label", "transform", "sensor_id", "component_id"),
    # It turns pictures when they are shown: lenses and motions are those of the pictures as stored.
    left_out=("orientation",),
    refused={"rolling_shutter": _SHUTTER, "master_id": _HANGS},
)


def read_metashape(path: Path, unit_mm: float | None, lenses: Lenses | None) -> Rig:
    """Read the aligned cameras, with the camera labels as names.

    `unit_mm` is needed only if the chunk has no transform to the world. With a transform, the file
    is in metres.
    """
    chunk = parse_file(path, XML).find(".//chunk")
    if chunk is None:
        raise InputError(f"{path} has no chunk: give what Metashape exports as Agisoft XML.")
    sensors = {sensor.get("id"): sensor for sensor in chunk.iterfind("sensors/sensor")}
    components = {each.get("id"): each for each in chunk.iterfind("components/component")}
    blocks = [CAMERA_KEYS.take(_block(each, path)) for each in chunk.iterfind("cameras//camera")]
    aligned = [block for block in blocks if "transform" in block.values]
    if not aligned:
        raise InputError(f"{path} has no aligned camera: align the pictures first.")
    frames = {block.values.get("component_id") for block in aligned}
    if len(frames) > 1 and any(_motion_of(components.get(key)) is None for key in frames):
        raise InputError(
            f"{path} has components without a common frame: align all pictures in one component."
        )
    lens_of: dict[str | None, Intrinsics] = {}
    cameras: dict[str, Camera] = {}
    for block in aligned:
        name, sensor = block.text("label"), block.values.get("sensor_id")
        if name in cameras:
            raise block.error(
                "label", "is the name of an earlier camera: rename one of the two cameras."
            )
        if sensor not in lens_of:
            lens_of[sensor] = _lens(sensors.get(sensor), path, f"sensor[{sensor}]")
        frame = _motion_of(components.get(block.values.get("component_id")))
        pose = _pose(block, chunk.find("transform") if frame is None else frame, unit_mm)
        cameras[name] = Camera(lens_of[sensor], Pose(pose))
    return Rig(cameras)


def _parse_xml(text: str) -> ElementTree.Element:
    """Parse an XML text and return the root element.

    Raise `RefusedError` for declarations, whose expansion may need unlimited memory.
    """
    if re.search(r"<!(DOCTYPE|ENTITY)", text, re.IGNORECASE):
        raise RefusedError("has declarations (<!DOCTYPE>), which trinoc does not follow.")
    return ElementTree.fromstring(text)


# A survey of thousands of pictures has some megabytes.
XML = Notation("XML", _parse_xml, (ElementTree.ParseError, ValueError), 100_000_000)


def _block(element: ElementTree.Element, path: Path) -> Block:
    """Collect attributes, properties and child texts of an XML element in one `Block`.

    Error messages name the element by its label.
    """
    values = {child.tag: (child.text or "").strip() for child in element if not len(child)}
    values |= {each.get("name", ""): each.get("value") for each in element.iterfind("property")}
    values |= element.attrib
    return Block(values, str(path), element.get("label", element.tag))


def _motion_of(component: ElementTree.Element | None) -> ElementTree.Element | None:
    return None if component is None else component.find("transform")


def _numbers(block: Block, key: str, count: int) -> np.ndarray:
    """Numbers (count,) in the text under a key, separated by blanks."""
    text = block.text(key) if key in block.values else ""
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count:
        wanted = "a number" if count == 1 else f"{count} numbers"
        raise block.error(key, f'is "{text[:60]}", but must be {wanted}: correct it.')
    return Block({key: values}, block.file, block.place).numbers(key, (count,))


def _lens(sensor: ElementTree.Element | None, path: Path, who: str) -> Intrinsics:
    calibration = None if sensor is None else sensor.find("calibration[@class='adjusted']")
    if sensor is None or calibration is None:
        raise InputError(f"{path}: {who} has no adjusted calibration: align the pictures first.")
    SENSOR_KEYS.take(_block(sensor, path))
    values = _block(calibration, path)
    resolution = calibration.find("resolution")
    if resolution is None:
        resolution = sensor.find("resolution")
    sides = {} if resolution is None else dict(resolution.attrib)
    texts = LENS_KEYS.take(Block({**values.values, **sides}, str(path), who))
    number = {
        key: float(_numbers(texts, key, 1)[0]) if key in texts.values else 0.0
        for key in LENS_KEYS.read[1:]
    }
    size_px = Block({"resolution": [number["width"], number["height"]]}, str(path), who)
    width, height = size_px.image_size_px("resolution")
    numbers = LensNumbers(
        texts.text("type"),
        (number["f"] + number["b1"], number["f"]),
        (width / 2 + number["cx"], height / 2 + number["cy"]),
        number["b2"],
        [number[key] for key in COEFFICIENTS],
    )
    return make_lens(numbers, (width, height), ROWS, f"{path}: {who}", origin_px=HALF_PX)


def _pose(block: Block, frame: ElementTree.Element | None, unit_mm: float | None) -> np.ndarray:
    """Pose cam_from_world (3, 4) in mm of the camera in `block`.

    `frame` is the element with the transform from the chunk to the world, or None.
    """
    where = f'{block.file}: the camera "{block.place}"'
    if frame is None and unit_mm is None:
        raise InputError(
            f"{block.file} has no transform of the chunk, so the unit is unknown: scale the chunk "
            "with known lengths, or give the length of its unit with --unit-mm."
        )
    matrix = _numbers(block, "transform", 16).reshape(4, 4)
    if frame is None:
        return inverse(from_homogeneous(matrix, unit_mm or 1.0, where))
    parts = Block(_block(frame, Path(block.file)).values, block.file, "transform")
    unit_mm = unit_mm or METRE_MM
    scale = float(_numbers(parts, "scale", 1)[0]) if "scale" in parts.values else 1.0
    if not scale > 0:
        raise parts.error("scale", f"is {scale:g}, but must be positive: correct it.")
    rotation, shift = np.eye(3), np.zeros(3)
    if "rotation" in parts.values:
        rotation = checked_rotation(_numbers(parts, "rotation", 9).reshape(3, 3), where)
    if "translation" in parts.values:
        shift = _numbers(parts, "translation", 3) * unit_mm
    world_from_chunk = np.concatenate([rotation, shift[:, None]], axis=1)
    chunk_from_cam = from_homogeneous(matrix, scale * unit_mm, where)
    return inverse(chain_motions(world_from_chunk, chunk_from_cam))


metashape = Format(
    name="metashape",
    title=TITLE,
    reads=("rig",),
    endings=(".xml",),
    unit_mm=METRE_MM,
    states_unit=True,
    frames="pixel (0, 0) is the corner of the top-left pixel, (0.5, 0.5) its centre; x right, y "
    "down, z forward, as world_from_cam",
    loses=(COVARIANCE, PIXEL_PITCH),
    read=read_metashape,
    keys={"calibration": LENS_KEYS, "sensor": SENSOR_KEYS, "camera": CAMERA_KEYS},
)

"""Edges of single pictures: segments, junctions and image quality."""

import numpy as np

import trinoc
from golden_parts import records
from golden_parts.inputs import (
    arcs_picture,
    delivered,
    demo_segments,
    digest,
    saturated_picture,
)
from golden_parts.records import Values
from simulation.camera_picture.delivery import SRGB, Processing
from simulation.camera_picture.render import delivered_picture
from simulation.camera_picture.sensor import Sensor
from trinoc.capture.advice import next_step, summary_lines
from trinoc.capture.image_quality import measure_quality, quality_line, unreadable_quality
from trinoc.capture.measures import cover_cells, edge_blur_px, measure_exposure
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.io import demo_images, demo_pattern
from trinoc.segments import find_junctions


def segments() -> Values:
    """Segments of the demo, and of saturated, curved, coloured, 16 bit and encoded pictures."""
    images = demo_images("scene")
    upper = images["upper"]
    for view, view_segments in demo_segments().items():
        yield from records.segments(view, view_segments)
        junctions = find_junctions(view_segments)
        yield from records.fields(f"{view}.junctions", junctions, ("uv_px", "covariance_px2"))
    colour = np.stack([upper, images["left"], images["right"]], axis=-1)
    light = upper.astype(float) / 255
    curved = delivered_picture(light, Sensor(), Processing(response=SRGB()), seed=2)
    saturated, arcs = saturated_picture(), arcs_picture()
    yield "inputs", digest(colour, curved, saturated, arcs)
    barrel = Intrinsics(
        focal_length_mm=16,
        pixel_pitch_mm=(0.0162, 0.0134),
        image_size_px=(512, 480),
        distortion=(-0.15, 0.02),
    )
    for label, image, options in (
        ("arcs", arcs, {"arcs": True}),
        ("arcs of the demo", upper, {"arcs": True, "tolerance_px": 1.0}),
        ("colour", colour, {}),
        ("16 bit", (upper.astype(np.uint16) << 8) + 17, {}),
        ("saturated", saturated, {}),
        ("srgb", curved, {"response": "srgb"}),
        ("srgb saturated", np.clip(1.4 * curved.astype(float), 0, 255).astype("u1"), {
            "response": "srgb"}),
        ("distorted", upper, {"intrinsics": barrel}),
        ("strict", upper, {"false_alarms": 0.01, "least_contrast": 20.0}),
    ):  # fmt: skip
        yield from records.segments(label, trinoc.find_segments(image, **options))
    bare = trinoc.Segments.from_endpoints(np.asarray(demo_segments()["left"].endpoints_px))
    yield from records.segments("levels", trinoc.segments.with_side_levels(bare, images["left"]))
    yield from records.segments("lsd", trinoc.segments.find_segments_lsd(upper))


def capture() -> Values:
    """Quality reports of good and of bad pictures."""
    sheet, demo = trinoc.Pattern.default(), demo_images("sheet")
    pictures = {name: delivered(name)[0] for name in ("reference", "overexposed", "16 bit", "card")}
    pictures["blur 2 px"] = delivered("blur 2 px")[0]
    pictures["nothing"] = np.full((480, 512), 120, np.uint8)
    qualities = [measure_quality(name, picture, sheet) for name, picture in pictures.items()]
    qualities += [measure_quality(name, picture, demo_pattern()) for name, picture in demo.items()]
    qualities += [unreadable_quality("gone.png", sheet, "The file is no picture.")]
    for quality in qualities:
        # Records keep the names that earlier versions wrote.
        yield f"{quality.name}.places_px", quality.points_px
        yield f"{quality.name}.places_mm", quality.points_mm
        yield f"{quality.name}.of_places", quality.point_count
        names = ("kind", "refusal", "blur_px", "exposure", "lean", "faults")
        yield from records.fields(quality.name, quality, names)
        yield f"{quality.name}.line", quality_line(quality)
    yield "summary", summary_lines(qualities[:5])
    yield "next_step", next_step(qualities[:5])
    for name, picture in (*pictures.items(), *demo_images("scene").items()):
        grey = picture.astype(float)
        yield f"{name}.edge_blur_px", edge_blur_px(grey)
        yield f"{name}.exposure_of", measure_exposure(grey * (255 / np.iinfo(picture.dtype).max))
    yield "covered_cells", cover_cells(qualities[0].points_px, (512, 480))

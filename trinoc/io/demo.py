"""Bundled demo images with their true edges, and truth files of synthetic scenes."""

import os
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from trinoc.calib.targets.pattern import Pattern
from trinoc.errors import InputError
from trinoc.io.board_json import load_pattern
from trinoc.io.images import read_image
from trinoc.io.json_document import Block, read_document, write_document
from trinoc.synth.truth import SceneTruth, SeenParts

FORMAT, VERSION = "trinoc-scene-truth", 1
VIEWS = ("upper", "left", "right")


def demo_folder() -> Path:
    """Folder of the demo images inside the installed package."""
    return Path(str(resources.files("trinoc") / "synth" / "demo"))


def demo_paths(kind: str) -> dict[str, Path]:
    """Files of the demo images, keyed by view.

    Parameters
    ----------
    kind : str
        Choice of images: "sheet" for the calibration sheet, "scene" for the object.

    Returns
    -------
    dict of Path

    Raises
    ------
    InputError
        For another kind.
    """
    if kind not in ("sheet", "scene"):
        raise InputError(f'The demo has no pictures of "{kind}": give "sheet" or "scene".')
    return {view: demo_folder() / f"{kind}_{view}.png" for view in VIEWS}


def demo_images(kind: str) -> dict[str, np.ndarray]:
    """Demo images, keyed by view, (480, 512) uint8.

    Parameters
    ----------
    kind : str
        Choice of images: "sheet" for the calibration sheet, "scene" for the object.

    Returns
    -------
    dict of arrays
    """
    return {view: read_image(path) for view, path in demo_paths(kind).items()}


def demo_pattern() -> Pattern:
    """Layout of the sheet in the demo images."""
    return load_pattern(demo_folder() / "pattern.json")


def demo_truth() -> SceneTruth:
    """True edges of the demo scene, and the parts of them that each image shows."""
    return load_scene_truth(demo_folder() / "truth.json")


def load_scene_truth(path: str | os.PathLike[str]) -> SceneTruth:
    """Read the true edges of a synthetic scene from a truth.json.

    Raise `InputError` for another file.
    """
    document = read_document(path, FORMAT, VERSION)
    kinds = document.texts("edge_kinds")
    edges = document.numbers("edges_mm", (len(kinds), 2, 3))
    parts = {view: _read_seen_parts(block) for view, block in document.block("seen").blocks()}
    return SceneTruth(edges, kinds, parts)


def save_scene_truth(
    truth: SceneTruth, path: str | os.PathLike[str], about: dict[str, Any]
) -> None:
    """Write the true edges of a synthetic scene to a truth.json.

    `about` contains further keys of the file, for example the settings of the renderer.
    """
    parts_of_view = {
        view: {
            "edge": parts.edge.tolist(),
            "extent": np.round(parts.extent, 6).tolist(),
            "grey_step": np.round(parts.grey_step, 2).tolist(),
        }
        for view, parts in truth.seen.items()
    }
    document = {
        "format": FORMAT,
        "version": VERSION,
        **about,
        "edge_kinds": list(truth.edge_kinds),
        "edges_mm": np.round(truth.edges_mm, 6).tolist(),
        "seen": parts_of_view,
    }
    write_document(path, document)


def _read_seen_parts(block: Block) -> SeenParts:
    edge = block.numbers("edge", (None,))
    return SeenParts(
        edge.astype(np.int64),
        block.numbers("extent", (len(edge), 2)),
        block.numbers("grey_step", (len(edge),)),
    )

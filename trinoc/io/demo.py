"""The bundled demo pictures and their truth, and the truth files of rendered scenes."""

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
    """The folder of the demo pictures inside the installed package."""
    return Path(str(resources.files("trinoc") / "synth" / "demo"))


def demo_paths(kind: str) -> dict[str, Path]:
    """Files of the demo by view: the pictures of the "sheet" or of the "scene".

    Raises InputError for another kind.
    """
    if kind not in ("sheet", "scene"):
        raise InputError(f'The demo has no pictures of "{kind}": give "sheet" or "scene".')
    return {view: demo_folder() / f"{kind}_{view}.png" for view in VIEWS}


def demo_images(kind: str) -> dict[str, np.ndarray]:
    """Pictures of the "sheet" or of the "scene" by view, (480, 512) uint8."""
    return {view: read_image(path) for view, path in demo_paths(kind).items()}


def demo_pattern() -> Pattern:
    """The layout of the demo's sheet."""
    return load_pattern(demo_folder() / "pattern.json")


def demo_truth() -> SceneTruth:
    """The edges of the demo's scene, and what each of its pictures shows of them."""
    return load_scene_truth(demo_folder() / "truth.json")


def load_scene_truth(path: str | os.PathLike[str]) -> SceneTruth:
    """The truth of a rendered scene. Raises InputError for what is no such file."""
    document = read_document(path, FORMAT, VERSION)
    kinds = document.texts("edge_kinds")
    edges = document.numbers("edges_mm", (len(kinds), 2, 3))
    parts = {view: _read_seen_parts(block) for view, block in document.block("seen").blocks()}
    return SceneTruth(edges, kinds, parts)


def save_scene_truth(
    truth: SceneTruth, path: str | os.PathLike[str], about: dict[str, Any]
) -> None:
    """Write a scene's truth; `about` adds keys, such as how the pictures were made."""
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

"""Wire frames of simulated and rendered scenes, against true corners, edges and faces.

    python benchmarks/wireframe.py [--seeds N] [--rendered FOLDER]

Made scenes are those of benchmarks/matching.py, of seeds that nothing was tuned on; what two views
have segments of is wanted there. FOLDER holds scenes of blocks that benchmarks/render_pictures.py
rendered, a folder each; what two pictures show by 8 grey levels is wanted. Found is what lies
within 1 mm. For their errors in units of their covariance, corners are paired with true ones
within 3 mm, so that large errors are not left out. A face is true where all of its vertices lie
within 1 mm of one face of a solid.
"""

import argparse
import json
import time
from collections import Counter
from pathlib import Path

import numpy as np
from matching import VIEWS, fresh_problems
from scipy.stats import chi2
from wireframe_score import score_wireframe

import trinoc
from simulation import block_scene
from simulation.solids import Polyhedron
from trinoc.evaluation.known_shape import KnownShape
from trinoc.geometry.rig import Rig
from trinoc.io import load_scene_truth, read_image
from trinoc.io.rig_json import load_rig
from trinoc.match.tracks.matches import Matches
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.synth.truth import SegmentTruth, shown_parts_of_segments_mm

KINDS = ("table", "boxes", "boxes ej5", "boxes x4")
NEAR_MM, WIDE_MM = 1.0, 3.0


class Tally:
    """Counts and errors of several scenes."""

    def __init__(self) -> None:
        """Start with empty counts."""
        self.count: Counter[str] = Counter()
        self.error_mm: list[float] = []
        self.square: list[float] = []

    def add(
        self,
        matches: Matches,
        rig: Rig,
        shape: KnownShape,
        solids: tuple[Polyhedron, ...],
        tuning: MatchTuning = DEFAULT,
    ) -> None:
        """Add the counts and errors of one scene."""
        start = time.process_time()
        frame = trinoc.match.wireframe(matches, rig, tuning=tuning)
        self.count["ms"] += round(1e3 * (time.process_time() - start))
        near_score = score_wireframe(frame, shape, NEAR_MM)
        wide_score = score_wireframe(frame, shape, WIDE_MM)
        normalised = trinoc.evaluate(frame, shape, tolerances_mm=(NEAR_MM,)).normalised
        self.count.update(near_score.counts())
        self.error_mm.extend(near_score.error_mm)
        self.square.extend(wide_score.square)
        self.count["lines"] += normalised.lines
        self.count["lines in"] += round(normalised.lines * normalised.share_of_lines)
        self.count["true faces"] += sum(_is_face(frame.vertices_mm[f], solids) for f in frame.faces)
        self.count["let go"] += len(frame.let_go)
        self.count["scenes"] += 1

    def text(self) -> str:
        """One line with all figures."""
        n = self.count
        inside = np.array(self.square) < chi2.ppf(0.95, 3)
        return (
            f"edges {n['edges_found']} of {n['edges_wanted']}, {n['edges_extra']} extra; corners "
            f"{n['corners_found']} of {n['corners_wanted']}, {n['corners_extra']} extra, "
            f"{np.median(self.error_mm):.3f} mm, in 95 % region {inside.mean():.3f} of "
            f"{len(inside)}; lines {n['lines in'] / n['lines']:.3f} of {n['lines']}; faces "
            f"{n['true faces']} of {n['faces']} true; {n['let go']} let go; "
            f"{n['ms'] / n['scenes']:.0f} ms"
        )


def _is_face(vertices_mm: np.ndarray, solids: tuple[Polyhedron, ...]) -> bool:
    """True if one face of a solid has a vertex near each of these."""
    return any(
        (np.linalg.norm(vertices_mm[:, None] - solid.vertices_mm[list(face)], axis=2) < NEAR_MM)
        .any(axis=1)
        .all()
        for solid in solids
        for face in solid.faces
    )


def shape_of_segments(truth: SegmentTruth) -> KnownShape:
    """Known shape whose wanted parts are those that segments of two views cover."""
    labels = np.zeros_like(truth.edges_mm)
    labels[:, :, 0] = np.arange(len(labels))[:, None]
    labels[:, 1, 1] = 1.0
    parts = shown_parts_of_segments_mm(SegmentTruth(labels, truth.edge_of, truth.extent))
    edge = np.rint(parts[:, 0, 0]).astype(np.int64)
    return KnownShape(truth.edges_mm, edge, parts[:, :, 1], np.zeros((0, 3, 3)), "segments of two")


def made(kind: str, seeds: int) -> str:
    """Scenes of one kind."""
    tally = Tally()
    for _, rig, segments, truth in fresh_problems(kind, seeds):
        tally.add(trinoc.match_segments(segments, rig), rig, shape_of_segments(truth), ())
    return tally.text()


def rendered(folder: Path) -> str:
    """Scenes of pictures."""
    tally = Tally()
    for scene_folder in sorted(p.parent for p in folder.glob("*/truth.json")):
        rig, truth = (
            load_rig(scene_folder / "rig.json"),
            load_scene_truth(scene_folder / "truth.json"),
        )
        matches_file = scene_folder / "matches.npz"
        if matches_file.exists():
            matches = trinoc.load_matches(matches_file)
        else:
            pictures = {v: read_image(scene_folder / f"scene_{v}.png") for v in VIEWS}
            segments = {v: trinoc.find_segments(picture) for v, picture in pictures.items()}
            matches = trinoc.match_segments(segments, rig)
        seed = json.loads((scene_folder / "truth.json").read_text()).get("seed")
        solids = () if seed is None else block_scene(seed).solids
        boxes = tuple(solid for solid in solids if isinstance(solid, Polyhedron))
        tally.add(matches, rig, KnownShape.of_scene(truth), boxes)
    return tally.text()


def main() -> None:
    """Print a line for each kind."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--rendered", type=Path, nargs="*", default=[])
    options = parser.parse_args()
    for kind in KINDS if options.seeds else ():
        print(f"{kind}: {made(kind, options.seeds)}", flush=True)
    for folder in options.rendered:
        print(f"rendered, {folder.name}: {rendered(folder)}", flush=True)


if __name__ == "__main__":
    main()

"""Share of 95 % regions of tracks that contain the lines of a real board in three cameras.

    python benchmarks/board_as_scene.py FOLDER [--calibrate 3 7 11 15 17] [--match 1 9 13 21]

FOLDER has board.json (a chessboard) and a folder of images for each camera, as
public_sets_collect.py writes them; a shot is the number in the names of its images. The rig is
calibrated from some shots. In the others segments are found and matched, and the lines between
neighbouring corners of the board are known: by its shape as calibrated, moved to the corners that
the cameras triangulate. Tracks within 2 mm of such a line are counted.

Printed, with the covariance of the segments alone and with that of the rig: tracks, share of lines
in their 95 % regions, median chi-square over that of a normal distribution; median distance across
the line in the plane of the board, and off it, with their median sigmas, in mm.
"""

import argparse
import re
from pathlib import Path

import cv2
import numpy as np
from scipy.stats import chi2

import trinoc
from trinoc.geometry.intrinsics import undistort_pixels
from trinoc.io.board_json import load_target

NEAR_MM, PARALLEL, LONGEST_MISS_MM = 2.0, 0.985, 1.0


def images_of(folder: Path, camera: str, shots: list[int]) -> list[np.ndarray]:
    """The images of some shots, by the number in their names."""
    files = {int(re.findall(r"\d+", f.stem)[-1]): f for f in (folder / camera).iterdir()}
    return [cv2.imread(str(files[shot]), cv2.IMREAD_GRAYSCALE) for shot in shots]


def triangulate_corners(
    rig: trinoc.Rig, images: dict[str, np.ndarray], board: trinoc.Chessboard
) -> dict[int, np.ndarray]:
    """The corners that two cameras or more see, in the world, mm."""
    rays: dict[int, list[np.ndarray]] = {}
    for name, image in images.items():
        detection = trinoc.calib.detect_target(image, board)
        matrix = np.asarray(rig[name].matrix_px)
        corners = undistort_pixels(rig[name].intrinsics, np.asarray(detection.centres_px))
        for corner, (u, v) in zip(
            detection.circle_index.tolist(), np.asarray(corners), strict=True
        ):
            rows = np.stack([u * matrix[2] - matrix[0], v * matrix[2] - matrix[1]])
            rays.setdefault(corner, []).append(rows)
    points = {}
    for corner, rows in rays.items():
        if len(rows) > 1:
            point = np.linalg.svd(np.concatenate(rows))[2][-1]
            points[corner] = point[:3] / point[3]
    return points


def fit_motion(from_mm: np.ndarray, to_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and translation from points to other points, by least squares (Kabsch)."""
    middle, other = from_mm.mean(axis=0), to_mm.mean(axis=0)
    u, _, vt = np.linalg.svd((from_mm - middle).T @ (to_mm - other))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u @ flip @ vt).T
    return rotation, other - rotation @ middle


def errors_of_tracks(
    matches: trinoc.Matches, corners_mm: np.ndarray, normal: np.ndarray, square_mm: float
) -> list[tuple[float, ...]]:
    """(squared distance alone, with the rig, its limit, across, off the plane, their sigmas)."""
    distances_mm = np.linalg.norm(corners_mm[:, None] - corners_mm, axis=2)
    first, last = np.nonzero(np.triu(np.abs(distances_mm - square_mm) < 0.1 * square_mm))
    directions = (corners_mm[last] - corners_mm[first]) / distances_mm[first, last][:, None]
    rows = []
    for number in np.flatnonzero((matches.index >= 0).sum(axis=1) > 2):
        ends = matches.lines_mm[number]
        unit = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        off = ends.mean(axis=0) - corners_mm[first]
        along = (off * directions).sum(axis=1)
        miss = np.linalg.norm(off - along[:, None] * directions, axis=1)
        candidates = (np.abs(directions @ unit) > PARALLEL) & (miss < NEAR_MM) & (along > 0)
        candidates &= along < square_mm
        if not candidates.any():
            continue
        edge = np.flatnonzero(candidates)[miss[candidates].argmin()]
        across = np.cross(normal, directions[edge]) / np.linalg.norm(
            np.cross(normal, directions[edge])
        )
        axes = np.stack([across, np.cross(directions[edge], across)])
        error = ((ends - corners_mm[first[edge]]) @ axes.T).ravel()
        both = np.kron(np.eye(2), axes)
        line_covariance = both @ matches.covariance_mm2[number] @ both.T
        added = matches.rig_covariance_mm2
        total_covariance = (
            line_covariance if added is None else line_covariance + both @ added[number] @ both.T
        )
        squares = [
            float(error @ np.linalg.solve(covariance, error))
            for covariance in (line_covariance, total_covariance)
        ]
        limit = float(matches.ellipsoid_limit(0.95)[number])
        sigma = np.sqrt(np.diag(total_covariance))
        rows.append((*squares, limit, error[0], error[1], sigma[0], sigma[1]))
    return rows


def main() -> None:
    """Calibrate the rig, match the board's lines and print their errors."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--calibrate", type=int, nargs="*", default=[3, 7, 11, 15, 17, 19, 23, 25])
    parser.add_argument("--match", type=int, nargs="*", default=[1, 9, 13, 21])
    options = parser.parse_args()
    board = load_target(options.folder / "board.json")
    if not isinstance(board, trinoc.Chessboard):
        parser.error("board.json holds no chessboard")
    cameras = sorted(path.name for path in options.folder.iterdir() if path.is_dir())
    result = trinoc.calibrate_rig(
        {name: images_of(options.folder, name, options.calibrate) for name in cameras}, board
    )
    if not result.has_rig:
        raise SystemExit(result.summary())
    corners_board_mm = np.pad(np.asarray(board.centres_mm), ((0, 0), (0, 1)))
    if len(result.place_shifts_mm):
        corners_board_mm = corners_board_mm + result.place_shifts_mm
    rows: list[tuple[float, ...]] = []
    for shot in options.match:
        images = {name: images_of(options.folder, name, [shot])[0] for name in cameras}
        points = triangulate_corners(result.rig, images, board)
        corner_numbers = np.array(list(points))
        rotation, shift = fit_motion(
            corners_board_mm[corner_numbers], np.array(list(points.values()))
        )
        corners = corners_board_mm @ rotation.T + shift
        miss = np.array(list(points.values())) - corners[corner_numbers]
        if np.sqrt((miss**2).mean()) > LONGEST_MISS_MM:
            print(f"shot {shot} left out: two cameras number the corners from other ends")
            continue
        segments = {name: trinoc.find_segments(image) for name, image in images.items()}
        matches = trinoc.match_segments(segments, result.rig)
        matches = trinoc.with_rig_covariance(matches, result.rig)
        rows += errors_of_tracks(matches, corners, rotation[:, 2], board.square_mm)
    table = np.array(rows)
    print(f"{len(table)} tracks in three views on lines of the board")
    for name, square in (("segments alone", table[:, 0]), ("with the rig", table[:, 1])):
        share = (square < table[:, 2]).mean()
        print(f"{name:15s} held {share:.3f}, chi-square {np.median(square) / chi2.median(4):.2f}")
    for name, k in (("across", 3), ("off the plane", 4)):
        error, sigma = np.median(np.abs(table[:, k])), np.median(table[:, k + 2])
        print(f"{name:15s} {error:.3f} mm, sigma with the rig {sigma:.3f} mm")


if __name__ == "__main__":
    main()

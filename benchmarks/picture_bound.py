"""The Cramer-Rao bound of a picture of the sheet, from the ray caster alone.

The pictures' derivatives are central differences of `simulation.camera_picture`, so that the
bound knows nothing of the model that is fitted. Pose and nuisances (blur, ink spread, ink's grey
level, and light as a quadratic over the picture) are unknown together, as they are in the fit.
"""

from dataclasses import dataclass, replace

import numpy as np

from simulation.camera_picture.render import render_sheet
from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics

# Central differences of about a tenth of a pixel: the edge is nearly straight over them.
_STEPS = np.array([0.02, 0.02, 0.04, 0.1, 0.05, 0.05])
_BLUR_STEP_PX, _SPREAD_STEP_MM, _INK_STEP = 0.05, 0.02, 5.0


@dataclass(frozen=True)
class Scene:
    """Scene of a picture: values are pan, tilt, swing in degrees, distance, aim X, Y in mm."""

    pattern: Pattern
    lens: Intrinsics
    values: np.ndarray
    blur_px: float = 0.7
    paper: float = 230.0
    ink: float = 25.0

    @property
    def camera(self) -> Camera:
        pan, tilt, swing, distance, aim_x, aim_y = map(float, self.values)
        return Camera.from_degrees(
            self.lens,
            pan_deg=pan,
            tilt_deg=tilt,
            swing_deg=swing,
            distance_mm=distance,
            aim_mm=(aim_x, aim_y),
        )

    def picture(self, supersampling: int, covers: tuple = ()) -> np.ndarray:
        """Grey levels without noise or rounding."""
        return render_sheet(
            self.pattern,
            self.camera,
            paper=self.paper,
            ink=self.ink,
            blur_px=self.blur_px,
            supersampling=supersampling,
            covers=covers,
            bits=None,
        )

    def spread(self, step_mm: float) -> "Scene":
        """The scene with all ink grown by `step_mm`."""
        pattern = self.pattern
        hole = np.where(pattern.inner_radius_mm > 0, pattern.inner_radius_mm - step_mm, 0.0)
        half_length = tuple(half + step_mm for half in pattern.line_half_length_mm)
        gap = pattern.line_gap_mm - 2 * step_mm if pattern.line_style == "stop" else 0.0
        # White lines in circles narrow where black ones widen: their width stays as it is.
        wider = 2 * step_mm if pattern.line_style != "white" else 0.0
        grown = replace(
            pattern,
            radius_mm=pattern.radius_mm + step_mm,
            inner_radius_mm=hole,
            line_width_mm=pattern.line_width_mm + wider,
            line_half_length_mm=half_length,
            line_gap_mm=max(gap, 0.0),
        )
        return replace(self, pattern=grown)


def bound_of_image(
    scene: Scene,
    noise_sigma: float,
    parameter_count: int,
    *,
    pixel_mask: np.ndarray | None = None,
    supersampling: int = 8,
) -> np.ndarray:
    """(p,) least standard deviations of the first p values for an unbiased estimate.

    pixel_mask : (h, w) pixels that count; all if None.
    """

    def slope(first: Scene, second: Scene, step: float) -> np.ndarray:
        return (second.picture(supersampling) - first.picture(supersampling)) / (2 * step)

    def moved(k: int, step: float) -> Scene:
        values = scene.values.copy()
        values[k] += step
        return replace(scene, values=values)

    columns = [slope(moved(k, -h), moved(k, h), h) for k, h in enumerate(_STEPS[:parameter_count])]
    for name, step in (("blur_px", _BLUR_STEP_PX), ("ink", _INK_STEP)):
        low, high = (
            replace(scene, **{name: getattr(scene, name) + sign * step}) for sign in (-1, 1)
        )
        columns.append(slope(low, high, step))
    columns.append(slope(scene.spread(-_SPREAD_STEP_MM), scene.spread(_SPREAD_STEP_MM),
                         _SPREAD_STEP_MM))  # fmt: skip
    picture = scene.picture(supersampling)
    height, width = picture.shape
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    columns += [picture * term for term in (np.ones_like(x), x, y, x * x, x * y, y * y)]
    mask = np.ones(picture.shape, dtype=bool) if pixel_mask is None else pixel_mask
    jacobian = np.stack([column[mask] for column in columns], axis=1) / noise_sigma
    scale = np.linalg.norm(jacobian, axis=0)
    covariance = np.linalg.inv((jacobian / scale).T @ (jacobian / scale))
    return (np.sqrt(np.diag(covariance)) / scale)[:parameter_count]

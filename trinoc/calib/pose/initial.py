"""A first camera from the images of the crossed lines.

With a known focal length each line's image is a plane through the camera's centre. The two
planes meet in the ray to the crossing. The axes X and Y lie in one plane each and are
perpendicular, which leaves one angle free: how far the line along X runs into the depth of
the picture. The circles choose that angle, and the distance follows linearly.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.calib.model import CircleObservations
from trinoc.geometry import AbstractLens, Pose
from trinoc.numerics import ArrayLike

# Steps of 7.5 degrees: the parabola through the best three is then good to a degree or two.
_ANGLES_RAD = np.arange(48) * (2 * np.pi / 48)


def initial_pose_from_lines(
    lens: AbstractLens, circles: CircleObservations, aim_is_free: bool
) -> Pose:
    """The pose of the cross lines whose circles lie nearest to the observed ones.

    With the aim held at the origin the pose is turned until the optical axis meets the
    crossing. NaN where a line was not seen.
    """
    planes = circles.lines_px @ lens.matrix
    normal_x, normal_y = _unit(planes[0]), _unit(planes[1])
    ray = _unit(jnp.cross(normal_x, normal_y))
    ray = ray * jnp.sign(ray[2])
    rays = jax.vmap(lens.normalised_from_pixel)(circles.centres_px)
    seen = jnp.where(circles.whitening[:, 0, 0] > 0, 1.0, 0.0)

    def rotation_at(angle: Float[ArrayLike, ""]) -> Float[ArrayLike, "3 3"]:
        axis_x = jnp.cos(angle) * ray + jnp.sin(angle) * jnp.cross(normal_x, ray)
        axis_y = _unit(jnp.cross(normal_y, axis_x))
        # The camera sees the sheet from above: Z points against the ray to the crossing.
        facing = -jnp.sign(jnp.cross(axis_x, axis_y) @ ray)
        axis_y = facing * axis_y
        return jnp.stack([axis_x, axis_y, jnp.cross(axis_x, axis_y)], axis=1)

    def distance_and_misfit(
        angle: Float[ArrayLike, ""],
    ) -> tuple[Float[ArrayLike, ""], Float[ArrayLike, ""]]:
        offset = circles.centres_sheet_mm @ rotation_at(angle)[:, :2].T
        slope = ray[None, :2] - rays * ray[2]
        target = rays * offset[:, 2:] - offset[:, :2]
        weight = seen[:, None]
        distance = jnp.sum(weight * slope * target) / jnp.sum(weight * slope * slope)
        points = offset + distance * ray[None]
        in_front = (distance > 0) & jnp.all((points[:, 2] > 0) | (seen == 0))
        error = points[:, :2] / jnp.where(points[:, 2:] > 0, points[:, 2:], 1.0) - rays
        misfit = jnp.sum(seen * jnp.sum(error * error, axis=1))
        return distance, jnp.where(in_front, misfit, jnp.inf)

    misfit = jax.vmap(distance_and_misfit)(_ANGLES_RAD)[1]
    best = jnp.argmin(jnp.where(jnp.isnan(misfit), jnp.inf, misfit))
    around = misfit[(best + np.array([-1, 0, 1])) % len(_ANGLES_RAD)]
    bend = around[0] - 2 * around[1] + around[2]
    shift = jnp.where(jnp.isfinite(bend) & (bend > 0), (around[0] - around[2]) / (2 * bend), 0.0)
    angle = jnp.asarray(_ANGLES_RAD)[best] + shift * _ANGLES_RAD[1]
    rotation, distance = rotation_at(angle), distance_and_misfit(angle)[0]
    pose = Pose.from_translation(rotation, distance * ray)
    return pose if aim_is_free else pose.aimed()


def initial_pose_from_circles(
    lens: AbstractLens, circles: CircleObservations, aim_is_free: bool
) -> Pose:
    """The pose of the homography through the circles' centres (Hartley and Zisserman, 4.1).

    For a picture in which a line is hidden. Needs four circles, no three of them on a line;
    NaN where the circles do not determine a homography.
    """
    scale = jnp.sqrt(jnp.mean(jnp.square(circles.centres_sheet_mm)))
    sheet = circles.centres_sheet_mm / scale
    rays = jax.vmap(lens.normalised_from_pixel)(circles.centres_px)
    seen = jnp.where(circles.whitening[:, 0, 0] > 0, 1.0, 0.0)
    point = jnp.concatenate([sheet, jnp.ones_like(sheet[:, :1])], axis=1)
    zero = jnp.zeros_like(point)
    rows = jnp.concatenate(
        [
            jnp.concatenate([point, zero, -rays[:, :1] * sheet], axis=1),
            jnp.concatenate([zero, point, -rays[:, 1:] * sheet], axis=1),
        ]
    )
    weight = jnp.concatenate([seen, seen])[:, None]
    normal = rows.T @ (weight * rows)
    right = rows.T @ (weight[:, 0] * jnp.concatenate([rays[:, 0], rays[:, 1]]))
    homography = jnp.append(jnp.linalg.solve(normal, right), 1.0).reshape(3, 3)
    first, second = homography[:, 0] / scale, homography[:, 1] / scale
    length = jnp.sqrt(jnp.sqrt((first @ first) * (second @ second)))
    bisector, difference = _unit(_unit(first) + _unit(second)), _unit(_unit(first) - _unit(second))
    axis_x = (bisector + difference) / jnp.sqrt(2.0)
    axis_y = (bisector - difference) / jnp.sqrt(2.0)
    rotation = jnp.stack([axis_x, axis_y, jnp.cross(axis_x, axis_y)], axis=1)
    translation = homography[:, 2] / length
    pose = Pose.from_translation(rotation, translation)
    return pose if aim_is_free else pose.aimed()


def _unit(vector: Float[ArrayLike, "3"]) -> Float[ArrayLike, "3"]:
    return vector / jnp.sqrt(vector @ vector)

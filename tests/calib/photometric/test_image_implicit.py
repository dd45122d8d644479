"""Derivatives of the fitted picture agree with differences of whole fits."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.calib.photometric.pictures import (
    RIGHT,
    SIGMA_PX,
    image_of,
    picture_of,
    state_at,
)
from tests.calib.simulated import LENS, reference_sheet
from trinoc.calib.photometric.equations import Group
from trinoc.calib.photometric.implicit_diff import differentiable_fit
from trinoc.calib.photometric.ink import Drawing
from trinoc.calib.photometric.pixel_selection import group_of, select_pixels
from trinoc.calib.photometric.solver import Schedule, Stage, run_fit
from trinoc.calib.photometric.unknowns import IDEAL, PictureState
from trinoc.geometry import PoseModel
from trinoc.numerics import ArrayLike, GemanMcClure

# A part of the pixels, spread over the sheet as all are: two chunks of each group.
COUNT = 1024
STATIC = {"drawing": Drawing("stop", False), "model": PoseModel.AIMED}
# Never satisfied: steps end in rounding error.
TO_THE_END = Schedule(
    Stage(
        GemanMcClure(np.array([np.inf])), np.ones((1, 4 + IDEAL.size)), np.ones(1, dtype=np.int32)
    ),
    np.asarray(0),
    np.asarray(16),
    np.asarray(-1.0),
)
STATE = state_at(RIGHT)


@pytest.fixture(scope="module")
def groups() -> tuple[Group, ...]:
    """A noisy picture's pixels near circles and near lines, in double precision."""
    sheet = reference_sheet()
    picture = image_of(sheet, RIGHT, supersampling=8)
    picture = picture + np.random.default_rng(0).normal(0.0, 2.0, picture.shape)
    choice = select_pixels(STATE.pose, LENS.lens, sheet, LENS.image_size_px, SIGMA_PX)
    chosen = [
        part.part(np.arange(min(COUNT, len(part.row))))
        for part in (choice.near_circles, choice.near_lines)
    ]
    return tuple(group_of(part, picture, LENS.lens, sheet, COUNT, np.float64) for part in chosen)


def brighter(groups: tuple[Group, ...], change: ArrayLike) -> tuple[Group, ...]:
    """The groups with `change` (2, n) added to their grey levels."""
    return tuple(
        group._replace(pixels=group.pixels._replace(grey=group.pixels.grey + own))
        for group, own in zip(groups, change, strict=True)
    )


def numbers(state: PictureState) -> jax.Array:
    """Rotation, distance and all else in one row."""
    pose = state.pose
    parts = (pose.rotation.reshape(-1), pose.distance_mm[None], state.values)
    return jnp.concatenate(parts)


def fit_again(change: ArrayLike, groups: tuple[Group, ...]) -> PictureState:
    """Where the solver's own steps end on a brighter picture."""
    picture = picture_of(*brighter(groups, change), state=STATE)
    return run_fit(STATE, picture, TO_THE_END, **STATIC).state


@pytest.fixture(scope="module")
def followed(groups: tuple[Group, ...]) -> Callable[[ArrayLike], jax.Array]:
    """The answer, linearised at the picture as it is: a change of grey levels to one of it."""
    state = fit_again(np.zeros((2, COUNT)), groups)

    def answer(change: jax.Array) -> jax.Array:
        picture = picture_of(*brighter(groups, change), state=STATE)
        return numbers(differentiable_fit(state, picture, **STATIC))  # pyright: ignore[reportArgumentType]

    @jax.jit
    def product(change: ArrayLike) -> jax.Array:
        return jax.jvp(answer, (jnp.zeros((2, COUNT)),), (change,))[1]

    return product


@pytest.mark.slow
def test_derivatives_are_those_of_whole_fits(
    groups: tuple[Group, ...], followed: Callable[[ArrayLike], jax.Array]
) -> None:
    directions, step = np.random.default_rng(1).normal(size=(6, 2, COUNT)), 1e-2
    moved = [[numbers(fit_again(s * step * d, groups)) for s in (1, -1)] for d in directions]
    expected = np.array([(up - down) / (2 * step) for up, down in moved])
    claimed = np.array([followed(direction) for direction in directions])
    # What is left is J's own change, weighted by residuals: a percent of how far each number goes.
    error, size = (np.sqrt(np.mean(each**2, axis=0)) for each in (claimed - expected, expected))
    assert (error < 0.02 * size).all()


@pytest.mark.slow
def test_the_gradient_is_the_transpose(
    groups: tuple[Group, ...], followed: Callable[[ArrayLike], jax.Array]
) -> None:
    random = np.random.default_rng(3)
    direction, weight = random.normal(size=(2, COUNT)), random.normal(size=len(numbers(STATE)))
    state = fit_again(np.zeros((2, COUNT)), groups)

    @jax.jit
    @jax.grad
    def gradient(change: jax.Array) -> jax.Array:
        picture = picture_of(*brighter(groups, change), state=STATE)
        fit = differentiable_fit(state, picture, **STATIC)  # pyright: ignore[reportArgumentType]
        return jnp.asarray(weight) @ numbers(fit)

    found = float(jnp.sum(gradient(jnp.zeros((2, COUNT))) * direction))
    assert found == pytest.approx(float(weight @ followed(direction)), rel=1e-8)


def test_differentiating_the_steps_is_refused(groups: tuple[Group, ...]) -> None:
    def distance(change: jax.Array) -> jax.Array:
        picture = picture_of(*brighter(groups, change), state=STATE)
        return run_fit(STATE, picture, TO_THE_END, **STATIC).state.pose.distance_mm

    with pytest.raises(ValueError, match="square"):
        jax.grad(distance)(jnp.zeros((2, COUNT)))

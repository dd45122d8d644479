"""Laws of the parts: derivatives, the test of two answers, the room of a segment."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import ndtr

from trinoc.match.line_pixels.answer import hausman
from trinoc.match.line_pixels.line_fit import fit_line, offsets_of
from trinoc.match.line_pixels.neighbours import NOBODY, owners_of
from trinoc.match.line_pixels.step_edge import fit_block
from trinoc.match.line_pixels.strips import COLUMNS, HALF, ROWS
from trinoc.synth import table1_rig


def block(generator):
    """A noisy step, 0.2 px beside the line at one end and 0.1 px at the other, with blur 1.1."""
    v, u = np.mgrid[:ROWS, :COLUMNS].astype(float)
    across = (u - HALF) * 0.96 - 0.28 * (v - 2)
    share = 0.3 + 0.02 * v
    shift = 0.2 - 0.1 * share
    level = 60 + 0.4 * across + (50 - 0.2 * v) * ndtr((across - shift) / 1.1)
    return across, share, level + generator.normal(size=level.shape)


def test_the_gradient_of_a_block_is_that_of_its_reduced_sum_of_squares():
    across, share, level = block(np.random.default_rng(1))
    usable, reach = np.ones(level.shape, bool), np.ones(COLUMNS, bool)

    def fitted(place):
        core, slopes = jnp.array([2.2, 0.7]), jnp.array([1e6, 1e6])
        return jax.jit(fit_block)(core, slopes, across, share, level, usable, reach, place, 1.0)

    place, step = jnp.array([0.1, 0.05, 0.0]), 1e-5
    numeric = [
        (fitted(place - h).square - fitted(place + h).square) / (4 * step)
        for h in step * jnp.eye(3)
    ]
    np.testing.assert_allclose(fitted(place).gradient, numeric, rtol=1e-4, atol=1e-4)
    # Information is what remains when levels are eliminated: positive, and less than without.
    assert np.linalg.eigvalsh(np.asarray(fitted(place).information))[0] > -1e-9


def test_a_line_is_found_again_from_its_images():
    rig = table1_rig()
    matrices = np.stack([np.asarray(rig[name].matrix_px) for name in rig.names])
    ends = np.array([[-10.0, 3.0, 2.0], [25.0, -8.0, 20.0]])
    way = ends[1] - ends[0]
    axes = np.linalg.svd(way[None])[2][1:]
    move = np.array([0.4, -0.2, 0.1, 0.3])
    true = ends + move.reshape(2, 2) @ axes
    image = np.einsum("vij,ej->vei", matrices[:, :, :3], ends) + matrices[:, None, :, 3]
    places = image[..., :2] / image[..., 2:]
    unit = places[:, 1] - places[:, 0]
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    right = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    offset = jax.vmap(offsets_of, (None, 0, 0, 0))(true, matrices, places, right)
    found = fit_line(ends, axes, matrices, places, right, offset, np.tile(np.eye(2), (3, 1, 1)))
    np.testing.assert_allclose(found.move_mm, move, atol=1e-8)
    assert found.misfit < 1e-12


def test_the_difference_of_two_answers_is_a_chi_square():
    generator = np.random.default_rng(2)
    # A mean of ten, against a mean of the first five: the former is efficient.
    data = generator.normal(size=(4000, 10, 2))
    difference = data.mean(axis=1) - data[:, :5].mean(axis=1)
    usual, efficient = (np.tile(np.eye(2) / n, (4000, 1, 1)) for n in (5, 10))
    square = hausman(difference, usual, efficient, 0.1)
    assert abs(square.mean() - 2) < 0.15
    assert abs(np.mean(square > 5.991) - 0.05) < 0.02


def test_owners_are_the_segments_within_reach():
    ends = np.array([[[20.0, 20.0], [60.0, 20.0]], [[58.0, 26.0], [58.0, 50.0]]])
    first, last = owners_of(ends, (80, 64), 4.0)
    assert (first[20, 30], last[20, 30]) == (0, 0)
    assert (first[40, 58], last[40, 58]) == (1, 1)
    assert (first[23, 58], last[23, 58]) == (0, 1)
    assert first[40, 20] == last[40, 20] == NOBODY
    # One beyond the picture owns nothing, and disturbs nothing.
    outside = owners_of(ends + 500.0, (80, 64), 4.0)
    assert (outside[1] == NOBODY).all()

"""Polygonal approximation of chains by iterative end-point fit.

R. O. Duda and P. E. Hart, "Pattern classification and scene analysis", 1973, 7.5; the rule
that Nevatia and Babu use. All chains are split together, one level per round.
"""

import numpy as np
from jaxtyping import Float, Int

from trinoc.numerics import largest, members


def split_chains(
    uv_px: Float[np.ndarray, "n 2"],
    starts: Int[np.ndarray, "c"],
    tolerance_px: float,
    least_points: int,
) -> tuple[Int[np.ndarray, "r"], Int[np.ndarray, "r"]]:
    """(start, stop) of runs of points within `tolerance_px` of the chord of their ends.

    `uv_px` are the points chain by chain. Runs with fewer than `least_points` points are
    dropped on the way.
    """
    start, stop = starts, np.append(starts[1:], len(uv_px))
    u, v = (np.ascontiguousarray(column) for column in uv_px.T)
    done: list[tuple[np.ndarray, np.ndarray]] = []
    while True:
        long_enough = stop - start >= least_points
        start, stop = start[long_enough], stop[long_enough]
        if len(start) == 0:
            break
        index, run, first = members(start, stop)
        count = stop - start
        begin_u, begin_v = u[start], v[start]
        chord_u, chord_v = u[stop - 1] - begin_u, v[stop - 1] - begin_v
        length = np.maximum(np.hypot(chord_u, chord_v), np.float32(1e-9))
        normal_u, normal_v = -chord_v / length, chord_u / length
        from_begin = normal_u * begin_u + normal_v * begin_v
        distance = u[index] * np.repeat(normal_u, count) + v[index] * np.repeat(normal_v, count)
        distance = np.abs(distance - np.repeat(from_begin, count))
        deviation, position = largest(distance, first, run)
        straight = deviation <= tolerance_px
        done.append((start[straight], stop[straight]))
        bent = ~straight
        middle = start[bent] + np.clip(position[bent], 1, stop[bent] - start[bent] - 2)
        start, stop = (
            np.concatenate([start[bent], middle]),
            np.concatenate([middle + 1, stop[bent]]),
        )
    if not done:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    start, stop = (np.concatenate(parts) for parts in zip(*done, strict=True))
    order = np.argsort(start, kind="stable")
    return start[order], stop[order]

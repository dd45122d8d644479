"""Simulated inputs for tests, benchmarks and docs: block scenes, segments, rendered pictures.

A development package: `pip install .` does not install it. Its files import `trinoc`, and nothing
in `trinoc` imports them.
"""

from simulation.observations import (
    Detector as Detector,
    simulate_segments as simulate_segments,
)
from simulation.scenes import (
    block_scene as block_scene,
    loose_segments as loose_segments,
)

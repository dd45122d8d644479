"""Made inputs with truth: rigs, scenes of blocks, their segments, pictures of the sheet."""

from trinoc.synth.observations import (
    Detector as Detector,
    simulate_segments as simulate_segments,
)
from trinoc.synth.rigs import (
    table1_lens as table1_lens,
    table1_rig as table1_rig,
)
from trinoc.synth.scenes import (
    block_scene as block_scene,
    loose_segments as loose_segments,
)

"""Rigs of the demo and of examples; true edges of synthetic scenes and their visibility."""

from trinoc.synth.rigs import (
    table1_lens as table1_lens,
    table1_rig as table1_rig,
)

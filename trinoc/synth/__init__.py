"""Rigs of the demo and of examples, and the truth of made scenes: its edges and what is visible."""

from trinoc.synth.rigs import (
    table1_lens as table1_lens,
    table1_rig as table1_rig,
)

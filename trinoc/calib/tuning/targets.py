"""Tuned constants of sheets and boards."""

from dataclasses import dataclass


@dataclass(frozen=True)
class TargetTuning:
    """The sheet that suits a camera, and sizes that cannot be. By hand."""

    # A proposed sheet takes so large a share of the field's shorter side: room is left for aiming,
    # and for the sheet to be seen aslant.
    field_share: float = 0.6
    # Its circles are so wide in the picture, px, or at least so wide; their radius is this share
    # of the pitch; which is a multiple of this, mm.
    good_px: float = 20.0
    least_px: float = 10.0
    radius_share: float = 0.3
    step_mm: float = 0.5
    # Printers miss a length by a percent; by so large a share a person or the unit does.
    largest_change: float = 0.3
    # Centres of a measured sheet lie so far, in pitches, from an even lattice.
    off_lattice: float = 0.25

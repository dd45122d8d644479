"""Tests of a fit to many shots, and the shot to take next.

`halves` fits two halves of the shots and compares the parameters, `field_difference` compares the
predicted pixels. `foreseen_shots` predicts the information of possible shots, `next_shot` selects
one.
"""

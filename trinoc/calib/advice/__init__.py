"""Tests of a fit of many shots, and the shot to take next.

`halves` fits halves of the shots and compares them, `field_difference` does so over the images.
`foreseen_shots` predicts the information of possible shots, `next_shot` selects one.
"""

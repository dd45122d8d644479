"""What a fit of many shots is worth, and how it gains.

`cross_validation` fits to halves of the shots and looks at the others; `halves` compares what both
halves say, `field_difference` over the pictures; `projection` says how well a rig images points;
`candidate_shots` -> `foreseen_shots` -> `next_shot` say what to show next."""

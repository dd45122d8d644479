"""What a fit of many shots is worth, and how it gains.

`halves` fits to halves of the shots, looks at the others, and compares what both halves say,
`field_difference` over the pictures; `foreseen_shots` -> `next_shot` say what to show next."""

"""Other tools' files: one small file for each format, and a registry of what each can hold.

A format is a value with `save` and `load`; `FORMATS` has them by name, as `trinoc export --to` and
`--from` take them. Each says where the origin of its pixels lies, how its axes point
and in what unit it counts; what it cannot hold is refused in a sentence where projections would
change, and listed by `Format.lost` where they would not (a covariance, the size of a pixel)."""

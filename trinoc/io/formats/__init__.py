"""File formats of other tools: one module for each format, and a registry.

A format is a value with `save` and `load`. `FORMATS` contains all formats, keyed by their names in
`trinoc export --to` and `--from`. Each format states its pixel origin, its axes and its unit. A
value is refused if the format cannot store data that changes projections. `Format.lost` lists other
data that the format does not store, such as a covariance or the pixel pitch.
"""

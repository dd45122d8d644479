"""While pictures are taken: is this one good to calibrate with, and what should the next show?

`measures` has exposure, sharpness, which part of the field a board covers and which way it leans;
`judgement` puts them together with the detection, and `advice` looks at all pictures so far.
Nothing here fits a lens, so that an answer takes no longer than a picture.
"""

"""A recording: many frames of one rig, and how the work on them is cut up.

1. `camera_words`, `name_templates`, `frame_table`: names of files to frames, one file for each
   camera.
2. `parts`: some frames in a row are a part, the unit of work and one file of results; a share of
   the parts is a job. The segments of its frames become matches, and no frame ends the rest.
"""

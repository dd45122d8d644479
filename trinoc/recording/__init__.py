"""Recordings: many frames of one rig, and the division of the work.

1. `camera_aliases`, `name_templates`, `frame_table`: file names to frames, one file per camera.
2. `parts`: consecutive frames form a part, the unit of work and of result files. A job takes a
share of the parts. The segments of the frames become matches; a failed frame does not stop the
others.
"""

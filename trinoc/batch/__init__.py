"""Recordings matched frame by frame: on threads or a cluster, stopped and taken up at any time.

`source` finds the frames of a folder or a table; `work` reads one part's pictures and matches them;
`workers` are the threads or the cluster, with so many parts in the air and no more; `memory` says
how many; `folder` is where results go and what is there already. `run` puts them together,
`results` reads what was written.
"""

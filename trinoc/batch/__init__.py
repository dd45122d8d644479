"""Recordings matched frame by frame, on threads or a cluster, resumable at any time.

`source` finds the frames of a folder or a table. `work` reads the images of one part and matches
them. `workers` are threads, processes or a cluster, with a bounded number of open tasks. `folder`
is the folder of results. `run` combines them.
"""

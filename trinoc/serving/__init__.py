"""Live images (cameras, videos, filling folders) and web pages for a browser on this machine.

`sources` reads cameras, videos and folders; `session` evaluates the images, and `kept_shots` saves
new ones. Only this room opens a port, for a page that refreshes itself. It listens on the loopback
address only, refuses requests that come from other sites (`loopback`), and serves no file of the
machine.
"""

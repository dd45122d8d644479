"""Pages for a browser on this machine: who may ask, a page that refreshes itself, a scene to turn.

Whatever opens a port stands here. It listens on the loopback address alone, answers no request
that another site had a browser send (`loopback`), and serves no file of the machine.
"""

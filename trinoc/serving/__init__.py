"""Where pictures come from while somebody waits, and pages for a browser on this machine.

`sources` opens cameras and videos and looks into folders as they fill; `session` judges what comes,
and `kept_shots` keeps of it what is new. Only this room opens a port, for a page that refreshes
itself. It listens on the loopback address alone, answers no request that another site had a browser
send (`loopback`), and serves no file of the machine.
"""

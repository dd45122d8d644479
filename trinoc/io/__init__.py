"""Files: one file per format. Nothing below this room opens one.

A file that is written is whole or not there; a file that is read is checked, and what is wrong is
said in one sentence with the file, the key and the remedy."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

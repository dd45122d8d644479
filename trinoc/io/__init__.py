"""Reading and writing of files: one module for each format. No inner package opens a file.

A written file appears complete or not at all. A file that is read is checked. An error message
names the file, the key, the fault and the remedy.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

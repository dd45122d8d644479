from .displays import NotebookDisplays as NotebookDisplays
from .extras import expect_extra as expect_extra

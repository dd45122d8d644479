from .displays import NotebookDisplays as NotebookDisplays

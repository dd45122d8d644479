"""The `trinoc` command: options and one printer, no work of its own."""

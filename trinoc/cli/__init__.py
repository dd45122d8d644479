"""The `trinoc` command."""

"""How values show themselves in a notebook: tables, small pictures, plots, figures to turn."""

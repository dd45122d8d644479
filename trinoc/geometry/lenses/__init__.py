"""What a lens does to a ray: one file for each model, and the registry of their names."""

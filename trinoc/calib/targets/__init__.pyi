from .pattern import Pattern as Pattern

"""The sheet's picture as a differentiable model, fitted to the pixels near ink edges."""

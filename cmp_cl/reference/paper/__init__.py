"""The oracle of the paper's rule."""

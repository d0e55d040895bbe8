"""The paper's rule, from the image to the list of its corners."""

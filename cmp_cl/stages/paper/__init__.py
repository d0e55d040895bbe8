"""The paper's rule, from the image at its working scale to the list of its corners."""

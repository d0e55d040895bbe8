"""The oracle of the lattice."""

"""The oracle of the field."""

"""What `cmp-cl run` is made of: its source, its pace, its results, and the signals that stop it."""

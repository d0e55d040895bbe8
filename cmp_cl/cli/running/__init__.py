"""What `cmp-cl run` is made of: a recording, its pace, its results, and what stops it."""

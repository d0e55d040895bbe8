"""What `cmp-cl run` is made of: a recording, its results, and what stops it."""

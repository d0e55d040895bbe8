"""The longer commands of the command line, a module each."""

"""The command line, with one module for each command.

A command has its help in its docstring and its DESCRIPTION, `add_arguments(parser)`, and
`run(arguments)`, which returns the exit status.
"""

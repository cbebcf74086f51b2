"""The command line: verbs only, no numerics."""

"""The command line: one file per command, only the called one is loaded."""

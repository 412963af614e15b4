"""The command line. Importing this package imports nothing else, so that Ctrl-C is dealt with before all."""

"""The command line. Importing this package imports nothing else: Ctrl-C is handled from the first moment."""

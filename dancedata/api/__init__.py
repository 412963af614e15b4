"""The functions of `import dancedata`: what the command line does (`commands`), and single arrays (`arrays`)."""

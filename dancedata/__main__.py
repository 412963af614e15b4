"""``python -m dancedata``."""

from dancedata.cli import main

main()

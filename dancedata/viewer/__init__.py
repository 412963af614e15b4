"""`dancedata view`: the page of clips, served."""

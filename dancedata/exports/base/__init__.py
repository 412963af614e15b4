"""How a built dataset is exported: what it lacks, its music, the folder that appears whole."""

"""Scripts that reproduce the figures and tables of three papers, one package a paper."""

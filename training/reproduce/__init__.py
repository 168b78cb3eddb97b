"""Figures and tables of the papers, reproduced and compared with the papers' values.

Each is a `Study` (`study`): a grid of cells, what is made of them, and the paper's claims. `papers`
names the papers; `neural_swarm2` their options and studies;
`reproduce_all` runs all of them, and `reproduce_page` sets them side by side.
"""

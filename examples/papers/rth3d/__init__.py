"""Scripts that reproduce the figures of the RTH3D paper; `python -m examples.papers.rth3d --help`.

Guo, Feng and Yu, *Polynomial Time Near-Time-Optimal Multi-Robot Path Planning in Three Dimensions*.
"""

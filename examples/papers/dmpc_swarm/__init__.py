"""Scripts that reproduce the figures of DMPC-Swarm; `python -m examples.papers.dmpc_swarm --help`.

*DMPC-Swarm: Distributed Model Predictive Control on Nano UAV Swarms*.
"""

"""MLR-DMPC (Gräfe et al., DMPC-Swarm): distributed MPC that never collides, whatever is lost."""

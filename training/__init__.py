"""Trainers: interaction models, data collection, reinforcement learning."""

if __name__ == "training":
    raise ImportError(
        "import swarm_envs.training instead: a bare 'training' collides with other packages"
    )

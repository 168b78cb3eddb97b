"""The papers' methods, as libraries and as agents."""

if __name__ == "baselines":
    raise ImportError(
        "import swarm_envs.baselines instead: a bare 'baselines' collides with other packages"
    )

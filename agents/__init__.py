"""What acts: the agent protocol, learned agents and their networks."""

if __name__ == "agents":
    raise ImportError(
        "import swarm_envs.agents instead: the bare name 'agents' collides with other packages"
    )

"""From the import to the first step of a first environment."""

import swarm_envs
from swarm_envs import swap_v1

env = swap_v1.parallel_env(num_drones=4)
observations, infos = env.reset(seed=0)
actions = {agent: env.action_space(agent).sample() for agent in env.agents}
observations, *_ = env.step(actions)
assert all(env.observation_space(a).contains(row) for a, row in observations.items())
print(swarm_envs.__version__, env.physics_name)
env.close()

"""The file of agents that a user might have: what tests of evaluations begin theirs with."""

FINE = """
import numpy as np
class Fine:
    requires, privileged = {'action': 'acceleration', 'decision_rate': 10}, False
    def reset(self, env, seed): self.seed, self.count = seed, 0
    def act(self, observations, view):
        self.count += 1
        return {name: self.say() for name in observations}
    def say(self): return np.zeros(3, np.float32)
"""
FAILING = """
class Raises(Fine):
    def say(self): return {}['nothing']
class Nan(Fine):
    def say(self): return np.full(3, np.nan if self.count > 2 else 0.0)
"""

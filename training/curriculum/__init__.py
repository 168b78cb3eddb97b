"""The curriculum of Neural-Swarm2, Sec. IV-D: fit, fly closer with what was learned, fit again.

Downwash drives drones apart that do not compensate it, so they cannot fly close enough to learn
it. So it is done in rounds: one and two drones fly far apart, without compensation, and a
model is fitted; with it as the pilot's feed-forward they fly closer; then three drones. Order of
reading: `run` (all of it: how close drones came, and how close the next round may plan),
`curriculum_config` (options and stages), `curriculum_report` (how much of the true force a model
explains, table, picture).

Command: `swarm-envs curriculum --out DIR --seed 0`; the page is docs/reproduce.md.
"""

from swarm_envs.training.curriculum.curriculum_config import CurriculumConfig

__all__ = ["CurriculumConfig"]

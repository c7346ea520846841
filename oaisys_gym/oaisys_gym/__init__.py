"""Gymnasium environments in simulated terrain; importing this registers them.

>>> import gymnasium, oaisys_gym
>>> environment = gymnasium.make("oaisys/NextBestView-v0")
"""

import sys

if sys.argv[:1] == ["-m"] and not sys.flags.safe_path:  # as in `python -m oaisys_gym`
    del sys.path[0]  # the current folder, whose files nothing may import

import gymnasium

gymnasium.register(
    id="oaisys/NextBestView-v0",
    entry_point="oaisys_gym.next_best_view:NextBestView",
    max_episode_steps=30,
)
gymnasium.register(
    id="oaisys/Coverage-v0", entry_point="oaisys_gym.coverage:Coverage", max_episode_steps=60
)
gymnasium.register(
    id="oaisys/DriveToGoal-v0",
    entry_point="oaisys_gym.drive_to_goal:DriveToGoal",
    max_episode_steps=120,
)

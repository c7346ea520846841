"""A gym for planners: episodes in drawn worlds, of random actions and of a baseline.

    python examples/12_gym.py [--episodes N]

`gymnasium.make` starts a simulator, without Blender, which ends with the environment. A planner of
your own is anything that turns an observation into an action; docs/gym.md says what both are.
"""

import argparse

import gymnasium

import oaisys_gym  # noqa: F401 - registers the environments
from oaisys_gym.baselines import TurnToGoal

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--episodes", type=int, default=3)
environment = gymnasium.make("oaisys/DriveToGoal-v0", render_mode="rgb_array")
for seed in range(parser.parse_args().episodes):
    for name in ("random", "baseline"):
        observation, info = environment.reset(seed=seed)  # the same world, start and goal for both
        environment.action_space.seed(seed)
        policy, total, ended = TurnToGoal(environment), 0.0, False
        while not ended:
            action = environment.action_space.sample() if name == "random" else policy(observation)
            observation, reward, arrived, timed_out, info = environment.step(action)
            total, ended = total + reward, arrived or timed_out
        print(f"seed {seed}, {name}: reward {total:.1f}, {info['distance_m']:.1f} m left")
print("the last view:", environment.render().shape)
environment.close()

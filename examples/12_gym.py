"""A gym for planners: episodes in drawn worlds, of random actions and of a baseline.

    python examples/12_gym.py [--episodes N] [--out out/gym.png]

`gymnasium.make` starts a simulator, without Blender, which ends with the environment. A planner of
your own is anything that turns an observation into an action; docs/gym.md says what both are.
"""

import argparse
from pathlib import Path

import gymnasium
import numpy as np
from PIL import Image

import oaisys_gym  # noqa: F401 - registers the environments
from oaisys_gym.baselines import TurnToGoal

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--episodes", type=int, default=3)
parser.add_argument(
    "--out", type=Path, default=Path("out/gym.png"), help="a picture of the last way"
)
options = parser.parse_args()
environment = gymnasium.make("oaisys/DriveToGoal-v0", render_mode="rgb_array")
for seed in range(options.episodes):
    for name in ("random", "baseline"):
        observation, info = environment.reset(seed=seed)  # the same world, start and goal for both
        environment.action_space.seed(seed)
        policy, total, ended, seen = TurnToGoal(environment), 0.0, False, []
        while not ended:
            action = environment.action_space.sample() if name == "random" else policy(observation)
            observation, reward, arrived, timed_out, info = environment.step(action)
            total, ended = total + reward, arrived or timed_out
            seen.append(environment.render())
        print(f"seed {seed}, {name}: reward {total:.1f}, {info['distance_m']:.1f} m left")
environment.close()
print("the last view:", seen[-1].shape)
eight = [seen[i] for i in np.linspace(0, len(seen) - 1, 8).astype(int)]  # of the baseline's way
options.out.parent.mkdir(parents=True, exist_ok=True)
Image.fromarray(np.vstack([np.hstack(eight[:4]), np.hstack(eight[4:])])).save(options.out)

"""Train a tiny network: it learns the labels of a data set, if PyTorch is there.

    python examples/07_train_on_a_dataset.py DATASET [STEPS]

DATASET is a folder or an address to which `oaisys dataset render` wrote.
"""

import argparse
import sys

import numpy as np

from oaisys_dataset import open_dataset

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("dataset", help="its folder or address")
parser.add_argument("steps", nargs="?", type=int, default=20)
options = parser.parse_args()
dataset = open_dataset(options.dataset).split("train")
rng = np.random.default_rng(0)


def batch(size: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 3, H, W) colours from 0 to 1, and (N, H, W) label ids, of random frames."""
    samples = [dataset[int(i)] for i in rng.integers(len(dataset), size=size)]
    colors = np.stack([s.arrays["rgb"] for s in samples]).transpose(0, 3, 1, 2) / np.float32(255)
    return colors, np.stack([s.arrays["semantic_0"] for s in samples]).astype(np.int64)


classes = 1 + max(label for world in dataset.worlds for label in dataset.legend(world).labels)
print(f"{len(dataset)} frames, {classes} classes, a batch has {batch()[0].shape} colours")
try:
    import torch
except ImportError:
    sys.exit(print("PyTorch is not installed: nothing was trained"))
net = torch.nn.Sequential(
    torch.nn.Conv2d(3, 16, 5, padding=2), torch.nn.ReLU(), torch.nn.Conv2d(16, classes, 1)
)
optimizer = torch.optim.Adam(net.parameters(), lr=0.01)
for step in range(options.steps):
    colors, labels = map(torch.from_numpy, batch())
    loss = torch.nn.functional.cross_entropy(net(colors), labels)
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    print(f"step {step}: loss {loss.item():.3f}")
